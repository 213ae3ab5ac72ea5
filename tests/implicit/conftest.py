"""One of every shape and operation, for tests that hold for all of them."""

import numpy as np
from scipy.spatial.transform import Rotation

from prt_bench.implicit.grid import GridDistance
from prt_bench.implicit.operations import (
    Difference,
    Intersection,
    Moved,
    Scaled,
    SmoothIntersection,
    SmoothUnion,
    Turned,
    Union,
)
from prt_bench.implicit.scene import ImplicitScene, Part
from prt_bench.implicit.shapes import Box, Cylinder, Gyroid, Mandelbulb, Plane, Sphere, Torus
from prt_bench.scene import Camera, Glossy, Material

TURN = Rotation.from_euler("xyz", (20, 40, 60), degrees=True).as_matrix()
CAMERA = Camera((0.0, 0.6, 4.0), (0.0, 0.0, 0.0))
NODES = np.linspace(-1.0, 1.0, 20)


def sphere_grid() -> GridDistance:
    z, y, x = np.meshgrid(NODES, NODES, NODES, indexing="ij")
    return GridDistance((np.sqrt(x * x + y * y + z * z) - 0.6).ravel(), (-1.0, -1.0, -1.0), 2.0 / 19)


EXACT = {
    "sphere": Sphere(0.7),
    "box": Box((0.3, 0.5, 0.7), 0.1),
    "torus": Torus(0.6, 0.2),
    "cylinder": Cylinder(0.4, 0.5),
    "plane": Plane((0.0, 0.6, 0.8), 0.1),
    "union": Union(Moved(Sphere(0.3), (0.8, 0.0, 0.0)), Turned(Box((0.2, 0.3, 0.4)), TURN)),
    "scaled": Scaled(Moved(Torus(0.6, 0.2), (0.1, 0.2, 0.3)), 0.5),
}
BOUNDED = {
    "intersection": Intersection(Sphere(0.7), Box((0.5, 0.5, 0.5))),
    "difference": Difference(Box((0.5, 0.5, 0.5)), Sphere(0.6)),
    "smooth union": SmoothUnion(Sphere(0.5), Moved(Box((0.3, 0.3, 0.3)), (0.5, 0.1, 0.0)), 0.2),
    "smooth intersection": SmoothIntersection(Turned(Box((0.5, 0.5, 0.5)), TURN), Scaled(Gyroid(0.9), 0.5), 0.1),
    "gyroid": Gyroid(0.9, 0.4),
    "grid": sphere_grid(),
    "bulb": Mandelbulb(2),
}
SHAPES = {**EXACT, **BOUNDED}


def alone(shape, name="alone", glossy=None, albedo=(0.5, 0.5, 0.5), box=None):
    return ImplicitScene(name, (Part(shape, Material("grey", albedo, glossy=glossy)),), CAMERA, box)


def two_spheres() -> ImplicitScene:
    """A small glossy ball above a large red one."""
    return ImplicitScene(
        "two spheres",
        (
            Part(Sphere(0.5), Material("large", (0.6, 0.2, 0.1))),
            Part(
                Moved(Sphere(0.25), (0.2, 0.85, 0.1)),
                Material("small", (0.3, 0.3, 0.4), glossy=Glossy((0.3, 0.3, 0.3))),
            ),
        ),
        CAMERA,
    )
