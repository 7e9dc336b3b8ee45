"""Settings that several scenarios share, each with its range."""

from dataclasses import dataclass

from worlds.checks import check_between, check_one_of


@dataclass(frozen=True)
class EgoCameraConfig:
    """The camera that the ego carries; the cameras of the rig on its lane are like it."""

    field_of_view: float = 80.0
    """Degrees across."""
    height: float = 1.6
    """Metres above the road."""
    yaw: float = 9.0
    """Degrees that it looks to the left of the heading."""
    pan: float = 16.0
    """Degrees that it turns further left over the last metres before the stop line."""

    def __post_init__(self) -> None:
        check_between("ego_camera.field_of_view", self.field_of_view, 30.0, 120.0)
        check_between("ego_camera.height", self.height, 1.5, 2.5)
        check_between("ego_camera.yaw", self.yaw, -90.0, 90.0)
        check_between("ego_camera.pan", self.pan, -90.0, 90.0)


@dataclass(frozen=True)
class SplitConfig:
    """Which cameras are held out."""

    test_every: int = 8
    """Every how many cameras of a kind one is `test`; 8 gives 12 of 100, fewer gives more."""
    birds_eye: str = "train"
    """Split of the bird's-eye camera: train or test."""

    def __post_init__(self) -> None:
        check_between("splits.test_every", self.test_every, 3, 8)
        check_one_of("splits.birds_eye", self.birds_eye, ("train", "test"))
