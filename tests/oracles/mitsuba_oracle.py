"""The project's scenes in mitsuba: indirect irradiance and reflected radiance at surface points by a third party's tracer.

Needs LLVM 17 or newer. Point and directional lights only: mitsuba's area lights are geometry that casts shadows, its
spots and environments use other interpolations.
"""

import ctypes.util
import os
from functools import singledispatch
from typing import Any

import numpy as np
from jaxtyping import Float

from prt_bench.lights import DirectionalLight, Light, Lighting, PointLight
from prt_bench.scene import Scene
from tests.oracles.mitsuba_glossy import glossy_bsdf

PATHS_AT_ONCE = 1 << 22
"""Paths per kernel launch."""
_OFFSET = 1e-4
"""Ray offset relative to the scene's size; mitsuba's own rays use a similar one."""


def unavailable() -> str | None:
    """Why mitsuba cannot run here, or None."""
    try:
        import mitsuba as mi
    except ImportError:
        return "mitsuba is not installed: pip install 'prt-bench[dev]'"
    library = next((found for major in range(30, 16, -1) if (found := ctypes.util.find_library(f"LLVM-{major}"))), None)
    if library is None:
        return "mitsuba's llvm_ad_rgb needs LLVM 17 or newer: apt-get install libllvm19"
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", library)  # an older LLVM that is found first aborts on AVX-512
    mi.set_variant("llvm_ad_rgb")
    return None


class MitsubaOracle:
    """One scene; lightings come and go. Raises `RuntimeError` with the reason where mitsuba cannot run."""

    def __init__(self, scene: Scene) -> None:
        if reason := unavailable():
            raise RuntimeError(reason)
        self._offset = _OFFSET * scene.extent
        self._shapes = {f"material-{index}": _shape(scene, index) for index in np.unique(scene.mesh.material)}

    def indirect_irradiance(
        self,
        position: Float[np.ndarray, "P 3"],
        normal: Float[np.ndarray, "P 3"],
        lighting: Lighting,
        paths: int,
        bounces: int | None = None,
        seed: int = 0,
    ) -> Float[np.ndarray, "P 3"]:
        """E = π · mean of the radiance that arrives along cosine-weighted rays; no light can be hit by a ray.

        mitsuba counts a reflection and the light's connection as depth 2, so `bounces` end at depth bounces + 1.
        """
        import drjit as dr
        import mitsuba as mi

        emitters = {f"light-{index}": _emitter(light) for index, light in enumerate(lighting.lights)}
        scene = mi.load_dict({"type": "scene", **self._shapes, **emitters})
        depth = -1 if bounces is None else bounces + 1
        integrator = mi.load_dict({"type": "path", "max_depth": depth})
        irradiance = np.empty(position.shape)
        points_at_once = max(PATHS_AT_ONCE // paths, 1)
        for launch, first in enumerate(range(0, len(position), points_at_once)):
            rows = slice(first, first + points_at_once)
            count = len(position[rows])
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(seed * 65537 + launch, count * paths)
            row = dr.arange(mi.UInt32, count * paths) // paths
            n = dr.gather(mi.Normal3f, mi.Normal3f(normal[rows].T), row)
            start = dr.gather(mi.Point3f, mi.Point3f((position[rows] + self._offset * normal[rows]).T), row)
            direction = mi.Frame3f(n).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
            radiance, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(start, direction))
            mean = [dr.block_sum(channel, paths) * (dr.pi / paths) for channel in radiance]
            irradiance[rows] = np.stack([channel.numpy() for channel in mean], axis=1)
        return irradiance

    def radiance(
        self,
        position: Float[np.ndarray, "P 3"],
        towards_eye: Float[np.ndarray, "P 3"],
        lighting: Lighting,
        paths: int,
        bounces: int | None = None,
        seed: int = 0,
    ) -> Float[np.ndarray, "P 3"]:
        """Radiance that points reflect along unit directions, after direct light (depth 2) and up to `bounces` more."""
        import drjit as dr
        import mitsuba as mi

        emitters = {f"light-{index}": _emitter(light) for index, light in enumerate(lighting.lights)}
        scene = mi.load_dict({"type": "scene", **self._shapes, **emitters})
        integrator = mi.load_dict({"type": "path", "max_depth": -1 if bounces is None else bounces + 2})
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(position) * paths)
        row = dr.arange(mi.UInt32, len(position) * paths) // paths
        way = dr.gather(mi.Vector3f, mi.Vector3f(-towards_eye.T), row)
        start = dr.gather(mi.Point3f, mi.Point3f((position + 10.0 * self._offset * towards_eye).T), row)
        radiance, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(start, way))
        return np.stack([(dr.block_sum(channel, paths) / paths).numpy() for channel in radiance], axis=1)


def _shape(scene: Scene, index: int) -> Any:
    """The faces of one material with its lobe, flat-shaded; mitsuba's `diffuse` is black from behind as ours."""
    import mitsuba as mi

    material = scene.materials[index]
    if material.image is not None:
        raise TypeError("the mitsuba oracle knows uniform albedos only")
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(material.albedo)}}
    if material.glossy is not None:
        bsdf = glossy_bsdf(material)
    if material.two_sided:
        bsdf = {"type": "twosided", "inner": bsdf}
    triangles = scene.mesh.triangles[scene.mesh.material == index]
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf)
    properties["face_normals"] = True
    mesh = mi.Mesh(material.name, 3 * len(triangles), len(triangles), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = triangles.astype(np.float32).ravel()
    parameters["faces"] = np.arange(3 * len(triangles), dtype=np.uint32)
    parameters.update()
    return mesh


@singledispatch
def _emitter(light: Light) -> dict[str, Any]:
    raise TypeError(f"the mitsuba oracle knows no {type(light).__name__}")


@_emitter.register
def _(light: PointLight) -> dict[str, Any]:
    if light.radius != 0:
        raise ValueError("mitsuba's point light has no radius: make it PointLight(..., radius=0)")
    return {"type": "point", "position": light.position.tolist(), "intensity": _rgb(light.intensity)}


@_emitter.register
def _(light: DirectionalLight) -> dict[str, Any]:
    return {"type": "directional", "direction": light.direction.tolist(), "irradiance": _rgb(light.irradiance)}


def _rgb(value: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": np.asarray(value).tolist()}
