"""View and projection matrices, for the camera and for shadow views.

OpenGL's conventions: looking along −z, depth from −1 to 1.
"""

import numpy as np
from jaxtyping import Float

from prt_bench.scene import Camera, Scene

Matrix = Float[np.ndarray, "4 4"]


def look_along(eye: np.ndarray, direction: np.ndarray, up: np.ndarray) -> Matrix:
    """World to view: eye at the origin, `direction` along −z, `up` (any vector not parallel to it) near +y."""
    back = -np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(back, right), back])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ np.asarray(eye, float)
    return matrix


def any_up(direction: np.ndarray) -> np.ndarray:
    """A coordinate axis far from parallel to `direction`."""
    return np.eye(3)[np.argmin(np.abs(direction))]


def perspective(scale_x: float, scale_y: float, near: float, far: float) -> Matrix:
    """View to clip; `scale` is 1 / tan of half the field of view."""
    return np.array(
        [
            [scale_x, 0, 0, 0],
            [0, scale_y, 0, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )


def orthographic(low: np.ndarray, high: np.ndarray) -> Matrix:
    """View to clip for the axis-aligned box from `low` to `high` in view space."""
    size, centre = high - low, 0.5 * (high + low)
    matrix = np.diag([2 / size[0], 2 / size[1], -2 / size[2], 1.0])
    matrix[:3, 3] = -np.diag(matrix)[:3] * centre
    return matrix


def corners(bounds: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "8 3"]:
    """The eight corners of a bounding box."""
    return np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def distance_to_box(point: np.ndarray, bounds: Float[np.ndarray, "2 3"]) -> float:
    """Distance from a point to a bounding box, 0 inside."""
    return float(np.linalg.norm(point - np.clip(point, *bounds)))


def camera_matrix(camera: Camera, scene: Scene, aspect: float) -> Matrix:
    """World to clip for a camera, with near and far planes fitted to the scene."""
    eye = np.asarray(camera.position, float)
    direction = np.asarray(camera.target, float) - eye
    scale = 1.0 / np.tan(np.radians(camera.fov_y) / 2)
    reach = np.linalg.norm(corners(scene.bounds) - eye, axis=1).max()
    near = max(1e-3 * scene.extent, 0.5 * distance_to_box(eye, scene.bounds))
    return perspective(scale / aspect, scale, near, 1.01 * reach) @ look_along(eye, direction, np.asarray(camera.up))


def to_glsl(matrix: np.ndarray) -> bytes:
    """Column-major float32 bytes of a matrix or a stack of them."""
    return np.swapaxes(matrix, -1, -2).astype("<f4").tobytes()
