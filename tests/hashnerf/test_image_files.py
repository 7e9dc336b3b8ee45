"""Reading whole images exactly, and naming every kind of file that is not one."""

import os
import re
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageCms, ImageFile

from hashnerf.errors import UserError
from hashnerf.image_files import read_depth, read_rgb, resolve_inside, write_png
from tests.hashnerf.refusals import refuses

PICTURE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)


def _png_bomb(path, width, height, bits=8):
    """A few bytes whose header claims a huge picture."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0)
    rows = zlib.compress(b"\0" * 1000)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))


def test_a_written_picture_is_read_back_exactly(tmp_path):
    write_png(tmp_path / "new" / "a.png", PICTURE)
    assert np.array_equal(read_rgb(tmp_path / "new" / "a.png"), PICTURE)
    assert os.listdir(tmp_path / "new") == ["a.png"]


def test_depth_is_read_back_exactly(tmp_path):
    depth = np.array([[0, 1, 255, 256], [1000, 32767, 32768, 65535]], dtype=np.uint16)
    write_png(tmp_path / "d.png", depth)
    result = read_depth(tmp_path / "d.png")
    assert result.dtype == np.uint16 and np.array_equal(result, depth)


def test_k38_a_jpeg_is_read_as_stored(tmp_path, numeric_row):
    # Orientation 6 asks viewers to turn the picture; poses and lens belong to the pixels as stored.
    exif = Image.Exif()
    exif[274] = 6
    Image.fromarray(PICTURE).save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=exif)
    image = read_rgb(tmp_path / "a.jpg")
    assert image.shape == PICTURE.shape
    numeric_row("K38", "JPEG that asks to be turned: levels off", np.abs(image.astype(int) - PICTURE).max(), 8)


def test_k38_greyscale_and_palette_are_expanded(tmp_path, numeric_row):
    grey = PICTURE[..., 0]
    Image.fromarray(grey).save(tmp_path / "grey.png")
    assert np.array_equal(read_rgb(tmp_path / "grey.png"), np.repeat(grey[..., None], 3, axis=2))
    few = (PICTURE > 127).astype(np.uint8) * 255  # eight colours fit a palette without loss
    Image.fromarray(few).quantize(8, dither=Image.Dither.NONE).save(tmp_path / "palette.png")
    off = np.abs(read_rgb(tmp_path / "palette.png").astype(int) - few).max()
    numeric_row("K38", "palette of eight colours: levels off", off)


def test_k38_transparency_is_composited_over_white(tmp_path, numeric_row):
    # 100 at alpha 0 -> white 255; at 255 -> 100; at 51 (a fifth) -> 100/5 + 255*4/5 = 224
    rgba = np.full((1, 3, 4), 100, dtype=np.uint8)
    rgba[0, :, 3] = [0, 255, 51]
    Image.fromarray(rgba).save(tmp_path / "a.png")
    off = np.abs(read_rgb(tmp_path / "a.png")[0, :, 0].astype(int) - [255, 100, 224]).max()
    numeric_row("K38", "transparent, opaque and a fifth: levels off", off)


def _bad_files():
    """{file name: (how to make it, what the sentence says)}"""
    good = Image.fromarray(PICTURE)
    deep = Image.fromarray(np.zeros((8, 8), np.uint16))

    return {
        "empty.png": (lambda path: path.touch(), "empty.png is empty (0 bytes)"),
        "stub.png": (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n"), "stub.png is not a readable PNG or JPEG"),
        "text.png": (lambda path: path.write_text("hello"), "text.png is not a readable PNG or JPEG"),
        "page.png": (lambda path: good.save(path, format="GIF"), "page.png is not a readable PNG or JPEG"),
        "bomb.png": (lambda path: _png_bomb(path, 20_000, 10_000), "over 40 megapixels"),
        "wide.png": (lambda path: _png_bomb(path, 41_000_000, 1), "41000000x1, over 40 megapixels"),
        "big.png": (lambda path: _png_bomb(path, 10_000, 9_000), "10000x9000, over 40 megapixels"),
        "zero.png": (lambda path: _png_bomb(path, 0, 5), "zero.png is not a readable PNG or JPEG"),
        "deep.png": (deep.save, "deep.png has 16 bits a channel"),
        "deep_rgb.png": (lambda path: _png_bomb(path, 1, 1, bits=16), "deep_rgb.png has 16 bits a channel"),
        "cmyk.jpg": (good.convert("CMYK").save, "cmyk.jpg has the colour mode CMYK"),
        "moving.png": (
            lambda path: good.save(path, save_all=True, append_images=[good.rotate(90)]),
            "moving.png is animated",
        ),
        "folder.png": (lambda path: path.mkdir(), "does not exist or is not a regular file"),
        "fifo.png": (os.mkfifo, "does not exist or is not a regular file"),
        "missing.png": (lambda path: None, "does not exist or is not a regular file"),
    }


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_k38_a_bad_picture_is_named(tmp_path, numeric_row):
    wrong = []
    for name, (make, sentence) in _bad_files().items():
        make(tmp_path / name)
        wrong += [] if refuses(re.escape(sentence), read_rgb, tmp_path / name) else [name]
    print(wrong)
    numeric_row("K38", f"{len(_bad_files())} files: bombs, 16 bit, CMYK, animated, ...: read, or not named", len(wrong))


def test_k38_a_bomb_is_refused_before_memory_is_spent(tmp_path, monkeypatch, numeric_row):
    _png_bomb(tmp_path / "a.png", 6_400, 6_300)  # 40.3 megapixels
    _png_bomb(tmp_path / "b.png", 6_400, 6_200)  # 39.7: goes on to the decoder, which misses the data
    decoded, load = [], ImageFile.ImageFile.load
    monkeypatch.setattr(ImageFile.ImageFile, "load", lambda image: decoded.append(image.size) or load(image))
    with pytest.raises(UserError, match="over 40 megapixels"):
        read_rgb(tmp_path / "a.png")
    numeric_row("K38", "40.3 megapixels: decoded", len(decoded))
    with pytest.raises(UserError, match="damaged or truncated"):
        read_rgb(tmp_path / "b.png")
    assert decoded


def test_k38_a_colour_profile_changes_no_pixel(tmp_path, numeric_row):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("XYZ")).tobytes()
    Image.fromarray(PICTURE).save(tmp_path / "a.png", icc_profile=profile)
    numeric_row(
        "K38", "PNG with a colour profile: levels off", np.abs(read_rgb(tmp_path / "a.png").astype(int) - PICTURE).max()
    )


def test_k38_a_long_thin_picture_is_read(tmp_path, numeric_row):
    column = np.random.default_rng(1).integers(0, 256, (1_000_000, 1, 3), dtype=np.uint8)
    write_png(tmp_path / "long.png", column)
    numeric_row("K38", "1 x 1,000,000 pixels: pixels off", (read_rgb(tmp_path / "long.png") != column).sum())


@pytest.mark.parametrize("name, options", [("cut.jpg", {"quality": 95}), ("cut.png", {})])
def test_k39_a_truncated_picture_is_named(tmp_path, name, options, numeric_row):
    """A cut behind the last pixel loses nothing and may pass; any other one must be named."""
    Image.fromarray(PICTURE).save(tmp_path / name, **options)
    whole, picture, wrong = (tmp_path / name).read_bytes(), read_rgb(tmp_path / name), []
    lengths = range(1, len(whole), 9)
    for length in lengths:
        (tmp_path / name).write_bytes(whole[:length])
        if not refuses(f"^{name} is (damaged or truncated|not a readable)", read_rgb, tmp_path / name):
            wrong += [length] if (read_rgb(tmp_path / name) != picture).any() else []
    print(wrong)
    numeric_row("K39", f"{name} at {len(lengths)} lengths: read with other pixels, or not named", len(wrong))


@pytest.mark.parametrize("image", [PICTURE, PICTURE[..., 0]])
def test_eight_bit_pictures_are_not_depth(tmp_path, image):
    Image.fromarray(image).save(tmp_path / "d.png")
    with pytest.raises(UserError, match=r"d\.png is a PNG of mode .*depth is a 16-bit greyscale PNG"):
        read_depth(tmp_path / "d.png")


@pytest.mark.parametrize("file_format", ["PNG", "JPEG"])
def test_damaged_bytes_never_raise_anything_else(tmp_path, file_format):
    path = tmp_path / "a.img"
    Image.fromarray(PICTURE).save(path, format=file_format)
    whole = path.read_bytes()

    @settings(deadline=None, max_examples=150)
    @given(
        st.integers(0, len(whole)), st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), max_size=4)
    )
    def damage(length, edits):
        data = bytearray(whole)
        for position, value in edits:
            data[position] = value
        path.write_bytes(bytes(data[:length]))
        try:
            assert read_rgb(path).dtype == np.uint8
        except UserError as error:
            assert "a.img" in str(error)

    damage()


@pytest.fixture
def folder(tmp_path):
    inside = tmp_path / "set"
    (inside / "images").mkdir(parents=True)
    for name in ("a.png", "b c ü.PNG", "plain.jpg"):
        (inside / "images" / name).write_bytes(b"x")
    (tmp_path / "secret.png").write_bytes(b"x")
    (inside / "out.png").symlink_to(tmp_path / "secret.png")
    (inside / "in.png").symlink_to(inside / "images" / "a.png")
    (inside / "zero.png").symlink_to("/dev/zero")
    (inside / "images" / "out").symlink_to(tmp_path)
    (inside / "loop.png").symlink_to(inside / "loop.png")
    (inside / "folder.png").mkdir()
    os.mkfifo(inside / "fifo.png")
    return inside


@pytest.mark.parametrize(
    "name, target",
    [
        ("images/a.png", "a.png"),
        ("./images/../images/a.png", "a.png"),
        ("images/a", "a.png"),
        ("images/plain", "plain.jpg"),
        ("images/b c ü.PNG", "b c ü.PNG"),
        ("in.png", "a.png"),
    ],
)
def test_names_inside_the_folder_are_found(folder, name, target):
    assert resolve_inside(folder, name, (".png", ".jpg")) == (folder / "images" / target).resolve()


ELSEWHERE = [
    ("../secret.png", "'../secret.png' leaves the data folder"),
    ("images/../../secret.png", "leaves the data folder"),
    ("/etc/passwd", "'/etc/passwd' leaves the data folder"),
    ("/dev/zero", "'/dev/zero' leaves the data folder"),
    ("zero.png", "'zero.png' leaves the data folder"),
    ("images/out/secret.png", "leaves the data folder"),
    ("\ud800.png", "cannot be resolved"),
    ("out.png", "'out.png' leaves the data folder"),
    ("..\\secret.png", "a NUL or a backslash"),
    ("a\0b.png", "a NUL or a backslash"),
    ("x" * 5000, "is too long"),
    ("x" * 500, "cannot be resolved"),
    ("loop.png", "'loop.png' cannot be resolved"),
    ("fifo.png", "'fifo.png' is not a regular file"),
    ("folder.png", "'folder.png' is not a regular file"),
    (".", "'.' is not a regular file"),
    ("~/secret.png", "does not exist (also tried .png, .jpg)"),
    ("$HOME/secret.png", "does not exist"),
    ("images/none.png", "'images/none.png' does not exist"),
    ("", "the path '' is not a file name"),
    (None, "the path None is not a file name"),
    (3, "the path 3 is not a file name"),
]


def test_k35_names_that_lead_elsewhere_are_refused(folder, numeric_row):
    wrong = []
    for name, sentence in ELSEWHERE:
        wrong += [] if refuses(re.escape(sentence), resolve_inside, folder, name, (".png", ".jpg")) else [name]
    print(wrong)
    numeric_row(
        "K35", f"{len(ELSEWHERE)} names such as ../x, an absolute one, links, a pipe: opened, or not named", len(wrong)
    )
