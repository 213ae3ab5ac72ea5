"""The plants with leaves and ground in smaller triangles, for values kept at vertices.

Surface, materials and camera are those of `plants`.
"""

from data_gen.geometry import subdivided
from data_gen.scenes import plants
from prt_bench.scene import Scene

LONGEST_EDGE = 0.056
"""In metres."""


def build() -> Scene:
    """The plants, subdivided before their leaves get a second side."""
    return plants.scene("plants-fine", subdivided(plants.sheets(), LONGEST_EDGE))
