"""Lights, and the unoccluded irradiance they cause.

Every light reduces to a sum of *punctual emitters*: points or directions with an RGB intensity and one angular profile
(`Emitters`). The bake's shadow rays, the differentiable irradiance below and the GLSL runtime all evaluate these same
emitters, so the three agree by construction. Visibility is found elsewhere (`data_gen.tracer`, `shaders/shadow.glsl`).

Units: position in m, intensity in W/sr, radiance in W/m²/sr, irradiance in W/m².

| light | parameter | unit | differentiable |
|---|---|---|---|
| PointLight | position, intensity | m, W/sr | yes |
| SpotLight | position, direction, intensity, cutoff, falloff | m, -, W/sr, rad, - | yes |
| DirectionalLight | direction, irradiance (at normal incidence) | -, W/m² | yes |
| SphereLight | center, radius, radiance | m, m, W/m²/sr | yes |
| RectLight | center, u, v, radiance | m, m, m, W/m²/sr | yes |
| EnvironmentLight | rotation (the map is data) | rad | yes |

Gradients do not reach visibility: moving a shadow's edge is not differentiated.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from prt_bench.environment import EnvironmentMap, median_cut
from prt_bench.errors import LightError

AREA_SAMPLES = 16
"""Punctual emitters that stand for one area light."""
ENVIRONMENT_SAMPLES = 64
"""Directional emitters that stand for one environment map."""
_ALL = (-3.0, -2.0)  # cosine bounds that every direction passes


class Emitters(eqx.Module):
    """Q punctual emitters (leading axes may batch lightings; padding has zero intensity).

    position [..., Q, 4]: homogeneous; w = 1 is a point, w = 0 a unit direction *towards* the light.
    axis [..., Q, 3]: unit axis of emission. intensity [..., Q, 3]: W/sr along the axis for points, W/m² for directions.
    profile [..., Q, 4]: (cos of the outer cone, cos of the inner cone, weight of the Lambert cosine, squared source radius).
    """

    position: Float[Array, "*N Q 4"]
    axis: Float[Array, "*N Q 3"]
    intensity: Float[Array, "*N Q 3"]
    profile: Float[Array, "*N Q 4"]


class Light(eqx.Module):
    """One light. Subclasses are final."""

    @abstractmethod
    def emitters(self) -> Emitters:
        """The punctual emitters this light stands for, differentiable in its parameters."""

    @abstractmethod
    def check(self) -> None:
        """Raise `LightError` when a parameter is not physical."""

    def to_json(self) -> dict[str, Any]:
        """A JSON object from which `light_from_json` makes this light again."""
        fields = {name: np.asarray(value).tolist() for name, value in vars(self).items()}
        return {"type": type(self).__name__, **fields}


class PointLight(Light):
    """Isotropic point light; `radius` regularises contact: intensity / (distance² + radius²)."""

    position: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    intensity: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    radius: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.01)

    def emitters(self) -> Emitters:
        """One point."""
        return _points(self.position[None], _UP, self.intensity[None], _ALL, 0.0, self.radius)

    def check(self) -> None:
        """Finite position, non-negative intensity and radius."""
        _check(self, finite=("position",), non_negative=("intensity", "radius"))


class SpotLight(Light):
    """Point light in a cone of half-angle `cutoff` (radians) about `direction`.

    Intensity is full up to the angle cutoff · (1 − falloff) and falls to zero at the cutoff by a smoothstep in the cosine.
    """

    position: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    direction: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    intensity: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    cutoff: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.6)
    falloff: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.3)
    radius: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.01)

    def emitters(self) -> Emitters:
        """One point with a cone."""
        cone = (jnp.cos(self.cutoff), jnp.cos(self.cutoff * (1.0 - self.falloff)))
        return _points(self.position[None], _unit(self.direction)[None], self.intensity[None], cone, 0.0, self.radius)

    def check(self) -> None:
        """Physical ranges: 0 < cutoff ≤ π, 0 < falloff ≤ 1, a direction that is not zero."""
        _check(self, finite=("position",), non_negative=("intensity", "radius"), directions=("direction",))
        if not 0 < float(self.cutoff) <= np.pi or not 0 < float(self.falloff) <= 1:
            raise LightError(
                f"SpotLight needs 0 < cutoff ≤ π and 0 < falloff ≤ 1, not {float(self.cutoff)} and {float(self.falloff)}"
            )


class DirectionalLight(Light):
    """Parallel light travelling along `direction`; `irradiance` is what it causes at normal incidence."""

    direction: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    irradiance: Float[Array, "3"] = eqx.field(converter=jnp.asarray)

    def emitters(self) -> Emitters:
        """One direction."""
        return _directions(-_unit(self.direction)[None], self.irradiance[None])

    def check(self) -> None:
        """A direction that is not zero, non-negative irradiance."""
        _check(self, non_negative=("irradiance",), directions=("direction",))


class SphereLight(Light):
    """Sphere of uniform radiance: points on a Fibonacci spiral, each emitting by Lambert's cosine law."""

    center: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    radius: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    radiance: Float[Array, "3"] = eqx.field(converter=jnp.asarray)

    def emitters(self) -> Emitters:
        """`AREA_SAMPLES` points, each standing for an equal share of the surface."""
        axis = jnp.asarray(_fibonacci_sphere(AREA_SAMPLES))
        share = 4.0 * jnp.pi * self.radius**2 / AREA_SAMPLES
        intensity = jnp.broadcast_to(self.radiance * share, (AREA_SAMPLES, 3))
        return _points(self.center + self.radius * axis, axis, intensity, _ALL, 1.0, self.radius * 0.5)

    def check(self) -> None:
        """Positive radius, non-negative radiance."""
        _check(self, finite=("center",), non_negative=("radiance",), positive=("radius",))


