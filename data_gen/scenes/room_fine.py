"""The room in triangles with edges of a few centimetres: what values at its vertices can hold of a table's shadow.

Surface, materials and camera are those of `room`.
"""

from dataclasses import replace

from data_gen.geometry import subdivided
from data_gen.scenes import room
from prt_bench.scene import Scene

LONGEST_EDGE = 0.063
"""In metres. It makes about 22,000 triangles; distant-light transfer was first shown per vertex on rooms of that size."""


def build() -> Scene:
    """The room, subdivided."""
    scene = room.build()
    return replace(scene, name="room-fine", mesh=subdivided(scene.mesh, LONGEST_EDGE))
