"""Lights and lightings: what can be put into a scene, and the punctual emitters that each light stands for.

Every light reduces to a sum of *punctual emitters*, points or directions with an RGB intensity and one angular profile;
they and the irradiance they cause live in `emitters.py`.

| light | parameter | unit | differentiable |
|---|---|---|---|
| PointLight | position, intensity, radius | m, W/sr, m | yes |
| SpotLight | position, direction, intensity, cutoff, falloff, radius | m, -, W/sr, rad, -, m | yes |
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
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from prt_bench.emitters import (
    EVERYWHERE,
    UP,
    Emitters,
    batched,
    darkness,
    directional_emitters,
    joined,
    point_emitters,
)
from prt_bench.emitters import irradiance as irradiance  # lights.irradiance(lights.emitters(...)), for users
from prt_bench.environment import EnvironmentMap, median_cut
from prt_bench.errors import LightError

AREA_SAMPLES = 16
"""Punctual emitters that stand for one area light."""
ENVIRONMENT_SAMPLES = 64
"""Directional emitters that stand for one environment map."""


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
        return point_emitters(self.position[None], UP, self.intensity[None], EVERYWHERE, 0.0, self.radius)

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
        return point_emitters(
            self.position[None], _unit(self.direction)[None], self.intensity[None], cone, 0.0, self.radius
        )

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
        return directional_emitters(-_unit(self.direction)[None], self.irradiance[None])

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
        return point_emitters(self.center + self.radius * axis, axis, intensity, EVERYWHERE, 1.0, self.radius * 0.5)

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
        return point_emitters(
            self.center + s * self.u + t * self.v, axis, intensity, EVERYWHERE, 1.0, jnp.sqrt(area) / (2 * side)
        )

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
        direction, energy = median_cut(self.map, ENVIRONMENT_SAMPLES)
        return directional_emitters(direction @ rotation_matrix(self.rotation).T, jnp.asarray(energy))

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


def turned(lighting: Lighting, angle: float) -> Lighting:
    """The distant lights of a lighting turned about the vertical by an angle in radians; near lights stay where they are."""
    turn = Rotation.from_rotvec([0.0, angle, 0.0])

    def one(light: Light) -> Light:
        if isinstance(light, EnvironmentLight):
            whole = turn * Rotation.from_rotvec(np.array(light.rotation, float))
            return EnvironmentLight(light.map, jnp.asarray(whole.as_rotvec()))
        if isinstance(light, DirectionalLight):
            return DirectionalLight(jnp.asarray(turn.apply(np.array(light.direction, float))), light.irradiance)
        return light

    return Lighting(tuple(one(light) for light in lighting.lights))


def emitters(lightings: Sequence[Lighting]) -> Emitters:
    """Batch the emitters of N lightings into [N, Q, …], padded with emitters of zero intensity."""
    return batched([joined([light.emitters() for light in lighting.lights] or [darkness(1)]) for lighting in lightings])


def rotation_matrix(axis_angle: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation about an axis-angle vector in radians, smooth at zero (matrix exponential)."""
    x, y, z = axis_angle
    zero = jnp.zeros_like(x)
    return jax.scipy.linalg.expm(jnp.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]))


def _unit(vector: Array) -> Array:
    return vector / jnp.linalg.norm(vector)


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
            raise LightError(f"{kind}.{name} is {np.asarray(getattr(light, name))}, but must not be negative")
    for name in positive:
        if not np.all(np.asarray(getattr(light, name)) > 0):
            raise LightError(f"{kind}.{name} is {np.asarray(getattr(light, name))}, but must be above zero")
    for name in directions:
        if not np.linalg.norm(np.asarray(getattr(light, name))) > 0:
            raise LightError(f"{kind}.{name} is the zero vector, which points nowhere")
