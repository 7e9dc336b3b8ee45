"""The names under which methods stand in files, and how a report writes and draws them; the paper's own figures.

The order of each mapping is that of the tables. Positions in metres, yaw in degrees, interventions per run.
"""

from hashnerf.figure_style import AMBER, BLUE, GREEN, MUTED, SKY, VERMILION

DRIVERS = {"expert": "expert", "imit": "Imit", "imit_gv": "Imit + GV", "ours": "Ours", "ours_gv": "Ours + GV"}
JUDGED_DRIVERS = ("imit", "imit_gv", "ours", "ours_gv")
LOCATORS = {"baseline": "Baseline", "ours": "Ours", "ours_imu": "Ours + IMU"}
PRIORS = {"none": "none", "colour": "colour", "colour_depth": "colour + depth", "full": "+ free space"}
DRIVE_FIGURES = ("pos_m", "yaw_deg", "interventions")
PLACE_FIGURES = ("pos_m", "yaw_deg")
VIEW_FIGURES = ("psnr_db", "ssim", "road_psnr_db", "foreground_psnr_db", "hidden_road_psnr_db", "road_depth_rmse_m")

COLOURS = {
    "expert": MUTED,
    "baseline": VERMILION,
    "imit": AMBER,
    "imit_gv": VERMILION,
    "ours": SKY,
    "ours_gv": BLUE,
    "ours_imu": BLUE,
    "none": VERMILION,
    "colour": AMBER,
    "colour_depth": SKY,
    "full": GREEN,
}

PAPER_TABLE_1 = (
    {"baseline": (0.13, 5.31), "ours": (0.17, 7.82), "ours_imu": (0.11, 2.26)},
    {"baseline": (0.15, 7.89), "ours": (0.21, 8.61), "ours_imu": (0.12, 1.59)},
    {"baseline": (0.12, 3.45), "ours": (0.18, 7.44), "ours_imu": (0.09, 1.12)},
)
"""Three arrangements of houses: method -> position, yaw."""
PAPER_TABLE_2 = (
    {"imit": (0.39, 6.71, 10), "imit_gv": (0.23, 3.89, 3), "ours": (0.36, 7.39, 5), "ours_gv": (0.11, 2.21, 1)},
    {"imit": (0.27, 13.8, 5), "imit_gv": (0.14, 7.29, 1), "ours": (0.20, 7.47, 2), "ours_gv": (0.09, 3.73, 0)},
    {"imit": (0.34, 14.16, 8), "imit_gv": (0.24, 10.60, 2), "ours": (0.16, 10.75, 3), "ours_gv": (0.12, 3.57, 1)},
)
"""Three trajectories: method -> position, yaw, interventions."""


def town_key(number: int) -> str:
    """Under which name an arrangement of the houses stands in Table I."""
    return f"layout_{number}"


def paper_place(town: str, method: str) -> tuple[float, float] | None:
    """The paper's position and yaw error in the arrangement that stands in the same line, None beyond its three."""
    number = int(town.removeprefix("layout_"))
    return PAPER_TABLE_1[number].get(method) if number < len(PAPER_TABLE_1) else None


def paper_drive(number: int, method: str) -> tuple[float, float, int] | None:
    """The paper's position and yaw error and interventions on the trajectory of that number, None beyond its three."""
    return PAPER_TABLE_2[number].get(method) if number < len(PAPER_TABLE_2) else None
