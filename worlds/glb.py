"""Exporting a scene as GLB, so that Blender or any glTF viewer shows the same bodies with the same colours."""

from pathlib import Path

import numpy as np
import trimesh

from hashnerf.errors import UserError
from worlds.meshes import Mesh
from worlds.scene import Scene

# glTF has y up and z towards the viewer; importers with z up turn it back.
Z_UP_TO_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def export_glb(scene: Scene, path: Path) -> None:
    """Writes one node a body, below it one mesh a colour; raises UserError if the file cannot be written."""
    out = trimesh.Scene()
    bodies = [*scene.world.static, *((name, scene.mesh(name)) for name in scene.poses)]
    for name, mesh in bodies:
        out.graph.update(frame_to=name, frame_from=out.graph.base_frame, matrix=Z_UP_TO_Y_UP)
        for number, part in enumerate(_one_per_colour(mesh)):
            out.add_geometry(part, node_name=f"{name}.{number}", geom_name=f"{name}.{number}", parent_node_name=name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(out.export(file_type="glb"))
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error}); choose another --glb file.") from error


def _one_per_colour(mesh: Mesh) -> list[trimesh.Trimesh]:
    """Glossy paint becomes a smoother material; faces keep their own corners, so edges stay sharp."""
    looks, which = np.unique(np.column_stack([mesh.colour, mesh.gloss]), axis=0, return_inverse=True)
    parts = []
    for number, look in enumerate(looks):
        corners = mesh.vertices[mesh.faces[which.reshape(-1) == number]].reshape(-1, 3)
        material = trimesh.visual.material.PBRMaterial(
            baseColorFactor=np.append(np.rint(255 * look[:3]), 255).astype(np.uint8),
            metallicFactor=0.0,
            roughnessFactor=float(1.0 - 2.0 * min(look[3], 0.35)),
        )
        faces = np.arange(len(corners)).reshape(-1, 3)
        visual = trimesh.visual.TextureVisuals(material=material)
        parts.append(trimesh.Trimesh(corners, faces, visual=visual, process=False))
    return parts
