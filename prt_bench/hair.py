"""What light meets at a hair fibre: reflection at its surface, and light that goes through it once, twice and more often.

The fibre is a dielectric cylinder much thinner than anything that sees it. Directions are given by the sine of their
inclination to the plane across the fibre and by the azimuth around it; the scattering function S makes radiance that leaves of
radiance that arrives, L_o = ∫ S L_i dω_i, so its integral over ω_i is the fibre's albedo. Strands of such fibres live in
`strands.py`, paths among them are followed in `data_gen/effects/hair.py`.

Four lobes p: R (reflected), TT (through), TRT (through, reflected within, through), and all further ones as one that is the
same around the fibre. Each is M_p(θ_i, θ_o) A_p(h, θ_o) D_p(φ − Φ_p(h)), with h ∈ [−1, 1] the place across the fibre's width
where light meets it; far from a fibre h is uniform.

@article{marschner2003hair, Marschner et al. 2003, "Light Scattering from Human Hair Fibers"}: lobes, A_p, Φ_p.
@inproceedings{deon2011hair, d'Eon et al. 2011, "An Energy-Conserving Hair Reflectance Model"}: M_p.
@article{chiang2016hair, Chiang et al. 2016, "A Practical and Controllable Hair and Fur Model for Production Path Tracing"}:
D_p, the last lobe, roughness and absorption from colour. Like theirs, S reaches reciprocity only as its variance goes to 0;
its integral over ω_i is exact, so that white fibres keep light that is the same everywhere.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import i0e

from prt_bench.errors import SceneError
from prt_bench.medium import GREATEST_IOR, Triple, fresnel

LOBES = 4
LEAST_VARIANCE, MOST_VARIANCE = 1e-7, 10.0
LEAST_SCALE, MOST_SCALE = 1e-4, 10.0
_ACROSS = 128  # nodes of the quadrature over h and over inclinations
_SERIES = (1 / 2, 1 / 8, 1 / 8, 25 / 128, 13 / 32, 1073 / 1024)
"""1 − I₁(x)/I₀(x) by powers of 1/x: quotient of the expansions for large x (Abramowitz and Stegun, 9.7.1)."""
_FAR = 50.0
"""From where that series is taken: the next term is below 1e-9 of it."""


class Inclination(NamedTuple):
    """Sine and cosine ≥ 0 of the angle between directions and the plane across the fibre."""

    sine: Float[np.ndarray, " n"]
    cosine: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, sine: Float[np.ndarray, " n"]) -> "Inclination":
        """From the sine alone: the cosine between a direction and the fibre's tangent."""
        sine = np.clip(sine, -1.0, 1.0)
        return cls(sine, np.sqrt((1.0 - sine) * (1.0 + sine)))

    def turned(self, angle: float) -> "Inclination":
        """Inclined by `angle` radians more; folded back at the poles."""
        cosine, sine = np.cos(angle), np.sin(angle)
        return Inclination(self.sine * cosine + self.cosine * sine, np.abs(self.cosine * cosine - self.sine * sine))


