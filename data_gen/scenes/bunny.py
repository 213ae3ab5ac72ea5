"""The Stanford bunny, 75,408 triangles, on a ground plane beside a coloured wall: a scanned mesh with fine relief.

The mesh is fetched by `prt-bench assets bunny`. It is one closed surface.
"""

from data_gen.fetch import read_fetched
from data_gen.stage import on_stage
from prt_bench.scene import Scene

SCALE = 1.3
"""Metres per unit of the file."""


def build() -> Scene:
    """The bunny 1.28 m high. Raises `SceneError` when its mesh has not been fetched."""
    vertices, faces = read_fetched("bunny")
    return on_stage("bunny", SCALE * vertices, faces)
