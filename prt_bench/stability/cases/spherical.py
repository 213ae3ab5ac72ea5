"""Spherical harmonics: values and gradients at the poles, rotations, positive windows, lobes, triple products, bright maps."""

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench import spherical as library
from prt_bench.environment import texel_directions
from prt_bench.spherical import azimuths, bands, quadrature
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.routes import F32, F64, Route

_BOTH = (F64, F32)


def spherical() -> dict[str, ModuleType]:
    """The package, whose functions are looked up when they are called."""
    return {"spherical": library}


def _directions(route: Route) -> np.ndarray:
    """Poles, axes, from close to a pole to anywhere; unit vectors as far as the dtype can say."""
    rng = np.random.default_rng(0)
    spread = np.concatenate([np.repeat(10.0 ** -np.arange(1.0, 9.0), 4), np.ones(32)])[:, None]
    near = rng.normal(size=(64, 3)) * np.concatenate([spread, spread, 1 + 0 * spread], axis=1)
    every = np.concatenate([np.eye(3), -np.eye(3), near])
    return route.arrive(every / np.linalg.norm(every, axis=1, keepdims=True))


def _by_scipy(directions: np.ndarray, order: int) -> np.ndarray:
    """Real harmonics from scipy's complex ones, in float64."""
    from scipy.special import sph_harm_y

    x, y, z = np.asarray(directions, np.float64).T
    size = np.abs(azimuths(order))
    value = sph_harm_y(bands(order), size, np.arctan2(np.hypot(x, y), z)[:, None], np.arctan2(y, x)[:, None])
    value = value * (-1.0) ** size * np.where(size > 0, np.sqrt(2.0), 1.0)
    return np.where(azimuths(order) < 0, value.imag, value.real)


def _orders(route: Route) -> Iterator[Member]:
    return (Member(f"order {order}", order) for order in (1, 2, 5, 10, 30))


@case("D1", "harmonics of high order", subjects=spherical, family=_orders, routes=_BOTH)
def values(tested: Any, order: int, route: Route) -> Iterator[Measured]:
    """D1: scipy's values within 30 · order · eps, Unsöld's sums, orthonormality. Factorials overflow float32 from 35! on."""
    directions = _directions(route)
    found = np.asarray(tested.evaluate(directions, order), np.float64)
    length = np.linalg.norm(directions.astype(np.float64), axis=1, keepdims=True)
    unit = order * route.eps
    yield Measured(float(np.abs(found - _by_scipy(directions / length, order)).max()), 30 * unit)
    sums = np.add.reduceat(found**2, np.arange(order) ** 2, axis=1) * 4 * np.pi / (2 * np.arange(order) + 1)
    yield Measured(float(np.abs(sums - 1).max()), 60 * unit)
    points, weight = quadrature(2 * (order - 1))
    whole = np.asarray(tested.evaluate(route.arrive(points), order), np.float64)
    yield Measured(float(np.abs(whole.T * weight @ whole - np.eye(order**2)).max()), 60 * unit)


@case("D2", "harmonics at the poles", kind=Kind.GRADIENT, subjects=spherical, family=_orders, routes=_BOTH)
def gradient(tested: Any, order: int, route: Route) -> Iterator[Measured]:
    """D2: along tangents, against differences on the sphere in float64; angles have no derivative at a pole."""
    directions = _directions(route)
    across = np.cross(directions, np.random.default_rng(1).normal(size=directions.shape))
    tangent = (across / np.linalg.norm(across, axis=1, keepdims=True)).astype(route.compute)
    slope = jax.jvp(lambda d: tested.evaluate(d, order), (jnp.asarray(directions),), (jnp.asarray(tangent),))[1]
    slope, here, tangent = (np.asarray(part, np.float64) for part in (slope, directions, tangent))

    def difference(step: float) -> np.ndarray:
        ahead, behind = (np.cos(step) * here + sign * np.sin(step) * tangent for sign in (1, -1))
        return (_by_scipy(ahead, order) - _by_scipy(behind, order)) / (2 * step)

    step = 1e-3 / order
    wanted = (4 * difference(step) - difference(2 * step)) / 3
    yield Measured(float(np.abs(slope - wanted).max() / order**1.5), route.gradient_tolerance)


