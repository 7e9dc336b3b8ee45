"""The OPENCV lens model on normalised image points (x right, y down, at unit depth).

coefficients = (k1, k2, p1, p2), r^2 = x^2 + y^2, radial = 1 + k1 r^2 + k2 r^4:
    x' = x radial + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y radial + p1 (r^2 + 2 y^2) + 2 p2 x y
A lens folds back on itself beyond the radius where r radial stops growing; points there have no unique inverse.
"""

import math
from functools import lru_cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hashnerf.transforms_json import is_number

NEWTON_STEPS = 30
MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")  # all are OPENCV with zeros
LENS_KEYS = ("camera_model", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y")
COEFFICIENT_KEYS = ("k1", "k2", "p1", "p2")
UNSUPPORTED_COEFFICIENTS = ("k3", "k4")
WIDEST_VIEW = 3.0  # radians (172 degrees): a perspective image that wide is an error of units


def distort(points: Float[Tensor, "n 2"], coefficients: Float[Tensor, "n 4"]) -> Float[Tensor, "n 2"]:
    """Ideal normalised image points -> where the lens puts them."""
    k1, k2, p1, p2 = coefficients.unbind(-1)
    x, y = points.unbind(-1)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    return torch.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        dim=-1,
    )


def largest_radius(coefficients: Float[Tensor, "n 4"]) -> Float[Tensor, " n"]:
    """The ideal radius up to which distortion is monotone (infinite where it never folds)."""
    k1, k2 = coefficients[:, 0].double(), coefficients[:, 1].double()
    # d/dr [r (1 + k1 r^2 + k2 r^4)] = 1 + 3 k1 s + 5 k2 s^2 with s = r^2; its smallest positive root ends the range.
    # 2c / (-b + sqrt(b^2 - 4ac)) is that root, and stays exact when k2 is zero.
    discriminant = 9 * k1 * k1 - 20 * k2
    denominator = -3 * k1 + discriminant.clamp(min=0).sqrt()
    folds = (discriminant >= 0) & (denominator > 0)
    root = 2 / torch.where(folds, denominator, 1.0)
    return torch.where(folds, root.sqrt(), torch.inf).to(coefficients.dtype)


