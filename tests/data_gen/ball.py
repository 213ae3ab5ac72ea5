"""A translucent ball over the ground beside a wall, as the tests of media share it."""

from pathlib import Path

import numpy as np
import trimesh

import prt_bench as prt
from data_gen.geometry import assemble, quad, solid
from data_gen.trace import trace
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.lights import Lighting, PointLight
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Material, Scene

GROUND, WALL, BALL = range(3)
BLACK = (0.0, 0.0, 0.0)
MEDIUM = Subsurface.of_albedo((0.97, 0.95, 0.85), (0.1, 0.12, 0.2), 0.3, 1.3)
SMALL = {"scenario": "point", "lightings": 10, "texels": 24, "rays": 32, "measurements": 24, "supersampling": 2}
LAMP = Lighting([PointLight([0.3, 0.9, -1.0], (3.0, 2.0, 1.0), 0.0)])


def room(medium: Subsurface | None = MEDIUM, albedo: tuple[float, float, float] = BLACK) -> Scene:
    """A ball of radius 0.4 over the ground beside a wall."""
    ball = solid(trimesh.creation.icosphere(subdivisions=2, radius=0.4), BALL)
    parts = [
        quad([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], GROUND),
        quad([(-1, 0, 1), (-1, 0, -1), (-1, 1, -1), (-1, 1, 1)], WALL),
        ball.transformed(np.eye(3), (-0.1, 0.45, 0.0)),
    ]
    materials = (
        Material("ground", (0.6, 0.6, 0.6)),
        Material("wall", (0.7, 0.2, 0.1)),
        Material("ball", albedo, subsurface=medium),
    )
    return Scene("ball", assemble(parts), materials, Camera((0.6, 0.9, 2.6), (-0.1, 0.4, 0.0)))


def traced(scene: Scene, folder: Path, **settings: int) -> Transport:
    return trace(scene, prt.plan(scene, **{"texels": 24, "rays": 32, **settings}), 0, folder, Tracer(scene))