class RectLight(Light):
    """One-sided parallelogram with half-edges `u` and `v`, of uniform radiance, emitting along u × v."""

    center: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    u: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    v: Float[Array, "3"] = eqx.field(converter=jnp.asarray)
    radiance: Float[Array, "3"] = eqx.field(converter=jnp.asarray)

    def emitters(self) -> Emitters:
        """A grid of `AREA_SAMPLES` points, each standing for an equal share of the area."""
        side = int(np.sqrt(AREA_SAMPLES))
        steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
        s, t = (jnp.asarray(grid.ravel()[:, None]) for grid in np.meshgrid(steps, steps))
        normal = jnp.cross(self.u, self.v)
        area = 4.0 * jnp.linalg.norm(normal)
        axis = jnp.broadcast_to(_unit(normal), (side * side, 3))
        intensity = jnp.broadcast_to(self.radiance * area / side**2, (side * side, 3))
        return _points(self.center + s * self.u + t * self.v, axis, intensity, _ALL, 1.0, jnp.sqrt(area) / (2 * side))

    def check(self) -> None:
        """Edges that span an area, non-negative radiance."""
        _check(self, finite=("center", "u", "v"), non_negative=("radiance",))
        if not float(jnp.linalg.norm(jnp.cross(self.u, self.v))) > 0:
            raise LightError("RectLight has edges u and v that span no area")


class EnvironmentLight(Light):
    """Distant light from an equirectangular radiance map (y up, −z at the image's centre).

    `map` is an `EnvironmentMap`, a path to an EXR file, or an array [H, W, 3] of radiance; `rotation` is an axis-angle
    vector in radians. Median cut turns the map into `ENVIRONMENT_SAMPLES` directions that keep its vector irradiance
    (after Debevec 2005, "A Median Cut Algorithm for Light Probe Sampling").
    """

    map: EnvironmentMap = eqx.field(converter=EnvironmentMap.coerce, static=True)
    rotation: Float[Array, "3"] = eqx.field(converter=jnp.asarray, default=(0.0, 0.0, 0.0))

    def emitters(self) -> Emitters:
        """The map's directions, rotated."""
        direction, irradiance = median_cut(self.map, ENVIRONMENT_SAMPLES)
        return _directions(direction @ rotation_matrix(self.rotation).T, jnp.asarray(irradiance))

    def check(self) -> None:
        """A finite rotation; the map checks itself when it is made."""
        _check(self, finite=("rotation",))

    def to_json(self) -> dict[str, Any]:
        """The map by name and hash; `light_from_json` looks it up among the maps it is given."""
        return {"type": "EnvironmentLight", "map": self.map.hash, "rotation": np.asarray(self.rotation).tolist()}


class Lighting(eqx.Module):
    """One lighting configuration: any number of lights at once. None at all is darkness."""

    lights: tuple[Light, ...] = eqx.field(converter=tuple)

    def check(self) -> None:
        """Raise `LightError` for the first light that is not physical."""
        for light in self.lights:
            if not isinstance(light, Light):
                raise LightError(f"a Lighting holds lights, not {type(light).__name__}")
            light.check()


def light_from_json(data: dict[str, Any], maps: dict[str, EnvironmentMap]) -> Light:
    """The inverse of `Light.to_json`; `maps` holds environment maps by hash."""
    kinds = {kind.__name__: kind for kind in Light.__subclasses__()}
    fields = {name: value for name, value in data.items() if name != "type"}
    if data["type"] == "EnvironmentLight":
        return EnvironmentLight(maps[fields["map"]], jnp.asarray(fields["rotation"]))
    return kinds[data["type"]](**{name: jnp.asarray(value) for name, value in fields.items()})


def emitters(lightings: Sequence[Lighting]) -> Emitters:
    """Batch the emitters of N lightings into [N, Q, …], padded with emitters of zero intensity."""
    per_lighting = []
    for lighting in lightings:
        parts = [light.emitters() for light in lighting.lights] or [_directions(jnp.asarray([_Y]), jnp.zeros((1, 3)))]
        per_lighting.append(jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts))
    most = max(part.position.shape[0] for part in per_lighting)
    padded = [_pad(part, most) for part in per_lighting]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *padded)


