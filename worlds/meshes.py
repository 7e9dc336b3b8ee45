"""Coloured triangle meshes: solids with one linear albedo, grain and gloss per face.

Metres, z up, outward counter-clockwise faces. Every detail that the renderer shows (lane marks, windows, wheels) is
geometry or a per-face material, so an exported mesh shows the same scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float, Float32, Int32

Number = float | int
Span = tuple[Number, Number]
Point = Sequence[Number] | Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class Material:
    """How a face reflects: linear albedo, relative amplitude of its low-frequency mottling, mirror share of the sky."""

    colour: tuple[Number, Number, Number]
    grain: float = 0.0
    gloss: float = 0.0


@dataclass(frozen=True)
class Mesh:
    """Triangles with per-face linear `colour`, `grain` (0..1) and `gloss` (0..1)."""

    vertices: Float32[np.ndarray, "v 3"]
    faces: Int32[np.ndarray, "f 3"]
    colour: Float32[np.ndarray, "f 3"]
    grain: Float32[np.ndarray, " f"]
    gloss: Float32[np.ndarray, " f"]

    def placed(self, x: Number, y: Number, z: Number, yaw: Number) -> "Mesh":
        """The mesh turned by `yaw` (radians, counter-clockwise from above) and then moved by (x, y, z) metres."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        vertices = self.vertices.astype(np.float64) @ turn.T + np.array([x, y, z])
        return Mesh(vertices.astype(np.float32), self.faces, self.colour, self.grain, self.gloss)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the axis-aligned box, metres."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)]).astype(np.float64)


def painted(vertices: np.ndarray, faces: np.ndarray, material: Material) -> Mesh:
    """A mesh of one material."""
    count = len(faces)
    return Mesh(
        np.asarray(vertices, np.float32),
        np.asarray(faces, np.int32),
        np.tile(np.asarray(material.colour, np.float32), (count, 1)),
        np.full(count, material.grain, np.float32),
        np.full(count, material.gloss, np.float32),
    )


def merge(parts: Sequence[Mesh]) -> Mesh:
    """One mesh out of several (at least one)."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + np.int32(offset) for part, offset in zip(parts, offsets)]),
        np.concatenate([part.colour for part in parts]),
        np.concatenate([part.grain for part in parts]),
        np.concatenate([part.gloss for part in parts]),
    )


_HEXAHEDRON = np.array(
    [0, 2, 1, 0, 3, 2, 4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4, 1, 2, 6, 1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7]
).reshape(-1, 3)


def hexahedron(bottom: Sequence[Point], top: Sequence[Point], material: Material) -> Mesh:
    """A solid between two quadrilaterals, each four corners counter-clockwise seen from above."""
    return painted(np.array([*bottom, *top], np.float64), _HEXAHEDRON, material)


def block(low: Point, high: Point, material: Material) -> Mesh:
    """An axis-aligned box from its lowest to its highest corner, metres."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return hexahedron([(x, y, z0) for x, y in ring], [(x, y, z1) for x, y in ring], material)


def tapered(
    x: Span, top_x: Span, half_width: Span, z: Span, material: Material,
) -> Mesh:  # fmt: skip
    """A solid symmetric in y: rectangle `x` x 2 `half_width[0]` at `z[0]`, `top_x` x 2 `half_width[1]` at `z[1]`."""

    def ring(span, half, height):
        return [(span[0], -half, height), (span[1], -half, height), (span[1], half, height), (span[0], half, height)]

    return hexahedron(ring(x, half_width[0], z[0]), ring(top_x, half_width[1], z[1]), material)


def quad(corners: Sequence[Point], material: Material) -> Mesh:
    """A one-sided flat panel; corners counter-clockwise seen from its front."""
    return painted(np.array(corners, np.float64), np.array([[0, 1, 2], [0, 2, 3]]), material)


def cylinder(centre: Point, radius: float, height: float, material: Material, axis: str = "z", sides: int = 20) -> Mesh:
    """A capped cylinder around `centre` with its axis along "y" or "z"."""
    solid = trimesh.creation.cylinder(radius=radius, height=height, sections=sides)
    points = solid.vertices
    if axis == "y":
        points = points @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return painted(points + np.asarray(centre, np.float64), solid.faces, material)


def blob(centre: Point, radii: Point, material: Material, rng: np.random.Generator) -> Mesh:
    """A lumpy ellipsoid (foliage)."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    lumps = 1.0 + 0.12 * rng.standard_normal((len(ball.vertices), 1))
    return painted(
        ball.vertices * lumps * np.asarray(radii, np.float64) + np.asarray(centre, np.float64), ball.faces, material
    )