def undistort(
    points: Float[Tensor, "n 2"], coefficients: Float[Tensor, "n 4"], tolerance: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n 2"], Bool[Tensor, " n"]]:
    """Inverts `distort` by Newton's method in float64.

    Returns the ideal points and a mask: true where the residual is at most `tolerance` (normalised units) on the
    monotone side of the lens. Carries no gradient.
    """
    target, lens = points.detach().double(), coefficients.detach().double()
    limit = largest_radius(lens)
    ideal = _shortened(target, limit / 2)
    for _ in range(NEWTON_STEPS):
        residual = distort(ideal, lens) - target
        if bool((residual.abs().amax(-1) <= 0.01 * tolerance).all()):
            break
        # A step across the fold would converge to the wrong side or nowhere: stop it halfway to the fold.
        halfway = (ideal.norm(dim=-1) + limit) / 2
        ideal = _shortened(ideal - _newton_step(ideal, residual, lens), halfway)
    residual = distort(ideal, lens) - target
    good = residual.abs().amax(-1) <= tolerance
    return ideal.to(points.dtype), good & (_jacobian_determinant(ideal, lens) > 0)


def _shortened(points: Float[Tensor, "n 2"], radius: Float[Tensor, " n"]) -> Float[Tensor, "n 2"]:
    return points * (radius / points.norm(dim=-1).clamp(min=1e-300)).clamp(max=1)[:, None]


def _jacobian(
    points: Float[Tensor, "n 2"], coefficients: Float[Tensor, "n 4"]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """d distort / d point, which is symmetric: (dx'/dx, dx'/dy = dy'/dx, dy'/dy)."""
    k1, k2, p1, p2 = coefficients.unbind(-1)
    x, y = points.unbind(-1)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    slope = 2 * (k1 + 2 * k2 * r2)
    xx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = x * y * slope + 2 * p1 * x + 2 * p2 * y
    yy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    return xx, xy, yy


def _jacobian_determinant(points: Float[Tensor, "n 2"], coefficients: Float[Tensor, "n 4"]) -> Float[Tensor, " n"]:
    xx, xy, yy = _jacobian(points, coefficients)
    return xx * yy - xy * xy


def _newton_step(
    points: Float[Tensor, "n 2"], residual: Float[Tensor, "n 2"], coefficients: Float[Tensor, "n 4"]
) -> Float[Tensor, "n 2"]:
    xx, xy, yy = _jacobian(points, coefficients)
    # A singular Jacobian gives an infinite step, then NaN, which the caller's mask reports as not converged.
    determinant = xx * yy - xy * xy
    step_x = (yy * residual[:, 0] - xy * residual[:, 1]) / determinant
    step_y = (xx * residual[:, 1] - xy * residual[:, 0]) / determinant
    return torch.stack([step_x, step_y], dim=-1)


def read_lens(keys: dict, width: int, height: int) -> tuple[list[float], list[str]]:
    """The lens in transforms.json keys: [fl_x, fl_y, cx, cy, k1, k2, p1, p2] and the problems found.

    A missing principal point is the image centre, a missing fl_y equals fl_x, missing coefficients are zero.
    """
    problems = [
        f"{key} = {str(keys[key])[:40]} is not a finite number"
        for key in (*LENS_KEYS[1:], *COEFFICIENT_KEYS, *UNSUPPORTED_COEFFICIENTS)
        if keys.get(key) is not None and not is_number(keys[key])
    ]
    if keys.get("camera_model", "OPENCV") not in MODELS:
        problems.append(
            f"camera_model {keys['camera_model']!r} is not supported; undistort to one of {', '.join(MODELS)}"
        )
    if problems:
        return [], problems
    if any(keys.get(key) for key in UNSUPPORTED_COEFFICIENTS):
        problems.append("k3 and k4 are not part of the OPENCV lens; undistort the images first")
    fl_x, problem_x = _focal(keys, "x", width)
    fl_y, problem_y = _focal(keys, "y", height)
    problems += [problem for problem in (problem_x, problem_y) if problem]
    if fl_x is None and not problem_x:
        problems.append("neither fl_x (pixels) nor camera_angle_x (radians) is given")
    centre = [_or(keys.get("cx"), width / 2), _or(keys.get("cy"), height / 2)]
    for name, value, side in (("cx", centre[0], width), ("cy", centre[1], height)):
        if not 0 < value < side:
            problems.append(f"{name} = {value:g} lies outside the image of {width}x{height} pixels")
    if problems:
        return [], problems
    coefficients = [float(_or(keys.get(key), 0.0)) for key in COEFFICIENT_KEYS]
    lens = [fl_x, _or(fl_y, fl_x), *centre, *coefficients]
    fold = _fold_problem(tuple(lens), width, height)
    return ([], [fold]) if fold else (lens, [])


def _focal(keys: dict, axis: str, side: int) -> tuple[float | None, str | None]:
    """The focal length of one axis in pixels, from fl_* or else from the field of view; (None, None) if not given."""
    focal, angle = keys.get(f"fl_{axis}"), keys.get(f"camera_angle_{axis}")
    if focal is not None:
        if focal <= 0:
            return None, f"fl_{axis} = {focal:g} must be above zero (pixels)"
        if 2 * math.atan2(side, 2 * focal) > WIDEST_VIEW:
            return (
                None,
                f"fl_{axis} = {focal:g} pixels is a view of over 170 degrees; give an angle as camera_angle_{axis}",
            )
        return float(focal), None
    if angle is None:
        return None, None
    if not 0 < angle <= WIDEST_VIEW:
        return None, f"camera_angle_{axis} = {angle:g} must be in radians, above 0 and at most {WIDEST_VIEW}"
    return side / (2 * math.tan(angle / 2)), None


@lru_cache(maxsize=256)  # the frames of a data set usually share one lens
def _fold_problem(lens: tuple[float, ...], width: int, height: int) -> str | None:
    """Whether the whole image border can be undistorted: a lens that folds back inside the image cannot be inverted."""
    if not any(lens[4:]):
        return None
    steps = torch.linspace(0, 1, 33, dtype=torch.float64)
    zero, one = torch.zeros_like(steps), torch.ones_like(steps)
    border = torch.cat([torch.stack(side, -1) for side in ((steps, zero), (steps, one), (zero, steps), (one, steps))])
    numbers = torch.tensor(lens, dtype=torch.float64)
    points = (border * torch.tensor([width, height]) - numbers[2:4]) / numbers[:2]
    tolerance = torch.full((len(points),), 1e-6 / max(lens[:2]), dtype=torch.float64)
    _, good = undistort(points, numbers[4:].expand(len(points), 4), tolerance)
    if bool(good.all()):
        return None
    radius = float(largest_radius(numbers[None, 4:]))
    names = ", ".join(f"{key} = {value:g}" for key, value in zip(COEFFICIENT_KEYS, lens[4:]))
    return (
        f"the lens ({names}) folds back inside the image: it can be inverted up to the radius {radius:.3f} only, "
        "and the corners lie beyond; check the coefficients or crop the images"
    )


def _or(value: float | int | None, default: float) -> float:
    return default if value is None else float(value)
