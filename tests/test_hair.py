"""The fibre's scattering function: energy, closed forms, quadrature and sampling."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import i0
from scipy.stats import kstest

from prt_bench.errors import SceneError
from prt_bench.hair import (
    Hair,
    Inclination,
    absorption_of,
    albedo_at,
    azimuthal,
    crossing,
    draw,
    far_scattering,
    longitudinal,
    scattering,
)
from prt_bench.medium import fresnel

WHITE = (0.0, 0.0, 0.0)


def inclined(angle: float | np.ndarray) -> Inclination:
    angle = np.atleast_1d(np.asarray(angle, float))
    return Inclination(np.sin(angle), np.cos(angle))


@pytest.mark.parametrize("variance", [1e-6, 1e-3, 0.01, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("leaving", [-1.2, 0.0, 0.7, 1.5])
def test_the_longitudinal_lobe_integrates_to_one(variance: float, leaving: float) -> None:
    def integrand(angle: float) -> float:
        return float(longitudinal(inclined(angle), inclined(leaving), variance)[0]) * np.cos(angle)

    width = 12.0 * np.sqrt(variance)
    edges = np.clip([-np.pi / 2, -leaving - width, -leaving, -leaving + width, np.pi / 2], -np.pi / 2, np.pi / 2)
    total = sum(quad(integrand, low, high, limit=200)[0] for low, high in pairwise(edges))
    assert total == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("variance", [0.1, 0.01, 1e-4, 1e-6])
def test_the_longitudinal_lobe_is_stable_in_float32(variance: float) -> None:
    """F4: the printed form overflows in float32 at the variance 0.01 and below."""
    leaving, angle = 0.3, -0.3 + np.sqrt(variance) * np.linspace(-3.0, 3.0, 61)
    single = [Inclination(*(part.astype(np.float32) for part in inclined(each))) for each in (angle, leaving)]
    found = longitudinal(*single, np.float32(variance))  # pyright: ignore
    assert found.dtype == np.float32
    # Beside the lobe's middle sines in float32 are half a unit off, which is much of a narrow lobe's width.
    off = 1e-5 + 4e-7 / np.sqrt(variance)
    np.testing.assert_allclose(found, longitudinal(inclined(angle), inclined(leaving), variance), rtol=off)
    with np.errstate(all="ignore"):
        (s_i, c_i), (s_o, c_o), v = *single, np.float32(variance)
        naive = np.exp(-s_i * s_o / v) * i0(c_i * c_o / v) / (2 * v * np.sinh(1 / v))
    assert np.all(np.isfinite(naive)) == (variance == 0.1)


def test_the_longitudinal_lobe_is_the_printed_one() -> None:
    into, out, v = inclined(np.linspace(-1.4, 1.4, 9)), inclined(0.4), 0.3
    printed = np.exp(-into.sine * out.sine / v) * i0(into.cosine * out.cosine / v) / (2 * v * np.sinh(1 / v))
    np.testing.assert_allclose(longitudinal(into, out, v), printed, rtol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 0.2, 5.0])
def test_the_azimuthal_lobe_integrates_to_one(scale: float) -> None:
    points = [0.0, 20 * scale, np.pi] if 20 * scale < np.pi else [0.0, np.pi]
    parts = pairwise(points)
    half = sum(quad(lambda x: azimuthal(np.array([x]), scale)[0], low, high, limit=200)[0] for low, high in parts)
    assert half == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("ior", [1.0, 1.55, 2.5])
def test_white_fibres_return_everything(ior: float) -> None:
    hair = Hair(WHITE, ior=ior)
    np.testing.assert_allclose(hair.albedo, 1.0, rtol=1e-9)
    np.testing.assert_allclose(albedo_at(hair, inclined([-1.5, 0.0, 1.0])), 1.0, rtol=1e-9)


@pytest.mark.parametrize("leaving", [0.0, 0.8])
def test_the_albedo_is_the_integral_over_directions(leaving: float) -> None:
    hair = Hair((0.1, 0.5, 2.0), variance=0.1, scale=0.5)
    node, weight = np.polynomial.legendre.leggauss(80)
    into = inclined(0.5 * np.pi * node)
    azimuth = 2.0 * np.pi * np.arange(80) / 80
    total = np.zeros(3)
    for angle in azimuth:
        leaves = Inclination(*(np.full(80, part[0]) for part in inclined(leaving)))
        values = far_scattering(hair, leaves, into, np.full(80, angle), 48)
        total += np.einsum("n,nc->c", weight * 0.5 * np.pi * into.cosine, values) * 2.0 * np.pi / 80
    np.testing.assert_allclose(total, albedo_at(hair, inclined(leaving))[0], rtol=2e-3)


def test_light_through_the_middle_of_a_fibre() -> None:
    """At h = 0 and normal incidence light goes through the diameter: (1 − F)² exp(−2σ), and on in closed form."""
    hair = Hair((0.3, 0.0, 50.0), ior=1.5)
    found = crossing(hair, inclined(0.0), np.zeros(1))
    f, t = fresnel(np.ones(1), 1.5)[0], np.exp(-2.0 * np.array(hair.absorption))
    expected = [
        np.full(3, f),
        (1 - f) ** 2 * t,
        (1 - f) ** 2 * t * t * f,
        (1 - f) ** 2 * t * (f * t) ** 2 / (1 - f * t),
    ]
    np.testing.assert_allclose(found.weights[0], expected, rtol=1e-12)
    np.testing.assert_allclose(found.turns[0], [0.0, np.pi, 2.0 * np.pi], atol=1e-12)
    assert np.all(crossing(replace(hair, ior=1.0), inclined(0.2), np.array([0.9])).weights[0, 0] == 0.0)


def test_refraction_turns_light_by_snells_law() -> None:
    found = crossing(Hair(ior=1.4), inclined(0.0), np.array([0.6]))
    assert found.turns[0, 1] == pytest.approx(np.pi + 2.0 * (np.arcsin(0.6 / 1.4) - np.arcsin(0.6)))


def test_drawn_directions_have_the_density_of_their_lobe() -> None:
    hair, count = Hair(WHITE, variance=0.08, scale=0.3), 20_000
    rng = np.random.default_rng(0)
    out, h = Inclination(*(np.full(count, part[0]) for part in inclined(0.5))), np.full(count, 0.4)
    found = crossing(hair, out, h)
    for p in range(4):
        drawn = draw(hair, out, found, np.full(count, p), rng.random((3, count)))
        lobe = out if p == 3 else out.turned((-2.0, 1.0, 4.0)[p] * hair.tilt)
        angles = np.linspace(-np.pi / 2, np.pi / 2, 4001)
        density = longitudinal(inclined(angles), Inclination(lobe.sine[0], lobe.cosine[0]), hair.variances[p])
        cumulative = np.concatenate(
            [[0.0], np.cumsum(0.5 * np.diff(angles) * ((d := density * np.cos(angles))[1:] + d[:-1]))]
        )
        assert kstest(np.arcsin(drawn.sine), lambda x, a=angles, c=cumulative: np.interp(x, a, c)).pvalue > 1e-3
        turns = np.linspace(-np.pi, np.pi, 4001)
        around = azimuthal(turns, hair.scale) if p < 3 else np.full(4001, 0.5 / np.pi)
        cumulative = np.concatenate([[0.0], np.cumsum(np.diff(turns) * 0.5 * (around[1:] + around[:-1]))])
        off = drawn.azimuth - (found.turns[:, p] if p < 3 else 0.0)
        off = np.mod(off + np.pi, 2.0 * np.pi) - np.pi
        assert kstest(off, lambda x, a=turns, c=cumulative: np.interp(x, a, c)).pvalue > 1e-3


def test_drawing_is_finite_for_all_numbers_and_narrow_lobes() -> None:
    edge = np.array([0.0, np.nextafter(1.0, 0.0)])
    u = np.stack([part.ravel() for part in np.meshgrid(edge, edge, edge)])
    for variance, scale in ((1e-7, 1e-4), (10.0, 10.0)):
        hair = Hair(WHITE, variance=variance, scale=scale)
        out = Inclination.of(np.full(8, 1.0))
        for p in range(4):
            drawn = draw(hair, out, crossing(hair, out, np.full(8, 1.0)), np.full(8, p), u)
            assert np.all(np.isfinite(drawn.sine))
            assert np.all(np.isfinite(drawn.azimuth))
            assert np.all(np.abs(drawn.sine) <= 1.0)


def test_reciprocity_comes_with_narrow_lobes() -> None:
    """S cosθ_i is what the model gives; without tilt, S(i, o) and S(o, i) differ by less the narrower the lobes are."""
    defects = []
    for variance in (0.3, 0.003):
        hair = Hair((0.2, 0.2, 0.2), variance=variance, scale=0.3, tilt=0.0)
        rng, spread = np.random.default_rng(1), np.sqrt(variance)
        a = rng.uniform(-1.0, 1.0, 300)
        into, out, azimuth = inclined(-a + spread * rng.normal(size=300)), inclined(a), rng.uniform(-np.pi, np.pi, 300)
        forth = far_scattering(hair, out, into, azimuth, 32)[:, 0] / into.cosine
        back = far_scattering(hair, into, out, -azimuth, 32)[:, 0] / out.cosine
        kept = (into.cosine > 0.2) & (forth > 1e-6)
        defects.append(np.mean(np.abs(forth - back)[kept] / (forth + back)[kept]))
    assert defects[1] < 0.25 * defects[0]


def test_far_scattering_is_the_mean_across_the_fibre() -> None:
    hair, rng = Hair(scale=0.5), np.random.default_rng(2)
    h = 2.0 * (np.arange(40_000) + 0.5) / 40_000 - 1.0
    out, into, azimuth = inclined(0.2), inclined(-0.4), np.full(1, rng.uniform(-3.0, 3.0))
    wide = [Inclination(*(np.full(len(h), part[0]) for part in each)) for each in (out, into)]
    mean = scattering(hair, *wide, np.full(len(h), azimuth[0]), h).mean(axis=0)  # pyright: ignore
    np.testing.assert_allclose(far_scattering(hair, out, into, azimuth)[0], mean, rtol=2e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"absorption": (0.1, -1.0, 0.0)}, "absorption .* three numbers from 0 up"),
        ({"absorption": (0.1, np.inf, 0.0)}, "absorption .* three numbers from 0 up"),
        ({"variance": 0.0}, "variance 0.0, but it must lie from 1e-07 to 10"),
        ({"scale": 0.0}, "scale 0.0"),
        ({"ior": 0.9}, "ior 0.9, but it must lie from 1 to 3"),
        ({"tilt": 1.0}, "tilt 1.0"),
    ],
)
def test_impossible_fibres_are_refused_in_one_sentence(settings: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message) as error:
        Hair(**settings)
    assert "\n" not in str(error.value)


def test_colour_and_roughness() -> None:
    dark, light = (Hair.of_roughness(absorption_of((c, c, c))).albedo[0] for c in (0.1, 0.8))
    assert dark < light < 1.0
    assert absorption_of((1.0, 1.0, 1.0)) == (0.0, 0.0, 0.0)
    with pytest.raises(SceneError, match="above 0 and up to 1"):
        absorption_of((0.0, 0.5, 0.5))
    with pytest.raises(SceneError, match="azimuthal roughness 0"):
        Hair.of_roughness(WHITE, 0.3, 0.0)
