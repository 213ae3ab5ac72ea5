"""Suzanne on a ground plane between a coloured wall and open space: interreflection on a real, curved mesh.

The mesh (CC0, `assets/SOURCES.md`) leans on chin and back of the head. Wall and ground are one-sided, facing the
object; the mesh is three open shells (head and eyes), as it came.
"""

import numpy as np
import trimesh

from data_gen import assets
from data_gen.geometry import Part, assemble, quad, rotation_about
from prt_bench.scene import Camera, Material, Scene

GROUND, WALL, FIGURE = range(3)
REST_TILT = -35.89
"""Rotation about x in degrees at which the convex hull's flat below chin and skull lies on the ground."""


def build() -> Scene:
    """Ground y = 0 and wall x = −1.1; Suzanne 1.86 m wide, looking at +z."""
    materials = (
        Material("ground", (0.6, 0.6, 0.6)),
        Material("wall", (0.7, 0.16, 0.08)),
        Material("figure", (0.55, 0.55, 0.55)),
    )
    source = trimesh.load_mesh(assets.SUZANNE, process=False)
    tilted = Part(np.array(source.vertices, float), np.array(source.faces), FIGURE).transformed(
        rotation_about(0, REST_TILT)
    )
    figure = tilted.transformed(np.eye(3), (0.0, -tilted.vertices[:, 1].min(), 0.0))
    parts = [
        quad([(-1.1, 0, 1.2), (1.4, 0, 1.2), (1.4, 0, -1.2), (-1.1, 0, -1.2)], GROUND),
        quad([(-1.1, 0, 1.2), (-1.1, 0, -1.2), (-1.1, 1.3, -1.2), (-1.1, 1.3, 1.2)], WALL),
        figure,
    ]
    return Scene("suzanne", assemble(parts), materials, Camera((1.3, 1.5, 3.6), (0.1, 0.42, 0.0), fov_y=35.0))
