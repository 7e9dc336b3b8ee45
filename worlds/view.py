"""Rendering one camera: colour with 2x2 anti-aliasing; depth and object ids from one ray through each pixel centre.

The static world does not change between states, so what a camera sees of it is computed once (`StaticView`) and every
state only adds its moving bodies and their shadows. Depth is metres along the optical axis, 0 where nothing is hit;
object id 0 is nothing.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Int, Int32, UInt8

from hashnerf.cameras import Cameras, camera_rays
from worlds.raycast import Caster
from worlds.shading import FaceLight, Light, mottle, sky_colour, to_uint8

SHADOW_OFFSET = np.float32(5e-3)
_SUBPIXELS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))


@dataclass(frozen=True)
class View:
    """What one camera sees of one state."""

    rgb: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    object_id: Int32[np.ndarray, "h w"]


@dataclass(frozen=True)
class _Rays:
    origins: Float32[np.ndarray, "n 3"]
    directions: Float32[np.ndarray, "n 3"]


def _pixel_rays(cameras: Cameras, index: int, offsets: tuple[tuple[float, float], ...]) -> _Rays:
    """Rays through every pixel centre plus each offset (pixels), offset-major."""
    rows, columns = torch.meshgrid(torch.arange(cameras.height), torch.arange(cameras.width), indexing="ij")
    centres = torch.stack([columns, rows], -1).reshape(-1, 2).to(torch.float32) + 0.5
    pixel = torch.cat([centres + torch.tensor(offset) for offset in offsets])
    rays = camera_rays(cameras, torch.full((len(pixel),), index, dtype=torch.int64), pixel)
    return _Rays(
        np.ascontiguousarray(rays.origins.numpy(), np.float32),
        np.ascontiguousarray(rays.directions.numpy(), np.float32),
    )


@dataclass(frozen=True)
class _Surface:
    """First hits of rays: radiance without sun, radiance of unshadowed sun, and where shadows must be asked for."""

    distance: Float32[np.ndarray, " n"]
    ambient: Float32[np.ndarray, "n 3"]
    sun: Float32[np.ndarray, "n 3"]
    sunlit: Int32[np.ndarray, " k"]
    shadow_origin: Float32[np.ndarray, "k 3"]


class LitBodies:
    """Bodies ready for casting, with the light on their faces; possibly no body at all."""

    def __init__(self, caster: Caster, light: Light):
        self.caster, self.sun = caster, light.direction
        self.face_light = None if caster.empty else FaceLight(caster, light)


def _surface(
    bodies: LitBodies,
    rays: _Rays,
    which: Int[np.ndarray, " n"],
    distance: Float32[np.ndarray, " n"],
    face: Int32[np.ndarray, " n"],
) -> _Surface:
    """Shades the rays `which` that hit `face` at `distance`."""
    light = bodies.face_light
    assert light is not None
    origins, directions = rays.origins[which], rays.directions[which]
    points = origins + directions * distance[:, None]
    grain = light.grain[face]
    tint = (np.float32(1.0) + grain * mottle(points))[:, None]
    ambient = light.ambient[face] * tint
    gloss = light.gloss[face]
    shiny = np.flatnonzero(gloss)
    normal = light.normal[face]
    if len(shiny):
        along = (directions[shiny] * normal[shiny]).sum(1, keepdims=True)
        mirrored = directions[shiny] - 2.0 * along * normal[shiny]
        ambient[shiny] += gloss[shiny, None] * sky_colour(mirrored)
    sunlit = np.flatnonzero(light.sunlit[face]).astype(np.int32)
    shadow_origin = points[sunlit] + SHADOW_OFFSET * normal[sunlit]
    return _Surface(distance, ambient, light.sun[face] * tint, sunlit, shadow_origin)


class StaticView:
    """What one camera sees of the static world; `with_bodies` adds the moving bodies of a state."""

    def __init__(self, stage: LitBodies, cameras: Cameras, index: int):
        self.stage, self.shape = stage, (cameras.height, cameras.width)
        self._forward = -cameras.pose[index, :3, 2].numpy().astype(np.float32)
        self._centre = _pixel_rays(cameras, index, ((0.0, 0.0),))
        self._fine = _pixel_rays(cameras, index, _SUBPIXELS)
        self._centre_distance, face = stage.caster.cast(self._centre.origins, self._centre.directions)
        self._centre_id = np.where(face >= 0, stage.caster.object_id[face], 0).astype(np.int32)
        distance, face = stage.caster.cast(self._fine.origins, self._fine.directions)
        hit = np.flatnonzero(face >= 0)
        self._distance = distance
        self._ambient = sky_colour(self._fine.directions)
        self._lit, self._lit_origin, self._lit_sun = hit[:0], self._fine.origins[:0], self._ambient[:0]
        if not len(hit):  # an empty sky has no light on faces
            return
        surface = _surface(stage, self._fine, hit, distance[hit], face[hit])
        free = ~stage.caster.occluded(surface.shadow_origin, stage.sun)
        lit = surface.sunlit[free]
        self._ambient[hit] = surface.ambient
        self._lit, self._lit_origin, self._lit_sun = hit[lit], surface.shadow_origin[free], surface.sun[lit]

    def with_bodies(self, bodies: LitBodies) -> View:
        """The image, depth and object ids of the static world plus `bodies`."""
        radiance = self._ambient.copy()
        shadowed = bodies.caster.occluded(self._lit_origin, self.stage.sun)
        radiance[self._lit[~shadowed]] += self._lit_sun[~shadowed]
        self._add_bodies(bodies, radiance)
        height, width = self.shape
        rgb = to_uint8(radiance.reshape(len(_SUBPIXELS), height, width, 3).mean(0))
        distance, object_id = self._centre_distance, self._centre_id
        if not bodies.caster.empty:
            near, face = bodies.caster.cast(self._centre.origins, self._centre.directions)
            closer = near < distance
            object_id = np.where(closer, bodies.caster.object_id[face], object_id)
            distance = np.where(closer, near, distance)
        along = self._centre.directions @ self._forward
        depth = np.where(np.isfinite(distance), distance * along, 0.0).astype(np.float32)
        return View(rgb, depth.reshape(height, width), object_id.reshape(height, width))

    def _add_bodies(self, bodies: LitBodies, radiance: Float32[np.ndarray, "n 3"]) -> None:
        distance, face = bodies.caster.cast(self._fine.origins, self._fine.directions)
        closer = np.flatnonzero(distance < self._distance)
        if not len(closer):
            return
        surface = _surface(bodies, self._fine, closer, distance[closer], face[closer])
        free = ~(
            bodies.caster.occluded(surface.shadow_origin, self.stage.sun)
            | self.stage.caster.occluded(surface.shadow_origin, self.stage.sun)
        )
        lit = surface.sunlit[free]
        radiance[closer] = surface.ambient
        radiance[closer[lit]] += surface.sun[lit]

    def pixels_of(self, body: Caster) -> int:
        """How many pixels `body` would cover if nothing stood in front of it."""
        _, face = body.cast(self._centre.origins, self._centre.directions)
        return int((face >= 0).sum())