def _rotations(route: Route) -> Iterator[Member]:
    rng = np.random.default_rng(2)
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    angle = 1e-6
    tiny = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    any_turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for name, matrix in {
        "identity": np.eye(3), "half turn about x": np.diag([1.0, -1, -1]), "half turn about z": np.diag([-1.0, -1, 1]),
        "locked, pole to the equator": quarter, "locked the other way": quarter.T, "tiny": tiny,
        "half turn and a little": np.diag([1.0, -1, -1]) @ tiny, "any": any_turn * np.linalg.det(any_turn),
    }.items():  # fmt: skip
        for order in (1, 5, 20):
            yield Member(f"{name}, order {order}", (route.arrive(matrix), order))


@case("D3", "rotations where angles lock", subjects=spherical, family=_rotations, routes=_BOTH)
def rotation(tested: Any, posed: tuple[np.ndarray, int], route: Route) -> Iterator[Measured]:
    """D3: harmonics of turned directions are turned harmonics; blocks are orthogonal, and the transposed turn undoes them."""
    matrix, order = posed
    blocks = tested.rotation_blocks(matrix, order)
    whole = np.asarray(tested.block_diagonal(blocks), np.float64)
    here = _directions(F64)
    turned, plain = _by_scipy(here @ matrix.T.astype(np.float64), order), _by_scipy(here, order)
    unit = order * route.eps
    yield Measured(float(np.abs(plain @ whole.T - turned).max()), 30 * unit)
    yield Measured(float(np.abs(whole @ whole.T - np.eye(order**2)).max()), 30 * unit)
    if order <= 5:
        vector = np.random.default_rng(3).normal(size=(1, order**2)).astype(route.compute)
        back = tested.rotate(tested.rotate(vector, matrix[None]), matrix.T[None])
        yield Measured(float(np.abs(np.asarray(back, np.float64) - vector).max()), 50 * unit)


@case("D3", "rotations where angles lock", kind=Kind.GRADIENT, subjects=spherical, family=_rotations, routes=_BOTH)
def rotation_gradient(tested: Any, posed: tuple[np.ndarray, int], route: Route) -> Iterator[Measured]:
    """D3: the derivative along a turn is the same at every rotation: that at the identity times the blocks."""
    matrix, order = posed
    order = min(order, 6)  # later bands follow the same recursion
    axis = np.array([[0.0, -0.3, 0.5], [0.3, 0.0, -0.7], [-0.5, 0.7, 0.0]], route.compute)

    def along(at: np.ndarray) -> np.ndarray:
        moved = jax.jvp(
            lambda r: tested.block_diagonal(tested.rotation_blocks(r, order)), (jnp.asarray(at),), (axis @ at,)
        )
        return np.asarray(moved[1], np.float64)

    whole = np.asarray(tested.block_diagonal(tested.rotation_blocks(matrix, order)), np.float64)
    gap = along(matrix) - along(np.eye(3, dtype=route.compute)) @ whole
    yield Measured(float(np.abs(gap).max() / order), route.gradient_tolerance)


@case("D4", "delta lights under the positive window", subjects=spherical, family=_orders, routes=_BOTH)
def undershoot(tested: Any, order: int, route: Route) -> Iterator[Measured]:
    """D4: nowhere negative, relative to the peak, with the mean kept; without a window it undershoots by an eighth or more."""
    factors = tested.positive(order)
    towards = route.arrive(np.array([[0.48, 0.6, 0.64]]))
    light = tested.convolve(tested.evaluate(towards, order), factors)[0]
    points = route.arrive(quadrature(4 * order)[0])
    found = np.asarray(tested.evaluate(points, order) @ light, np.float64)
    peak = order * order / (4 * np.pi)
    yield Measured(float(max(-found.min(), 0.0) / peak), 30 * order * route.eps)
    yield Measured(float(abs(light[0] * np.sqrt(4 * np.pi) - 1)), 4 * route.eps)
    if order > 1:
        yield Measured(1.0 - float(factors[1]), 12 / (order + 2) ** 2)  # what leaves the mean alone is no window


