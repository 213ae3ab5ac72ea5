"""The objects in triangles with edges of a few centimetres, for values kept at vertices.

Surface, materials and camera are those of `objects`.
"""

from dataclasses import replace

from data_gen.geometry import subdivided
from data_gen.scenes import objects
from prt_bench.scene import Scene

LONGEST_EDGE = 0.07
"""In metres."""


def build() -> Scene:
    """The objects, subdivided."""
    scene = objects.build()
    return replace(scene, name="objects-fine", mesh=subdivided(scene.mesh, LONGEST_EDGE))
