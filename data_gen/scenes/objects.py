"""Separate bodies on a ground, round and edged: a scene of several objects, each with triangles of its own size.

A sphere, a torus, blocks, a cone and a pillar, every one closed; `objects-fine` subdivides them. Sphere, torus, blocks and
pillar have glossy lobes from sharp to wide, which diffuse transfer leaves out.
"""

import numpy as np
import trimesh

from data_gen.geometry import assemble, box, quad, rotation_about, solid
from prt_bench.scene import Camera, Glossy, Material, Scene

GROUND, SPHERE, TORUS, BLOCK, CONE, PILLAR = range(6)


def build() -> Scene:
    """Ground y = 0, 3 × 2.4 m; the bodies stand on it, and the torus leans on the pillar."""
    materials = (
        Material("ground", (0.6, 0.6, 0.58)),
        Material("sphere", (0.55, 0.52, 0.12), glossy=Glossy((0.35, 0.35, 0.35), 200.0)),
        Material("torus", (0.15, 0.4, 0.6), glossy=Glossy((0.3, 0.3, 0.3), 40.0)),
        Material("block", (0.6, 0.14, 0.09), glossy=Glossy((0.25, 0.25, 0.25), 15.0)),
        Material("cone", (0.2, 0.5, 0.22)),
        Material("pillar", (0.6, 0.58, 0.56), glossy=Glossy((0.35, 0.33, 0.3), 5.0)),
    )
    upright = rotation_about(0, -90.0)
    sphere = solid(trimesh.creation.icosphere(subdivisions=3, radius=0.32), SPHERE)
    torus = solid(trimesh.creation.torus(0.3, 0.1, major_sections=32, minor_sections=14), TORUS)
    cone = solid(trimesh.creation.cone(0.28, 0.75, sections=24), CONE)
    pillar = solid(trimesh.creation.cylinder(0.16, 1.1, sections=24), PILLAR)
    parts = [
        quad([(-1.5, 0, 1.2), (1.5, 0, 1.2), (1.5, 0, -1.2), (-1.5, 0, -1.2)], GROUND),
        sphere.transformed(np.eye(3), (0.05, 0.32, 0.45)),
        torus.transformed(rotation_about(0, -12.0), (-0.35, 0.3913, -0.175)),
        box((0.24, 0.24, 0.24), BLOCK).transformed(rotation_about(1, 28.0), (0.8, 0.24, 0.1)),
        cone.transformed(upright, (-0.95, 0.0, 0.25)),
        pillar.transformed(upright, (-0.35, 0.55, -0.5)),
        box((0.6, 0.09, 0.16), BLOCK).transformed(rotation_about(1, -8.0), (0.65, 0.09, -0.55)),
    ]
    return Scene("objects", assemble(parts), materials, Camera((0.9, 1.7, 3.6), (-0.05, 0.35, -0.05), fov_y=38.0))
