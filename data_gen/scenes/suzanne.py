"""Suzanne on a ground plane between a coloured wall and open space: interreflection on a real, curved mesh.

The mesh (CC0, `assets/SOURCES.md`) leans on chin and back of the head. It is three open shells (head and eyes), as it came.
"""

import numpy as np
import trimesh

from data_gen import assets
from data_gen.geometry import rotation_about
from data_gen.stage import on_stage
from prt_bench.scene import Scene

REST_TILT = -35.89
"""Rotation about x in degrees at which the convex hull's flat below chin and skull lies on the ground."""


def build() -> Scene:
    """Suzanne 1.86 m wide, looking at +z."""
    source = trimesh.load_mesh(assets.SUZANNE, process=False)
    return on_stage(
        "suzanne", np.array(source.vertices, float) @ rotation_about(0, REST_TILT).T, np.array(source.faces)
    )
