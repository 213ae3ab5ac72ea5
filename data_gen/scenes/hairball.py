"""A ball of fair hair over the ground, lit through and through; the number of strands is an argument of `build`.

The built-in scene has few enough strands for a quick look; `build(140_000)` has as many as the hairball of Belcour et al. 2022.
"""

import numpy as np
import trimesh

from data_gen.geometry import assemble, quad, solid
from data_gen.strands import Growth, grow
from prt_bench.errors import SceneError
from prt_bench.hair import Hair, absorption_of
from prt_bench.scene import Camera, Material, Scene

GROUND, CORE, FIBRES = range(3)
STRANDS = 2_000
_COVER = 1.0
"""Width of all strands together, end to end, over the ball's surface: how dense the hair is, whatever the number of strands."""
_CORE, _LENGTH = 0.12, 0.2


def build(strands: int = STRANDS) -> Scene:
    """Ground y = 0, 1.6 × 1.6 m; the core has a radius of 12 cm and strands are 20 cm long, thinner where there are more."""
    if strands < 1:
        raise SceneError(f"a hairball of {strands} strands was asked for; grow at least one")
    materials = (
        Material("ground", (0.5, 0.5, 0.5)),
        Material("core", (0.3, 0.22, 0.15)),
        Material("hair", hair=Hair.of_roughness(absorption_of((0.85, 0.68, 0.42)), 0.3, 0.3)),
    )
    core = solid(trimesh.creation.icosphere(subdivisions=3, radius=_CORE), CORE)
    parts = [
        quad([(-0.8, 0, 0.8), (0.8, 0, 0.8), (0.8, 0, -0.8), (-0.8, 0, -0.8)], GROUND),
        core.transformed(np.eye(3), (0.0, 0.36, 0.0)),
    ]
    bare = Scene("hairball", assemble(parts), materials, Camera((0.5, 0.75, 1.2), (0.0, 0.3, 0.0), fov_y=38.0))
    radius = _COVER * 4.0 * np.pi * (_CORE + _LENGTH) ** 2 / (2.0 * strands * _LENGTH)
    growth = Growth(_LENGTH, radius, segments=5, spread=0.25, fall=0.4, curl=0.5)
    return grow(bare, CORE, FIBRES, strands, growth, seed=1)