@dataclass(frozen=True)
class Hair:
    """The fibres of a material.

    `absorption` is per radius of the fibre, for red, green and blue, from 0 (white); `variance` that of the longitudinal lobe R
    (TT has a quarter of it, the others four times), `scale` that of the logistic distribution around the fibre, in radians;
    `ior` the index of refraction from 1 (nothing is reflected) to `GREATEST_IOR`; `tilt` that of the cuticle's scales in
    radians, towards the root.
    """

    absorption: Triple = (0.2, 0.35, 0.7)
    variance: float = 0.05
    scale: float = 0.2
    ior: float = 1.55
    tilt: float = 0.035

    def __post_init__(self) -> None:
        values = np.asarray(self.absorption, float)
        if values.shape != (3,) or not np.all((values >= 0) & np.isfinite(values)):
            raise SceneError(f"hair has absorption {self.absorption}, but it must be three numbers from 0 up")
        for name, low, high in (
            ("variance", LEAST_VARIANCE, MOST_VARIANCE),
            ("scale", LEAST_SCALE, MOST_SCALE),
            ("ior", 1.0, GREATEST_IOR),
            ("tilt", -0.5, 0.5),
        ):
            if not low <= getattr(self, name) <= high:
                raise SceneError(f"hair has {name} {getattr(self, name)}, but it must lie from {low:g} to {high:g}")

    @classmethod
    def of_roughness(
        cls,
        absorption: Triple,
        longitudinal: float = 0.3,
        azimuthal: float = 0.3,
        ior: float = 1.55,
        tilt: float = 0.035,
    ) -> "Hair":
        """From the two roughnesses in (0, 1] of Chiang et al. 2016, Section 4.1, which look evenly spaced."""
        for name, value in (("longitudinal", longitudinal), ("azimuthal", azimuthal)):
            if not 0 < value <= 1:
                raise SceneError(f"hair has {name} roughness {value}, but it must lie above 0 and up to 1")
        m, n = longitudinal, azimuthal
        variance = (0.726 * m + 0.812 * m**2 + 3.7 * m**20) ** 2
        return cls(
            absorption, variance, float(np.sqrt(np.pi / 8)) * (0.265 * n + 1.194 * n**2 + 5.372 * n**22), ior, tilt
        )

    @property
    def grey(self) -> bool:
        """Whether all channels are absorbed alike."""
        return len(set(self.absorption)) == 1

    @property
    def variances(self) -> tuple[float, float, float, float]:
        """Longitudinal variance of each lobe."""
        return self.variance, 0.25 * self.variance, 4.0 * self.variance, 4.0 * self.variance

    @cached_property
    def albedo(self) -> Triple:
        """κ: share of light from everywhere that fibres give back, the mean of what leaves around and along them."""
        node, weight = np.polynomial.legendre.leggauss(_ACROSS)
        angle = 0.5 * np.pi * node
        out = Inclination(np.sin(angle), np.cos(angle))
        share = weight * np.cos(angle) ** 2
        mean = np.einsum("t,tc->c", share / share.sum(), albedo_at(self, out))
        return (*(float(value) for value in np.clip(mean, 0.0, 1.0)),)  # pyright: ignore[reportReturnType]


def absorption_of(colour: Triple, azimuthal: float = 0.3) -> Triple:
    """Absorption whose multiple scattering looks like a colour in (0, 1] (Chiang et al. 2016, Section 4.2)."""
    values = np.asarray(colour, float)
    if values.shape != (3,) or not np.all((values > 0) & (values <= 1)):
        raise SceneError(f"hair has colour {colour}, but it must be three numbers above 0 and up to 1")
    n = azimuthal
    curve = 5.969 - 0.215 * n + 2.532 * n**2 - 10.73 * n**3 + 5.574 * n**4 + 0.245 * n**5
    return (*(float(value) for value in (np.log(values) / curve) ** 2),)  # pyright: ignore[reportReturnType]


def longitudinal(into: Inclination, out: Inclination, variance: Any) -> Any:
    """M(θ_i, θ_o) [n] with ∫ M cosθ_i dθ_i = 1, in the arguments' precision (d'Eon et al. 2011, Equation 7).

    exp(−s_i s_o / v) I₀(c_i c_o / v) / (2 v sinh(1/v)) overflows below v ≈ 0.1 in float32 as printed. With I₀ scaled by its own
    exponential the exponents add up to (cos(θ_i + θ_o) − 1) / v ≤ 0, and cos − 1 is a square. Given arrays of NumPy it gives
    one; given any of JAX it gives one of JAX, differentiable in the variance and in both inclinations.
    """
    product = into.cosine * out.cosine / variance
    lib, bessel = (jnp, scaled_bessel) if isinstance(product, jax.Array) else (np, i0e)
    # 1 − cos(θ_i + θ_o) is half the squared chord between the direction and the mirrored other: no digits cancel.
    chord = (into.sine + out.sine) ** 2 + (into.cosine - out.cosine) ** 2
    return bessel(product) * lib.exp(-0.5 * chord / variance) / (variance * -lib.expm1(-2.0 / variance))