def irradiance(
    emitters: Emitters,
    position: Float[Array, "P 3"],
    normal: Float[Array, "P 3"],
    visibility: Bool[Array, "P Q"] | Float[Array, "P Q"] | None = None,
) -> Float[Array, "P 3"]:
    """Irradiance [P, 3] in W/m² from Q emitters at P points.

    `strength` times intensity, summed over visible emitters. Differentiable in emitters, positions and normals; finite at
    contact because of the source radius r_s.
    """
    weight = strength(emitters, position, normal)
    if visibility is not None:
        weight = weight * visibility
    return jnp.einsum("pq,qc->pc", weight, emitters.intensity, precision="highest")


def strength(emitters: Emitters, position: Float[Array, "P 3"], normal: Float[Array, "P 3"]) -> Float[Array, "P Q"]:
    """Unoccluded irradiance per unit of intensity, for each point and emitter.

    f(c) max(n·ω, 0) / (r² + r_s²) for points and max(n·ω, 0) for directions, with the angular profile
    f(c) = smoothstep(outer, inner, c) · (1 or Lambert's max(c, 0)) of the cosine c to the emission axis.
    """
    w = emitters.position[:, 3]
    offset = emitters.position[None, :, :3] - position[:, None, :] * w[None, :, None]
    distance_squared = jnp.sum(offset**2, axis=-1)
    safe = jnp.maximum(distance_squared, jnp.finfo(distance_squared.dtype).tiny * 1e6)
    direction = offset / jnp.sqrt(safe)[..., None]
    incidence = jnp.maximum(jnp.einsum("pqd,pd->pq", direction, normal), 0.0)

    outer, inner, lambert, radius_squared = jnp.moveaxis(emitters.profile, -1, 0)
    cosine = -jnp.einsum("pqd,qd->pq", direction, emitters.axis)
    t = jnp.clip((cosine - outer) / jnp.maximum(inner - outer, 1e-6), 0.0, 1.0)
    profile = t * t * (3.0 - 2.0 * t) * (1.0 + lambert * (jnp.maximum(cosine, 0.0) - 1.0))
    return incidence * profile / jnp.where(w > 0, distance_squared + radius_squared, 1.0)


def rotation_matrix(axis_angle: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation about an axis-angle vector in radians, smooth at zero (matrix exponential)."""
    x, y, z = axis_angle
    zero = jnp.zeros_like(x)
    return jax.scipy.linalg.expm(jnp.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]))


_Y = (0.0, 1.0, 0.0)
_UP = np.array([_Y])


def _unit(vector: Array) -> Array:
    return vector / jnp.linalg.norm(vector)


def _points(position: Any, axis: Any, intensity: Any, cone: tuple[Any, Any], lambert: float, radius: Any) -> Emitters:
    count = position.shape[0]
    row = jnp.stack([jnp.asarray(value, float) for value in (*cone, lambert, radius**2)])
    return Emitters(
        jnp.concatenate([position, jnp.ones((count, 1))], axis=1),
        jnp.broadcast_to(jnp.asarray(axis, float), (count, 3)),
        jnp.asarray(intensity, float),
        jnp.broadcast_to(row, (count, 4)),
    )


def _directions(towards_light: Any, irradiance: Any) -> Emitters:
    direction = jnp.asarray(towards_light, float)
    count = direction.shape[0]
    return Emitters(
        jnp.concatenate([direction, jnp.zeros((count, 1))], axis=1),
        -direction,
        jnp.asarray(irradiance, float),
        jnp.broadcast_to(jnp.asarray([*_ALL, 0.0, 0.0]), (count, 4)),
    )


def _pad(part: Emitters, count: int) -> Emitters:
    missing = count - part.position.shape[0]
    if missing == 0:
        return part
    dark = _directions(jnp.broadcast_to(jnp.asarray(_Y), (missing, 3)), jnp.zeros((missing, 3)))
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), part, dark)


def _fibonacci_sphere(count: int) -> Float[np.ndarray, "Q 3"]:
    """Evenly spread unit vectors."""
    index = np.arange(count) + 0.5
    y = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - y**2)
    return np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1)


def _check(
    light: Light,
    finite: Sequence[str] = (),
    non_negative: Sequence[str] = (),
    positive: Sequence[str] = (),
    directions: Sequence[str] = (),
) -> None:
    kind = type(light).__name__
    for name in (*finite, *non_negative, *positive, *directions):
        if not np.all(np.isfinite(np.asarray(getattr(light, name)))):
            raise LightError(f"{kind}.{name} is {np.asarray(getattr(light, name))}, but must be finite")
    for name in non_negative:
        if np.any(np.asarray(getattr(light, name)) < 0):
            raise LightError(f"{kind}.{name} is {np.asarray(getattr(light, name))}, but light cannot be negative")
    for name in positive:
        if not np.all(np.asarray(getattr(light, name)) > 0):
            raise LightError(f"{kind}.{name} is {np.asarray(getattr(light, name))}, but must be above zero")
    for name in directions:
        if not np.linalg.norm(np.asarray(getattr(light, name))) > 0:
            raise LightError(f"{kind}.{name} is the zero vector, which points nowhere")
