"""A maze of eleven rooms of one size, each open to its neighbours or walled off: what modular transfer is made of.

The random maze of `prt_bench.modular.level` of 11 blocks and seed 0, with a wooden floor and coloured walls towards −z and +z.
`experiments/levels/maze.toml` is the same level for the method `modular`.
"""

from dataclasses import replace

from data_gen.levels import scene_of
from prt_bench.modular.level import maze
from prt_bench.scene import Camera, Scene

BLOCKS, SEED = 11, 0
GREY = (0.7, 0.7, 0.7)
ALBEDO = (GREY, GREY, GREY, (0.5, 0.4, 0.3), (0.3, 0.5, 0.7), (0.7, 0.3, 0.2))
"""Of walls +x and −x, ceiling, floor, and walls +z and −z."""


def build() -> Scene:
    """Rooms of 3 m by 3 m, 3 m high, walls 3 cm thick, seen from a corner of the first one."""
    camera = Camera((-1.3, 0.3, -1.3), (2.0, -0.5, 2.6), fov_y=65.0)
    return replace(scene_of(maze(BLOCKS, SEED), ALBEDO), name="maze", camera=camera)
