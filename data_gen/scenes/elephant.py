"""An elephant, 88,928 triangles, on a ground plane beside a coloured wall: legs, trunk and ears shadow each other.

The mesh is fetched by `prt-bench assets elephant`. It is one closed surface.
"""

from data_gen.fetch import read_fetched
from data_gen.stage import on_stage
from prt_bench.scene import Scene

SCALE = 1.4
"""Metres per unit of the file."""


def build() -> Scene:
    """The elephant 1.39 m high. Raises `SceneError` when its mesh has not been fetched."""
    vertices, faces = read_fetched("elephant")
    return on_stage("elephant", SCALE * vertices, faces)
