"""What is lit: a triangle mesh with diffuse or glossy materials and a camera.

Geometry and reflectance only. Lights live in `lights.py`, surface samples in `points.py`, and everything that traces rays
or reads files in `data_gen`.
"""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from prt_bench.errors import SceneError
from prt_bench.hair import Hair
from prt_bench.medium import Subsurface
from prt_bench.strands import Strands

MOST_EXPONENT = 1e6
"""Sharpest lobe of a glossy material, 0.1° wide; a mirror has no lobe that could be sampled or stored."""
LEAST_TILT = 0.01  # least cosine between a shading normal and its face's
_SLACK = 1e-6  # by which albedo and specular may exceed 1 together: float32 images


@dataclass(frozen=True)
class Glossy:
    """A normalised Phong lobe that a material adds to its diffuse reflection.

    A surface with diffuse albedo ρ reflects towards a viewer, whose mirror direction about the normal n is ω_r,

        ρ/π E + specular · ∫ L(ω) (n·ω) (s + 1)/(2π) max(ω·ω_r, 0)^s dω

    over the directions ω with n·ω > 0, where L is what arrives from ω (W/m²/sr) and E = ∫ L(ω) (n·ω) dω. Such a lobe
    reflects at most `specular` of what arrives, at normal view (s + 1)/(s + 2) of that. `specular` is linear RGB in
    [0, 1]. The exponent s lies from 0 (constant wherever ω·ω_r > 0) to `MOST_EXPONENT`; a mirror, s = ∞, is refused.
    `roughness_image` [height, width] in (0, 1], looked up at the mesh's texture coordinates, takes the exponent's place:
    s = 2/r² − 2. (Lafortune and Willems 1994, "Using the Modified Phong Reflectance Model for Physically Based Rendering";
    they normalise by (s + 2)/(2π), so that normal view reflects `specular` exactly.)
    """

    specular: tuple[float, float, float] = (0.2, 0.2, 0.2)
    exponent: float = 20.0
    roughness_image: Float[np.ndarray, "H W"] | None = None

    def __post_init__(self) -> None:
        values = np.asarray(self.specular, float)
        if values.shape != (3,) or not np.all((values >= 0) & (values <= 1)):
            raise SceneError(f"a glossy lobe has specular {self.specular}, but it must be three numbers from 0 to 1")
        if not 0 <= self.exponent <= MOST_EXPONENT:
            raise SceneError(
                f"a glossy lobe has exponent {self.exponent}, but it must lie from 0 to {MOST_EXPONENT:g};"
                " a perfect mirror cannot be sampled"
            )
        image = self.roughness_image
        if image is not None:
            least = np.sqrt(2.0 / (MOST_EXPONENT + 2.0))
            if image.ndim != 2 or not np.all((image >= least) & (image <= 1)):
                raise SceneError(f"a roughness image must be [height, width] with values from {least:.4f} to 1")


