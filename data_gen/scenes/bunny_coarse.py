"""The bunny in a few thousand triangles, on the same stage: what a coarser mesh costs and saves.

The mesh is fetched by `prt-bench assets bunny`, and its vertices are clustered.
"""

from data_gen.fetch import read_fetched
from data_gen.geometry import clustered
from data_gen.scenes.bunny import SCALE
from data_gen.stage import on_stage
from prt_bench.scene import Scene

VERTICES = 2000


def build() -> Scene:
    """The bunny 1.28 m high. Raises `SceneError` when its mesh has not been fetched."""
    vertices, faces = clustered(*read_fetched("bunny"), VERTICES)
    return on_stage("bunny-coarse", SCALE * vertices, faces)
