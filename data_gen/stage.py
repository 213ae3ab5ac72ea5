"""A stage for meshes from files: the figure stands on a ground plane beside a coloured wall, with open space around.

Wall and ground are one-sided and face the figure, which keeps its triangles as they came.
"""

import numpy as np
from jaxtyping import Float, Int

from data_gen.geometry import Part, assemble, quad
from prt_bench.scene import Camera, Material, Scene

GROUND, WALL, FIGURE = range(3)


def on_stage(name: str, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Scene:
    """Ground y = 0, 2.5 × 2.4 m, and wall x = −1.1, 1.3 m high; the figure is set down on its lowest vertex."""
    materials = (
        Material("ground", (0.6, 0.6, 0.6)),
        Material("wall", (0.7, 0.16, 0.08)),
        Material("figure", (0.55, 0.55, 0.55)),
    )
    figure = Part(vertices, faces, FIGURE).transformed(np.eye(3), (0.0, -vertices[:, 1].min(), 0.0))
    parts = [
        quad([(-1.1, 0, 1.2), (1.4, 0, 1.2), (1.4, 0, -1.2), (-1.1, 0, -1.2)], GROUND),
        quad([(-1.1, 0, 1.2), (-1.1, 0, -1.2), (-1.1, 1.3, -1.2), (-1.1, 1.3, 1.2)], WALL),
        figure,
    ]
    return Scene(name, assemble(parts), materials, Camera((1.3, 1.5, 3.6), (0.1, 0.42, 0.0), fov_y=35.0))