@dataclass(frozen=True)
class Material:
    """Reflectance of a surface: diffuse, glossy where a lobe is given, and a medium below it where `subsurface` is.

    `albedo` is linear RGB in [0, 1]. `image` [height, width, 3], linear too, multiplies it and is looked up at the mesh's
    texture coordinates (v up). A `two_sided` surface reflects on both sides; any other is black from behind. Albedo and
    the specular part of `glossy` are at most 1 together.

    `normal_image` [height, width, 3] tilts the normal: vectors of any length in the frame of the texture coordinates, x
    along u, y along v, z > 0 along the face's normal (from the usual colours c in [0, 1] by 2c − 1). See
    `Scene.shading_normal_at`.

    `subsurface` fills the closed surfaces of the material with a medium. Its boundary then reflects what light does not
    enter, so albedo and specular are at most `Subsurface.reflected` together: usually 0, the medium gives the colour.

    `hair` is what the strands of a scene are made of that have this material; their `albedo` is set to that of the fibres.
    """

    name: str = "grey"
    albedo: tuple[float, float, float] = (0.5, 0.5, 0.5)
    image: Float[np.ndarray, "H W 3"] | None = None
    two_sided: bool = False
    glossy: Glossy | None = None
    normal_image: Float[np.ndarray, "H W 3"] | None = None
    subsurface: Subsurface | None = None
    hair: Hair | None = None

    def __post_init__(self) -> None:
        if self.hair is not None:
            self._check_fibres(self.hair)
        values = np.asarray(self.albedo, float)
        if values.shape != (3,) or not np.all((values >= 0) & (values <= 1)):
            raise SceneError(
                f"material '{self.name}' has albedo {self.albedo}, but a diffuse albedo is three numbers from 0 to 1"
            )
        if self.image is not None and not np.all((self.image >= 0) & (self.image <= 1)):
            raise SceneError(f"the albedo image of material '{self.name}' has values outside 0 to 1")
        if self.subsurface is not None:
            self._check_boundary(self.subsurface)
        if self.glossy is not None and np.any(self._brightest + self.glossy.specular > 1 + _SLACK):
            raise SceneError(
                f"material '{self.name}' reflects more than arrives: its albedo {self.albedo} and specular"
                f" {self.glossy.specular} must not exceed 1 together; lower one of them"
            )
        normals = self.normal_image
        if normals is not None and (normals.ndim != 3 or normals.shape[2] != 3 or not np.all(normals[..., 2] > 0)):
            raise SceneError(
                f"the normal image of material '{self.name}' must hold vectors [height, width, 3] with z above zero;"
                " from colours c they are 2c − 1"
            )

    @property
    def _brightest(self) -> Float[np.ndarray, "3"]:
        """Largest albedo anywhere on the surface."""
        return np.asarray(self.albedo, float) * (1.0 if self.image is None else self.image.max(axis=(0, 1)))

    def _check_fibres(self, hair: Hair) -> None:
        """Take the colour from the fibres. Raise `SceneError` for what no fibre has."""
        if self.glossy or self.subsurface or self.image is not None or self.normal_image is not None or self.two_sided:
            raise SceneError(
                f"material '{self.name}' is hair, which has neither images, lobes, a medium nor a second side; drop those"
            )
        object.__setattr__(self, "albedo", hair.albedo)

    def _check_boundary(self, medium: Subsurface) -> None:
        """Raise `SceneError` for a medium in a sheet, or below a surface that reflects what must enter."""
        if self.two_sided:
            raise SceneError(
                f"material '{self.name}' is two-sided and holds a medium, but a medium fills a closed body; drop either"
            )
        most = medium.reflected
        if np.any(self._brightest + (self.glossy.specular if self.glossy else 0.0) > most + _SLACK):
            raise SceneError(
                f"material '{self.name}' has albedo {self.albedo} over a medium whose boundary reflects {most:.3f} of diffuse"
                " light; keep albedo and specular together below that, usually at 0: the medium gives the colour"
            )


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
    """A mesh, its materials and a camera. `notes` says what the loader repaired, scaled or assumed.

    `strands` are those of hair, whose tubes are the mesh's last faces (`data_gen.strands.with_strands`).
    """

    name: str
    mesh: Mesh
    materials: tuple[Material, ...]
    camera: Camera
    notes: tuple[str, ...] = field(default=())
    strands: Strands | None = None

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
        """Whether every surface reflects all channels alike, so that one channel describes the transport."""
        return all(
            len(set(m.albedo)) == 1
            and (m.image is None or bool(np.ptp(m.image, axis=-1).max() == 0))
            and (m.glossy is None or len(set(m.glossy.specular)) == 1)
            and (m.subsurface is None or m.subsurface.grey)
            for m in self.materials
        )

    @property
    def glossy(self) -> bool:
        """Whether any material has a glossy lobe."""
        return any(m.glossy is not None for m in self.materials)

    @property
    def translucent(self) -> bool:
        """Whether any face's material holds a medium."""
        return any(self.materials[index].subsurface is not None for index in np.unique(self.mesh.material))

    @property
    def largest_albedo(self) -> float:
        """Upper bound of what surfaces reflect, and media give back, over all surfaces and channels."""
        return max(
            float(np.max(m.albedo)) * (1.0 if m.image is None else float(m.image.max()))
            + (0.0 if m.subsurface is None else 1.0 - m.subsurface.reflected)
            for m in self.materials
        )

    def translucent_at(self, face: Int[np.ndarray, " P"]) -> Bool[np.ndarray, " P"]:
        """Whether the materials of faces hold a medium."""
        return np.array([m.subsurface is not None for m in self.materials])[self.mesh.material[face]]

    @property
    def surfaces(self) -> int:
        """Number of faces that are not those of strands; the strands' come after them."""
        return len(self.mesh.faces) - (0 if self.strands is None else len(self.strands.corners[0]))

    def albedo_at(self, face: Int[np.ndarray, " P"], barycentric: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """Linear RGB albedo at points given by face index and barycentric coordinates."""
        owner = self.mesh.material[face]
        albedo = np.array([m.albedo for m in self.materials], float)[owner]
        for index, material in enumerate(self.materials):
            if material.image is not None:
                here = np.flatnonzero(owner == index)
                uv = self._uv_at(face[here], barycentric[here], f"material '{material.name}' has an image")
                albedo[here] *= _bilinear(material.image, uv)
        return albedo

    def glossy_at(
        self, face: Int[np.ndarray, " P"], barycentric: Float[np.ndarray, "P 3"]
    ) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, " P"]]:
        """Specular reflectance (linear RGB) and exponent of the glossy lobe at points; both are 0 where there is none."""
        owner = self.mesh.material[face]
        lobes = [m.glossy or Glossy((0.0, 0.0, 0.0), 0.0) for m in self.materials]
        specular = np.array([lobe.specular for lobe in lobes], float)[owner]
        exponent = np.array([lobe.exponent for lobe in lobes], float)[owner]
        for index, lobe in enumerate(lobes):
            if lobe.roughness_image is not None:
                here = np.flatnonzero(owner == index)
                name = self.materials[index].name
                uv = self._uv_at(face[here], barycentric[here], f"material '{name}' has a roughness image")
                exponent[here] = 2.0 / _bilinear(lobe.roughness_image[..., None], uv)[:, 0] ** 2 - 2.0
        return specular, exponent

    def shading_normal_at(
        self, face: Int[np.ndarray, " P"], barycentric: Float[np.ndarray, "P 3"]
    ) -> Float[np.ndarray, "P 3"]:
        """Unit normals at points, tilted by the materials' normal images and less than 90° off the face's own.

        The frame of a face is its normal, the direction in which u grows, and the one across that in which v grows, so
        mirrored texture coordinates tilt the right way. Where those have no area the normal is the face's.
        """
        owner = self.mesh.material[face]
        normals = self.mesh.normals[face]
        for index, material in enumerate(self.materials):
            if material.normal_image is not None:
                here = np.flatnonzero(owner == index)
                uv = self._uv_at(face[here], barycentric[here], f"material '{material.name}' has a normal image")
                tilt = _bilinear(material.normal_image, uv)
                tilt /= np.linalg.norm(tilt, axis=1, keepdims=True)
                tilt[:, 2] = np.maximum(tilt[:, 2], LEAST_TILT)
                tilted = np.einsum("pk,pkd->pd", tilt, self.tangent_frames(face[here]))
                normals[here] = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
        return normals

    def tangent_frames(self, face: Int[np.ndarray, " P"]) -> Float[np.ndarray, "P 3 3"]:
        """Rows: unit vectors along u, along v and along the normal; the first two are zero where uv has no area."""
        corners, uv, normal = self.mesh.triangles[face], np.asarray(self.mesh.uv)[face], self.mesh.normals[face]
        (a, b), (s, t) = (np.stack([part[:, 1] - part[:, 0], part[:, 2] - part[:, 0]]) for part in (corners, uv))
        area = s[:, :1] * t[:, 1:] - s[:, 1:] * t[:, :1]
        along_u = np.sign(area) * (a * t[:, 1:] - b * s[:, 1:])
        length = np.linalg.norm(along_u, axis=1, keepdims=True)
        along_u = np.divide(along_u, length, out=np.zeros_like(along_u), where=length > 0)
        return np.stack([along_u, np.sign(area) * np.cross(normal, along_u), normal], axis=1)

    def _uv_at(self, face: Int[np.ndarray, " P"], barycentric: Float[np.ndarray, "P 3"], what: str) -> np.ndarray:
        """Texture coordinates [P, 2]. Raises `SceneError` that says `what` needs them."""
        if self.mesh.uv is None:
            raise SceneError(f"{what} but scene '{self.name}' has no texture coordinates")
        return np.einsum("pc,pcd->pd", barycentric, self.mesh.uv[face])

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
            lobe = material.glossy
            if lobe is not None:
                digest.update(repr(("glossy", tuple(map(float, lobe.specular)), float(lobe.exponent))).encode())
            medium = material.subsurface
            if medium is not None:
                numbers = [*medium.scattering, *medium.absorption, medium.anisotropy, medium.ior]
                digest.update(f"subsurface {np.array(numbers, '<f8').tobytes().hex()}".encode())
            hair = material.hair
            if hair is not None:
                numbers = [*hair.absorption, hair.variance, hair.scale, hair.ior, hair.tilt]
                digest.update(f"hair {np.array(numbers, '<f8').tobytes().hex()}".encode())
            for name, image in (("roughness", lobe and lobe.roughness_image), ("normal", material.normal_image)):
                if image is not None:
                    digest.update(f"{name} {image.shape}".encode() + np.ascontiguousarray(image, "<f8").tobytes())
        if self.strands is not None:
            digest.update(self.strands.starts.astype("<i8").tobytes() + self.strands.nodes.astype("<f8").tobytes())
        if self.mesh.uv is not None:
            digest.update(np.ascontiguousarray(self.mesh.uv, "<f8").tobytes())
        return digest.hexdigest()


def _bilinear(image: Float[np.ndarray, "H W D"], uv: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P D"]:
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