def _lobes(route: Route) -> Iterator[Member]:
    for exponent in (0.0, 0.3, 1.0, 2.0, 2.7, 7.5, 32.0, 1e3, 1e6, 1e30, np.inf):
        yield Member(f"exponent {exponent:g}", route.compute(exponent))


def _lobe_factors(exponent: float, order: int) -> np.ndarray:
    """By quadrature in v = tˢ⁺¹, where the lobe is constant: λ_l = ∫₀¹ P_l(v^(1/(s + 1))) dv, cut where it is flat enough."""
    nodes, weight = np.polynomial.legendre.leggauss(200)
    power, size = 0.5 * (nodes + 1.0), 0.5 * weight
    v, dv = power**8, 8 * power**7 * size  # roots of v are smooth in its eighth root
    return np.polynomial.legendre.legvander(v ** (1.0 / (1.0 + exponent)), order - 1).T @ dv


@case("D5", "Phong lobes of any exponent", subjects=spherical, family=_lobes, routes=_BOTH)
def lobes(tested: Any, exponent: Any, route: Route) -> Iterator[Measured]:
    """D5: the integrals, whole or broken exponents, from the hemisphere to the mirror; never above one in size."""
    found = np.asarray(tested.phong_lobe(exponent, 12), np.float64)
    yield Measured(float(np.abs(found - _lobe_factors(float(exponent), 12)).max()), 100 * route.eps + 1e-11)
    yield Measured(float(np.abs(found).max()), 1.0)


@case("D5", "Phong lobes of any exponent", kind=Kind.GRADIENT, subjects=spherical, family=_lobes, routes=_BOTH)
def lobe_gradient(tested: Any, exponent: Any, route: Route) -> Iterator[Measured]:
    """D5: the derivative in the exponent, times 1 + s, against differences of the integrals in log(1 + s)."""
    slope = np.asarray(jax.jacfwd(lambda s: tested.phong_lobe(s, 9))(jnp.asarray(exponent)), np.float64)
    s = float(exponent)
    if not np.isfinite(s):
        yield Measured(float(np.abs(slope).max()), route.gradient_tolerance)
        return
    ahead, behind = (_lobe_factors((1 + s) * np.exp(sign * 1e-4) - 1, 9) for sign in (1, -1))
    yield Measured(float(np.abs(slope * (1 + s) - (ahead - behind) / 2e-4).max()), max(route.gradient_tolerance, 1e-5))


def _caps(route: Route) -> Iterator[Member]:
    for angle in (0.0, 1e-20, 1e-4, 0.00465, 0.3, np.pi / 2, 3.0, np.pi):
        yield Member(f"half-angle {angle:g}", route.compute(angle))


@case("D5", "caps from points to spheres", subjects=spherical, family=_caps, routes=_BOTH)
def caps(tested: Any, angle: Any, route: Route) -> Iterator[Measured]:
    """The mean of P_l over the cap by quadrature; in float32 the sun's cap keeps its digits."""
    nodes, weight = np.polynomial.legendre.leggauss(40)
    half_sine = np.sin(0.5 * float(angle)) ** 2
    wanted = np.polynomial.legendre.legvander(1 - half_sine * (1 + nodes), 9).T @ (0.5 * weight)
    yield Measured(float(np.abs(np.asarray(tested.cap_lobe(angle, 10), np.float64) - wanted).max()), 100 * route.eps)
    size = float(tested.cap_solid_angle(angle))
    yield Measured(abs(size - 4 * np.pi * half_sine), 10 * route.eps * 4 * np.pi * half_sine + 1e-37)


def _tensors(route: Route) -> Iterator[Member]:
    return (Member(f"order {order}", order) for order in (1, 2, 3, 4, 5, 6, 10))


