"""Embree ray casting over merged meshes (float32, metres, unit directions).

`face` is the row of the merged face arrays and -1 for a ray that hits nothing, whose distance is infinite.
"""

from collections.abc import Sequence

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float32, Int32

from worlds.meshes import Mesh, merge


class Caster:
    """A bounding volume hierarchy over several meshes, each with an object id > 0."""

    def __init__(self, meshes: Sequence[tuple[int, Mesh]]):
        self.empty = not meshes
        if self.empty:
            self.object_id = np.zeros(1, np.int32)  # what a ray that hits nothing looks up
            return
        self.mesh = merge([mesh for _, mesh in meshes])
        self.object_id = np.concatenate([np.full(len(mesh.faces), number, np.int32) for number, mesh in meshes])
        corners = self.mesh.vertices[self.mesh.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.normal = (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)).astype(np.float32)
        self._scene = EmbreeScene()
        self._geometry = TriangleMesh(self._scene, self.mesh.vertices, self.mesh.faces)

    def cast(
        self, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"]
    ) -> tuple[Float32[np.ndarray, " n"], Int32[np.ndarray, " n"]]:
        """Distance to and face of the first hit of each ray."""
        if self.empty or not len(origins):
            return np.full(len(origins), np.inf, np.float32), np.full(len(origins), -1, np.int32)
        hit = self._scene.run(origins, directions, query="INTERSECT", output=1)
        face = hit["primID"]
        return np.where(face >= 0, hit["tfar"], np.float32(np.inf)), face

    def occluded(
        self, origins: Float32[np.ndarray, "n 3"], direction: Float32[np.ndarray, " 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether anything lies from each origin along one common direction."""
        if self.empty or not len(origins):
            return np.zeros(len(origins), bool)
        directions = np.ascontiguousarray(np.broadcast_to(direction, origins.shape))
        return self._scene.run(origins, directions, query="OCCLUDED") >= 0
