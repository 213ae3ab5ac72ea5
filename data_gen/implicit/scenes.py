"""The implicit scenes that are shipped: each stands on a floor beside a coloured wall, two metres and a half across.

What each is for is said at its function; the parts of a scene with unusual needs are in `prt_bench/implicit`.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh

from data_gen import assets
from data_gen.geometry import rotation_about
from data_gen.implicit.mesh import grid_of
from prt_bench.errors import SceneError
from prt_bench.implicit.grid import GridDistance
from prt_bench.implicit.operations import (
    Difference,
    Moved,
    Scaled,
    SmoothIntersection,
    SmoothUnion,
    Turned,
)
from prt_bench.implicit.scene import ImplicitScene, Part
from prt_bench.implicit.shapes import Box, Cylinder, Gyroid, Mandelbulb, Sphere, Torus
from prt_bench.scene import Camera, Glossy, Material

_CAMERA = Camera((1.5, 1.35, 3.1), (0.05, 0.4, 0.0), fov_y=35.0)
_SHINY = Glossy((0.3, 0.3, 0.3), 24.0)


def blend() -> ImplicitScene:
    """Primitives under smooth union and smooth intersection: a figure of rounded bodies, and a die with a bite."""
    arms = Turned(Torus(0.3, 0.09), rotation_about(0, 90.0))
    figure = SmoothUnion(
        SmoothUnion(Moved(Sphere(0.3), (0.0, 0.3, 0.0)), Moved(arms, (0.0, 0.62, 0.0)), 0.15),
        Moved(Cylinder(0.07, 0.5), (0.0, 0.5, 0.0)),
        0.12,
    )
    die = SmoothIntersection(Box((0.24, 0.24, 0.24)), Sphere(0.3), 0.06)
    bitten = Difference(die, Moved(Sphere(0.2), (0.12, 0.2, 0.2)))
    return _on_stage(
        "implicit-blend",
        Part(Moved(figure, (-0.2, 0.0, -0.1)), Material("figure", (0.5, 0.5, 0.5), glossy=_SHINY)),
        Part(
            Moved(Turned(bitten, rotation_about(1, 30.0)), (0.6, 0.235, 0.45)),
            Material("die", (0.25, 0.35, 0.6), glossy=Glossy((0.2, 0.2, 0.2), 60.0)),
        ),
    )


def gyroid() -> ImplicitScene:
    """A ball cut from a gyroid's wall: every point is shadowed by the surface itself."""
    ball = SmoothIntersection(Sphere(0.55), Gyroid(0.5, 0.35), 0.04)
    return _on_stage(
        "implicit-gyroid", Part(Moved(ball, (0.0, 0.5, 0.0)), Material("gyroid", (0.6, 0.6, 0.55), glossy=_SHINY))
    )


def bulb() -> ImplicitScene:
    """A mandelbulb of two iterations: lobes on lobes, no finer than what samples and pixels resolve."""
    body = Turned(Scaled(Mandelbulb(2), 0.5), rotation_about(0, -90.0))
    return _on_stage(
        "implicit-bulb", Part(Moved(body, (0.0, 0.55, 0.0)), Material("bulb", (0.6, 0.5, 0.4), glossy=_SHINY))
    )


def suzanne() -> ImplicitScene:
    """Suzanne as a distance on a grid of 64³ nodes made from the mesh, whose three shells are open."""
    figure = _suzanne_grid(64)
    lift = -float(_lowest(figure))
    return _on_stage(
        "implicit-suzanne",
        Part(Moved(figure, (0.15, lift, 0.0)), Material("figure", (0.55, 0.55, 0.55), glossy=_SHINY)),
    )


SCENES: dict[str, Callable[[], ImplicitScene]] = {each.__name__: each for each in (blend, gyroid, bulb, suzanne)}
"""By name."""


def load_implicit(name: str) -> ImplicitScene:
    """A shipped scene. Raises `SceneError` for a name that is none."""
    if name not in SCENES:
        raise SceneError(f"there is no implicit scene '{name}'; there are {', '.join(SCENES)}")
    return SCENES[name]()


def _on_stage(name: str, *parts: Part) -> ImplicitScene:
    ground = Part(Moved(Box((1.25, 0.05, 1.2)), (0.15, -0.05, 0.0)), Material("ground", (0.6, 0.6, 0.6)))
    wall = Part(Moved(Box((0.05, 0.7, 1.2)), (-1.15, 0.6, 0.0)), Material("wall", (0.7, 0.16, 0.08)))
    return ImplicitScene(name, (ground, wall, *parts), _CAMERA)


@cache
def _suzanne_grid(side: int) -> GridDistance:
    source = trimesh.load_mesh(assets.SUZANNE, process=False)
    turned = 0.85 * np.array(source.vertices, float) @ rotation_about(0, -35.89).T
    return grid_of(turned, np.array(source.faces), side)


def _lowest(figure: GridDistance) -> float:
    """Height of the lowest node inside, and a cell less."""
    side = figure.side
    inside = np.asarray(figure.values).reshape(side, side, side) < 0
    return float(np.asarray(figure.low)[1]) + figure.cell * (np.flatnonzero(inside.any(axis=(0, 2)))[0] - 0.5)