@case("D6", "triple products", subjects=spherical, family=_tensors, routes=_BOTH)
def triples(tested: Any, order: int, route: Route) -> Iterator[Measured]:
    """D6: symmetric, sparse, and against a quadrature of high degree: every entry up to order 6, products of functions else."""
    found = tested.triple_products(order)
    points, weight = quadrature(3 * order + 7)
    harmonics = _by_scipy(points, order)
    rng = np.random.default_rng(order)
    a, b, c = route.arrive(rng.normal(size=(3, order**2)))
    x, y, z = harmonics @ a, harmonics @ b, harmonics @ c
    wanted = harmonics.T @ (weight * x * y)
    unit = route.eps * order**2
    yield Measured(float(np.abs(np.asarray(tested.product(a, b)) - wanted).max()), 30 * unit)
    matrix = np.asarray(tested.product_matrix(a), np.float64)
    yield Measured(float(np.abs(matrix - matrix.T).max()), 4 * unit)
    yield Measured(abs(float(b @ matrix @ c) - float(np.sum(weight * x * y * z))), 30 * unit * order**2)
    if order > 1:
        yield Measured(tested.sparse_operations(order) / tested.dense_operations(order), 0.2)
    if order <= 6:
        whole = np.einsum("q,qi,qj,qk->ijk", weight, harmonics, harmonics, harmonics, optimize=True)
        whole[tuple(found.indices.T)] -= found.values
        yield Measured(float(np.abs(whole).max()), 1e-13)


def _maps(route: Route) -> Iterator[Member]:
    rng = np.random.default_rng(4)
    sky = rng.random((8, 16, 3))
    sun, pole = sky.copy(), sky.copy()
    sun[2, 11] = 1e5
    pole[0, 3] = 1e5
    decades = 10.0 ** rng.uniform(-6, 4, (8, 16, 1)) * np.ones(3)
    for name, image in {
        "sky": sky, "sun": sun, "sun at the pole": pole, "twelve decades": decades, "one texel": np.ones((1, 1, 3)),
        "one row": rng.random((1, 16, 3)), "constant": np.ones((6, 12, 3)), "dark": np.zeros((4, 8, 3)),
    }.items():  # fmt: skip
        for order in (1, 5, 10):
            yield Member(f"{name}, order {order}", (route.arrive(image), order))


def _integrated(image: np.ndarray, order: int) -> np.ndarray:
    """Every texel by Gauss–Legendre points in both angles, of scipy's harmonics in the frame of the world."""
    height, width = image.shape[:2]
    nodes, weight = np.polynomial.legendre.leggauss(24 if height < 4 else 10)
    theta = (np.arange(height)[:, None] + 0.5 + 0.5 * nodes) * np.pi / height
    phi = ((np.arange(width)[:, None] + 0.5 + 0.5 * nodes) / width * 2 - 1) * np.pi
    total = np.zeros((order**2, 3))
    if width == 1:
        phi, weight_phi = (np.arange(48)[None] + 0.5) / 48 * 2 * np.pi - np.pi, np.full(48, np.pi / 24)
    else:
        weight_phi = weight * np.pi / width
    for row in range(height):
        t, p = theta[row][None, :, None], phi[:, None, :]
        direction = np.stack(np.broadcast_arrays(np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)), axis=-1)
        area = np.sin(t) * weight[:, None] * weight_phi * (np.pi / height / 2)
        values = _by_scipy(direction.reshape(-1, 3), order).reshape(*direction.shape[:-1], -1)
        total += np.einsum("wabk,wab,wc->kc", values, np.broadcast_to(area, direction.shape[:-1]), image[row])
    return total


@case("D1", "environment maps with a sun", subjects=spherical, family=_maps, routes=_BOTH)
def maps(tested: Any, posed: tuple[np.ndarray, int], route: Route) -> Iterator[Measured]:
    """D1, G3: every texel's integral, relative to the energy of the map; its mean to rounding, whatever is in one texel."""
    image, order = posed
    found = np.asarray(tested.project_environment(image, order), np.float64)
    precise = image.astype(np.float64)
    energy = np.sum(precise * texel_directions(*image.shape[:2])[1][..., None], axis=(0, 1))
    size = float(energy.max()) or 1.0
    yield Measured(float(np.abs(found - _integrated(precise, order)).max() / size), 1e-12)
    yield Measured(float(np.abs(found[0] * np.sqrt(4 * np.pi) - energy).max() / size), 1e-13)
