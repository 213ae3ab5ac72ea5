"""What is lit: a triangle mesh with diffuse materials and a camera.

Geometry and reflectance only. Lights live in `lights.py`, surface samples in `points.py`, and everything that traces rays
or reads files in `data_gen`.
"""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import SceneError


@dataclass(frozen=True)
class Material:
    """Diffuse reflectance of a surface.

    `albedo` is linear RGB in [0, 1]. `image` [height, width, 3], linear too, multiplies it and is looked up at the mesh's
    texture coordinates (v up). A `two_sided` surface reflects on both sides; any other is black from behind.
    """

    name: str = "grey"
    albedo: tuple[float, float, float] = (0.5, 0.5, 0.5)
    image: Float[np.ndarray, "H W 3"] | None = None
    two_sided: bool = False

    def __post_init__(self) -> None:
        values = np.asarray(self.albedo, float)
        if values.shape != (3,) or not np.all((values >= 0) & (values <= 1)):
            raise SceneError(
                f"material '{self.name}' has albedo {self.albedo}, but a diffuse albedo is three numbers from 0 to 1"
            )
        if self.image is not None and not np.all((self.image >= 0) & (self.image <= 1)):
            raise SceneError(f"the albedo image of material '{self.name}' has values outside 0 to 1")


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: `fov_y` is the full vertical field of view in degrees; positions are in metres."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov_y: float = 40.0


@dataclass(frozen=True)
class Mesh:
    """Triangles, counter-clockwise seen from the front.

    `material` holds an index per face. `uv`, per face corner, is where a material's image is looked up; the lightmap has
    coordinates of its own (`data_gen.atlas`).
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    material: Int[np.ndarray, " F"]
    uv: Float[np.ndarray, "F 3 2"] | None = None

    @cached_property
    def triangles(self) -> Float[np.ndarray, "F 3 3"]:
        """Corner positions of each face, in metres."""
        return self.vertices[self.faces]

    @cached_property
    def normals(self) -> Float[np.ndarray, "F 3"]:
        """Unit geometric normal of each face."""
        corners = self.triangles
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), np.finfo(float).tiny)

    @cached_property
    def areas(self) -> Float[np.ndarray, " F"]:
        """Area of each face in m²."""
        corners = self.triangles
        return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


@dataclass(frozen=True)
class Scene:
    """A mesh, its materials and a camera. `notes` says what the loader repaired, scaled or assumed."""

    name: str
    mesh: Mesh
    materials: tuple[Material, ...]
    camera: Camera
    notes: tuple[str, ...] = field(default=())

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the faces' bounding box, in metres; vertices without a face do not count."""
        return np.stack([self.mesh.triangles.min((0, 1)), self.mesh.triangles.max((0, 1))])

    @property
    def extent(self) -> float:
        """Length of the bounding box's diagonal, in metres."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @property
    def achromatic(self) -> bool:
        """Whether every albedo is grey, so that one channel describes the transport."""
        return all(
            len(set(m.albedo)) == 1 and (m.image is None or bool(np.ptp(m.image, axis=-1).max() == 0))
            for m in self.materials
        )

    @property
    def largest_albedo(self) -> float:
        """Upper bound of the albedo over all surfaces and channels."""
        return max(float(np.max(m.albedo)) * (1.0 if m.image is None else float(m.image.max())) for m in self.materials)

    def albedo_at(self, face: Int[np.ndarray, " P"], barycentric: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """Linear RGB albedo at points given by face index and barycentric coordinates."""
        owner = self.mesh.material[face]
        albedo = np.array([m.albedo for m in self.materials], float)[owner]
        for index, material in enumerate(self.materials):
            if material.image is None:
                continue
            here = np.flatnonzero(owner == index)
            if self.mesh.uv is None:
                raise SceneError(
                    f"material '{material.name}' has an image but scene '{self.name}' has no texture coordinates"
                )
            uv = np.einsum("pc,pcd->pd", barycentric[here], self.mesh.uv[face[here]])
            albedo[here] *= _bilinear(material.image, uv)
        return albedo

    @cached_property
    def hash(self) -> str:
        """SHA-256 over geometry and reflectance: everything the transport depends on."""
        digest = hashlib.sha256()
        for array in (
            self.mesh.vertices.astype("<f8"),
            self.mesh.faces.astype("<i8"),
            self.mesh.material.astype("<i8"),
        ):
            digest.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        for material in self.materials:
            digest.update(repr((material.albedo, material.two_sided)).encode())
            if material.image is not None:
                digest.update(np.ascontiguousarray(material.image, "<f8").tobytes())
        if self.mesh.uv is not None:
            digest.update(np.ascontiguousarray(self.mesh.uv, "<f8").tobytes())
        return digest.hexdigest()


def _bilinear(image: Float[np.ndarray, "H W 3"], uv: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P 3"]:
    """Bilinear lookup with wrapping, v up, texel centres at half-integers."""
    height, width = image.shape[:2]
    x = uv[:, 0] * width - 0.5
    y = (1.0 - uv[:, 1]) * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    rows, columns = (y0 % height, (y0 + 1) % height), (x0 % width, (x0 + 1) % width)
    top = image[rows[0], columns[0]] * (1 - fx) + image[rows[0], columns[1]] * fx
    bottom = image[rows[1], columns[0]] * (1 - fx) + image[rows[1], columns[1]] * fx
    return top * (1 - fy) + bottom * fy
