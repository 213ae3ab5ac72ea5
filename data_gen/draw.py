"""A picture of the measurement points on their scene, for looking at with one's own eyes. Needs no OpenGL."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from data_gen.tracer import Tracer
from prt_bench.dataset import LightingDataset
from prt_bench.scene import Camera, Scene

_HEIGHT, _WIDTH = 600, 800


def draw_measurement_points(ds: LightingDataset, path: Path) -> None:
    """Write a PNG of the scene from its camera, with the visible measurement points (black) over their dense ones."""
    scene, tracer = ds.scene, Tracer(ds.scene)
    figure = Figure(figsize=(_WIDTH / 100, _HEIGHT / 100), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(_ambient_view(scene, tracer), extent=(0, _WIDTH, _HEIGHT, 0))
    for points, colour, size in ((ds.dense_points, "tab:orange", 3.0), (ds.measurement_points, "black", 10.0)):
        pixel, visible = _project(scene, tracer, points.position, points.normal)
        axes.scatter(*pixel[visible].T, s=size, c=colour, linewidths=0)
    axes.set(xlim=(0, _WIDTH), ylim=(_HEIGHT, 0))
    axes.set_axis_off()
    figure.savefig(path)


def _frame(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """Rows: the camera's right, up and forward unit vectors."""
    forward = np.subtract(camera.target, camera.position).astype(float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def _ambient_view(scene: Scene, tracer: Tracer) -> Float[np.ndarray, "H W 3"]:
    """Albedo seen from the camera, darkened towards grazing angles, gamma-encoded; backs are dark, misses white."""
    half = np.tan(np.radians(scene.camera.fov_y) / 2.0)
    y, x = np.mgrid[0:_HEIGHT, 0:_WIDTH] + 0.5
    plane = np.stack([(2 * x - _WIDTH) / _HEIGHT * half, (1.0 - 2 * y / _HEIGHT) * half, np.ones_like(x)], axis=-1)
    direction = plane.reshape(-1, 3) @ _frame(scene.camera)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    hits = tracer.intersect(np.broadcast_to(scene.camera.position, direction.shape), direction)
    seen = np.flatnonzero(hits.face >= 0)
    face, u, v = hits.face[seen], hits.u[seen], hits.v[seen]
    albedo = scene.albedo_at(face, np.stack([1.0 - u - v, u, v], axis=1))
    cosine = np.abs(np.einsum("nd,nd->n", scene.mesh.normals[face], direction[seen]))
    image = np.ones((_HEIGHT * _WIDTH, 3))
    image[seen] = (albedo * (0.4 + 0.6 * cosine * np.where(hits.front[seen], 1.0, 0.3))[:, None]) ** (1 / 2.2)
    return image.reshape(_HEIGHT, _WIDTH, 3)


def _project(
    scene: Scene, tracer: Tracer, position: Float[np.ndarray, "P 3"], normal: Float[np.ndarray, "P 3"]
) -> tuple[Float[np.ndarray, "P 2"], Bool[np.ndarray, " P"]]:
    """Pixel coordinates of points, and whether the camera sees their front."""
    origin = np.asarray(scene.camera.position, float)
    local = (position - origin) @ _frame(scene.camera).T
    half = np.tan(np.radians(scene.camera.fov_y) / 2.0)
    depth = np.where(local[:, 2] > 0, local[:, 2], np.inf)
    pixel = 0.5 * _HEIGHT * (1.0 + local[:, :2] * (1, -1) / (half * depth[:, None])) + (0.5 * (_WIDTH - _HEIGHT), 0.0)
    start = position + tracer.offset * normal
    facing = np.einsum("pd,pd->p", normal, origin - position) > 0
    return pixel, (local[:, 2] > 0) & facing & ~tracer.occluded(start, origin - start)
