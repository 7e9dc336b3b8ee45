"""Reading photographs and depth maps that may be damaged or hostile, and writing PNG files in one step.

Images are uint8 [h, w, 3] RGB with the pixels as stored. Depth maps are uint16 [h, w], millimetres, 0 = nothing hit.
"""

import io
import struct
import zlib
from pathlib import Path

import numpy as np
from jaxtyping import UInt8, UInt16
from PIL import Image

from hashnerf.errors import UserError
from hashnerf.transforms_json import write_atomically

LARGEST_IMAGE = 40_000_000  # pixels
LONGEST_PATH = 1024  # characters
FORMATS = ("PNG", "JPEG")
# What Pillow is known to raise on damaged files besides OSError.
DAMAGE = (OSError, SyntaxError, ValueError, IndexError, KeyError, EOFError, struct.error, zlib.error)


def resolve_inside(folder: Path, name: object, extensions: tuple[str, ...] = ()) -> Path:
    """The regular file that `name` means inside `folder`; tries `extensions` when the name as given does not exist.

    Raises UserError when it leaves the folder (.., absolute, link), does not exist, or is not a regular file.
    """
    if not isinstance(name, str) or not name:
        raise UserError(f"the path {name!r} is not a file name")
    if len(name) > LONGEST_PATH or "\0" in name or "\\" in name:
        reason = "is too long" if len(name) > LONGEST_PATH else "holds a NUL or a backslash (write / between folders)"
        raise UserError(f"the path {name[:80]!r} {reason}")
    try:
        root = folder.resolve()
        candidates = [(root / (name + extension)).resolve() for extension in ("", *extensions)]
        if not all(path.is_relative_to(root) for path in candidates):
            raise UserError(f"the path {name!r} leaves the data folder; copy the file inside")
        for path in candidates:
            if path.is_file():
                return path
        if candidates[0].exists():
            raise UserError(f"{name!r} is not a regular file")
    except (OSError, RuntimeError, UnicodeError) as error:  # a loop of symbolic links; a lone surrogate
        raise UserError(f"the path {name[:80]!a} cannot be resolved ({error})") from error
    tried = f" (also tried {', '.join(extensions)})" if extensions else ""
    raise UserError(f"{name!r} does not exist{tried}")


def read_rgb(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """An 8-bit RGB image; greyscale and palette are expanded, transparency is composited over white.

    Raises UserError for anything that is not a whole, still, 8-bit PNG or JPEG of at most 40 megapixels.
    """
    with _open(path) as image:
        if image.format == "PNG" and getattr(image, "is_animated", False):
            raise UserError(f"{path.name} is animated; save one still image")
        if image.mode.startswith("I") or _png_bits(path) == 16:
            raise UserError(f"{path.name} has 16 bits a channel; save it with 8")
        if image.mode not in ("RGB", "RGBA", "L", "LA", "P", "1"):
            raise UserError(f"{path.name} has the colour mode {image.mode}; save it as RGB")
        try:
            if image.mode in ("RGBA", "LA") or "transparency" in image.info:
                return _over_white(np.asarray(image.convert("RGBA")))
            return np.array(image.convert("RGB"))
        except DAMAGE as error:
            raise UserError(f"{path.name} is damaged or truncated ({error})") from error


def read_depth(path: Path) -> UInt16[np.ndarray, "h w"]:
    """A 16-bit greyscale PNG of millimetres along the optical axis; raises UserError for anything else."""
    with _open(path) as image:
        if image.format != "PNG" or not image.mode.startswith("I;16"):
            raise UserError(
                f"{path.name} is a {image.format} of mode {image.mode}; depth is a 16-bit greyscale PNG in millimetres"
            )
        try:
            return np.asarray(image).astype(np.uint16)
        except DAMAGE as error:
            raise UserError(f"{path.name} is damaged or truncated ({error})") from error


def write_png(path: Path | str, image: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w"]) -> None:
    """Writes RGB (uint8) or depth (uint16 millimetres) through a temporary file, so that no half image is ever seen."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, format="PNG")
    write_atomically(Path(path), buffer.getvalue())


def _open(path: Path) -> Image.Image:
    """Reads the header only: nothing is decoded before the size is known to be acceptable."""
    if not path.is_file():
        raise UserError(f"{path} does not exist or is not a regular file")
    try:
        if path.stat().st_size == 0:
            raise UserError(f"{path.name} is empty (0 bytes)")
        image = Image.open(path, formats=FORMATS)
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise UserError(f"{path.name} has over {LARGEST_IMAGE // 10**6} megapixels; shrink it first") from error
    except DAMAGE as error:
        raise UserError(f"{path.name} is not a readable PNG or JPEG image ({type(error).__name__})") from error
    if image.width * image.height > LARGEST_IMAGE:
        image.close()
        raise UserError(
            f"{path.name} is {image.width}x{image.height}, over {LARGEST_IMAGE // 10**6} megapixels; shrink it first"
        )
    return image


def _png_bits(path: Path) -> int:
    """Bits a channel in a PNG header (byte 24), 8 for other formats; Pillow does not tell for RGB."""
    with path.open("rb") as file:
        head = file.read(26)
    return head[24] if head.startswith(b"\x89PNG") and len(head) > 24 else 8


def _over_white(rgba: UInt8[np.ndarray, "h w 4"]) -> UInt8[np.ndarray, "h w 3"]:
    colour, alpha = rgba[..., :3].astype(np.uint32), rgba[..., 3:].astype(np.uint32)
    return ((colour * alpha + 255 * (255 - alpha) + 127) // 255).astype(np.uint8)