@jax.custom_jvp
def scaled_bessel(x: Float[Array, " n"]) -> Float[Array, " n"]:
    """exp(−x) I₀(x) for x ≥ 0. Its slope is −exp(−x) I₀(x) times 1 − I₁(x)/I₀(x), which cancels where x is large."""
    return jax.scipy.special.i0e(x)


@scaled_bessel.defjvp
def _bessel_slope(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (x,), (change,) = primals, tangents
    value, inverse = jax.scipy.special.i0e(x), 1.0 / jnp.maximum(x, _FAR)
    series = jnp.zeros_like(x)
    for term in reversed(_SERIES):
        series = (series + term) * inverse
    lost = jnp.where(x > _FAR, series, 1.0 - jax.scipy.special.i1e(x) / value)
    return value, -value * lost * change


def azimuthal(angle: Float[np.ndarray, " n"], scale: float | Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """D: the logistic density over one turn, of any angle in radians; integrates to 1 around the fibre."""
    wrapped = np.abs(np.mod(angle + np.pi, 2.0 * np.pi) - np.pi) / scale
    tail = np.exp(-wrapped)
    return tail / (scale * (1.0 + tail) ** 2) / np.tanh(0.5 * np.pi / scale)


class Crossing(NamedTuple):
    """What happens to light that meets a fibre at h: the weights A_p [n, 4, C] and turns Φ_p [n, 3] of lobes in radians."""

    weights: Float[np.ndarray, "n 4 C"]
    turns: Float[np.ndarray, "n 3"]


def crossing(hair: Hair, out: Inclination, h: Float[np.ndarray, " n"], channels: slice = slice(None)) -> Crossing:
    """Attenuations and azimuths at h ∈ [−1, 1] for light that leaves at the inclination `out` (Chiang et al., Section 3)."""
    cosine = np.maximum(out.cosine, 1e-7)
    bent = np.sqrt(hair.ior**2 - out.sine**2) / cosine  # Bravais: the index seen in the plane across
    inside, outside = h / bent, np.sqrt(np.maximum(1.0 - h * h, 0.0))
    reflected = fresnel(np.minimum(cosine * outside, 1.0), hair.ior)[:, None]
    along = np.sqrt(1.0 - (out.sine / hair.ior) ** 2)
    path = 2.0 * np.sqrt(np.maximum(1.0 - inside**2, 0.0)) / np.maximum(along, 1e-7)
    passed = np.exp(-path[:, None] * np.asarray(hair.absorption, float)[channels])
    through = (1.0 - reflected) ** 2 * passed
    again = through * passed * reflected
    rest = again * reflected * passed / np.maximum(1.0 - reflected * passed, 1e-12)
    weights = np.stack([np.broadcast_to(reflected, passed.shape), through, again, rest], axis=1)
    o, t = np.arcsin(np.clip(h, -1.0, 1.0)), np.arcsin(np.clip(inside, -1.0, 1.0))
    turns = np.stack([2.0 * p * t - 2.0 * o + p * np.pi for p in range(3)], axis=1)
    return Crossing(weights, turns)


def tilted(hair: Hair, out: Inclination) -> tuple[Inclination, ...]:
    """What each lobe takes for the inclination that light leaves at: scales of the cuticle tilt R, TT and TRT differently."""
    return (*(out.turned(share * hair.tilt) for share in (-2.0, 1.0, 4.0)), out)


def scattering(
    hair: Hair,
    out: Inclination,
    into: Inclination,
    azimuth: Float[np.ndarray, " n"],
    h: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """S per steradian at the place h, for an angle around the fibre of `azimuth` radians from ω_o to ω_i."""
    found = crossing(hair, out, h)
    total = np.zeros((len(h), 3))
    for p, leaving in enumerate(tilted(hair, out)):
        around = azimuthal(azimuth - found.turns[:, p], hair.scale) if p < 3 else 0.5 / np.pi
        total += found.weights[:, p] * (longitudinal(into, leaving, hair.variances[p]) * around)[:, None]
    return total


def far_scattering(
    hair: Hair, out: Inclination, into: Inclination, azimuth: Float[np.ndarray, " n"], nodes: int = _ACROSS
) -> Float[np.ndarray, "n 3"]:
    """S of a fibre that is seen from afar: the mean over h, by Gauss–Legendre quadrature."""
    return sum(  # pyright: ignore[reportReturnType]
        0.5 * weight * scattering(hair, out, into, azimuth, np.full(len(azimuth), node))
        for node, weight in zip(*np.polynomial.legendre.leggauss(nodes), strict=True)
    )


def albedo_at(hair: Hair, out: Inclination) -> Float[np.ndarray, "n 3"]:
    """∫ S dω_i of fibres seen from afar at each inclination: the sum of the weights A_p, mean over h."""
    node, weight = np.polynomial.legendre.leggauss(_ACROSS)
    # h = sin γ takes the square root at the rim out of the integrand.
    gamma = 0.5 * np.pi * node
    shares = 0.25 * np.pi * weight * np.cos(gamma)
    total = np.zeros((len(out.sine), 3))
    for place, share in zip(np.sin(gamma), shares, strict=True):
        total += share * crossing(hair, out, np.full(len(out.sine), place)).weights.sum(axis=1)
    return total


class Draw(NamedTuple):
    """Sampled scattering: the `lobe`, the sine of ω_i's inclination and its azimuth from ω_o in radians."""

    lobe: Int[np.ndarray, " n"]
    sine: Float[np.ndarray, " n"]
    azimuth: Float[np.ndarray, " n"]


def draw(
    hair: Hair,
    out: Inclination,
    found: Crossing,
    lobe: Int[np.ndarray, " n"],
    u: Float[np.ndarray, "3 n"],
) -> Draw:
    """ω_i of given lobes by the densities M_p cosθ_i and D_p, from uniform numbers in [0, 1) (d'Eon et al. 2013, "Importance
    Sampling for Physically-Based Hair Fiber Models")."""
    variance = np.asarray(hair.variances)[lobe]
    # u + (1 − u) exp(−2/v) without cancelling, and 1 − its −v-fold logarithm: the cosine about the lobe's middle.
    first = 1.0 - u[0]
    drop = -variance * np.log1p(-(1.0 - first) * -np.expm1(-2.0 / variance))
    cosine = np.clip(1.0 - drop, -1.0, 1.0)
    ring = np.sqrt(np.clip(drop * (2.0 - drop), 0.0, 1.0)) * np.cos(2.0 * np.pi * u[1])
    every = tilted(hair, out)
    sine, flat = (np.stack([part[i] for part in every])[lobe, np.arange(len(lobe))] for i in (0, 1))
    turned = np.concatenate([found.turns, np.zeros((len(lobe), 1))], axis=1)[np.arange(len(lobe)), lobe]
    edge = 1.0 / (1.0 + np.exp(np.minimum(np.pi / hair.scale, 700.0)))
    share = edge + (1.0 - 2.0 * edge) * u[2]
    logistic = hair.scale * (np.log(np.maximum(share, 1e-300)) - np.log(np.maximum(1.0 - share, 1e-17)))
    around = np.where(lobe < 3, turned + np.clip(logistic, -np.pi, np.pi), 2.0 * np.pi * u[2])
    return Draw(lobe, np.clip(-cosine * sine + ring * flat, -1.0, 1.0), around)
