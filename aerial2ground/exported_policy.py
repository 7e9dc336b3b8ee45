"""An exported steering policy on the car: one ONNX file in, steering out; needs numpy and onnxruntime, not torch.

The file's graph takes one uint8 picture [1, h, w, c] as the camera gives it (colours in the order RGB, a fourth channel
is the depth of `aerial2ground.depth_channel`) and answers radians, positive to the left. Scaling lies inside the graph.
What the numbers mean stands in the file's metadata as text: the fields of `PolicyInfo`.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hashnerf.errors import UserError

TASK = "steering"
COLOUR_ORDERS = {3: "RGB", 4: "RGBD"}
UNITS = "radians, positive to the left"
LARGEST_FILE = 256 * 1024 * 1024  # bytes


@dataclass(frozen=True)
class PolicyInfo:
    """What a policy file says about itself; raises UserError for values that no policy can have."""

    width: int
    """Pixels across."""
    height: int
    """Pixels down."""
    channels: int
    """3 (red, green, blue) or 4 (and depth)."""
    steering_limit: float
    """Radians that an answer of 1 of the network stands for; answers are not clipped to it."""
    field_of_view: float
    """Degrees across of the pinhole camera that it was trained for."""
    pitch: float
    """Degrees above the horizon of that camera."""
    depth_range: float = 0.0
    """Metres that 255 in the depth channel stands for; 0 without depth."""
    version: str = ""
    """Version of the project that wrote the file."""
    task: str = TASK
    """`steering`."""
    colour_order: str = "RGB"
    """`RGB` or `RGBD`."""
    units: str = UNITS
    """Of the answer."""

    def __post_init__(self):
        if self.task != TASK or self.units != UNITS:
            raise UserError(f"the task is {self.task!r} in {self.units!r}, not {TASK!r} in {UNITS!r}")
        if self.channels not in COLOUR_ORDERS or self.colour_order != COLOUR_ORDERS[self.channels]:
            raise UserError(f"{self.channels} channels in the order {self.colour_order!r} are not known")
        if self.width < 1 or self.height < 1:
            raise UserError(f"the size {self.width} x {self.height} is no picture")
        if not 0 < self.steering_limit < math.pi / 2:
            raise UserError(f"the steering limit {self.steering_limit} is no angle in radians")
        if not 10 <= self.field_of_view <= 150:
            raise UserError(f"the field of view {self.field_of_view} is not 10 to 150 degrees")
        if not -80 <= self.pitch <= 80:
            raise UserError(f"the pitch {self.pitch} is not -80 to 80 degrees")
        if not (0 < self.depth_range < math.inf if self.channels == 4 else self.depth_range == 0):
            raise UserError(f"the depth range {self.depth_range} does not fit {self.channels} channels")

    @property
    def shape(self) -> tuple[int, int, int]:
        """(h, w, c) of a picture."""
        return self.height, self.width, self.channels

    def as_metadata(self) -> dict[str, str]:
        """The fields as text."""
        return {key: repr(value) if isinstance(value, float) else str(value) for key, value in asdict(self).items()}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], source: str) -> "PolicyInfo":
        """Reads what `as_metadata` wrote; raises UserError naming `source` and what is missing or wrong."""
        missing = [key for key in cls.__dataclass_fields__ if key not in metadata]
        if missing:
            raise UserError(f"{source}: lacks {', '.join(missing)}; export the policy with scripts/export_policy.py")
        try:
            kinds = {key: field.type for key, field in cls.__dataclass_fields__.items()}
            return cls(**{key: kind(metadata[key]) for key, kind in kinds.items()})
        except (ValueError, UserError) as error:
            raise UserError(f"{source}: {error}; export the policy with scripts/export_policy.py") from error


class ExportedPolicy:
    """Steers by pictures; one thread, one picture at a time."""

    def __init__(self, session: Any, info: PolicyInfo, source: str):
        self.info = info
        self._session, self._source = session, source
        self._input, self._output = session.get_inputs()[0].name, session.get_outputs()[0].name

    def __call__(self, picture: np.ndarray) -> float:
        """Returns the steering angle (rad) for one uint8 picture [h, w, c].

        Raises UserError for a picture of another size or kind, and for an answer that is not a finite number.
        """
        shape = self.info.shape
        if not isinstance(picture, np.ndarray) or picture.dtype != np.uint8 or picture.shape != shape:
            given = f"{picture.dtype} {picture.shape}" if isinstance(picture, np.ndarray) else type(picture).__name__
            raise UserError(
                f"{self._source}: reads {self.info.colour_order} pictures as uint8 {shape} (height, width, channels), "
                f"not {given}; let the camera give these or export a policy for it"
            )
        answer = float(self._session.run([self._output], {self._input: picture[None]})[0][0, 0])
        if not math.isfinite(answer):
            raise UserError(f"{self._source}: answers {answer}; the file is damaged, export the policy again")
        return answer


def load_exported(path: Path | str) -> ExportedPolicy:
    """Loads a policy file and tries it on a grey picture.

    Raises UserError where there is no such file, where it is not ONNX or no policy of this project, and where
    onnxruntime is missing.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"{path}: no such file; export a policy with scripts/export_policy.py")
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise UserError(f"{path}: is over {LARGEST_FILE // 2**20} MB; this is no policy")
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    return policy_from_bytes(data, str(path))


def policy_from_bytes(data: bytes, source: str) -> ExportedPolicy:
    """Does the work of `load_exported` for the contents of a file; `source` names it in messages."""
    try:
        import onnxruntime
    except ImportError as error:
        raise UserError("exported policies need the extra `export`: pip install -e .[export]") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its errors have no common base but this
        raise UserError(f"{source}: is not a whole ONNX file ({type(error).__name__})") from error
    info = PolicyInfo.from_metadata(session.get_modelmeta().custom_metadata_map, source)
    ports = [(one.type, list(one.shape)) for one in (*session.get_inputs(), *session.get_outputs())]
    if ports != [("tensor(uint8)", [1, *info.shape]), ("tensor(float)", [1, 1])]:
        raise UserError(f"{source}: its graph reads and answers {ports}, not what its metadata says; export it again")
    policy = ExportedPolicy(session, info, source)
    policy(np.full(info.shape, 128, np.uint8))
    return policy
