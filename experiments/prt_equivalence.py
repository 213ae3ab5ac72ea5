"""Transfer from measured light is classical precomputed radiance transfer, shown numerically.

After section 3.3 of Belcour et al. 2022. Light of a linear space has coefficients w: intensities of point lights, or spherical
harmonics of distant light. Measured light is x = T w and indirect light y = Y w, so a transfer M from x is a classical
transfer M T from w, to be compared with P = Uᵀ Y. Prints cond(T), and for each ridge in float64 and float32 the relative
difference ‖M T − P‖ / ‖P‖ in the spectral norm, that of predictions for lights drawn at random, and what a ridge regression
from w itself differs by. Then what becomes of noise in x: through M, and through classical transfer of w = T⁺ x.

    python experiments/prt_equivalence.py [--scene cornell] [--basis 64] [--orders 5 10] [--data DIR]
"""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from _frames import arguments, bake, table
from scipy.special import sph_harm_y

import prt_bench as prt
from prt_bench.linalg import leading_basis, relative_damping, ridge, rounding_floor

RIDGES = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2)
SHOWN = (0.0, 1e-6, 1e-3)
NOISE = (1e-7, 1e-4, 1e-2)
DIRECTIONS = 256
EXAMPLES = 1024


def main() -> None:
    settings = arguments(__doc__, None, scene="cornell", basis=64, orders=[5, 10]).parse_args()
    ds = bake(settings.scene, "point", settings.data)
    for name, t, y in spaces(ds, settings.orders):
        study(name, t, y, settings.basis)


def spaces(ds: prt.LightingDataset, orders: list[int]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, T [M, K] and Y [T, K] of spaces of light; of the first colour channel."""
    train = ds.split("train")
    own = np.array([vars(lighting.lights[0])["intensity"][0] for lighting in train.lightings])
    x, y = train.measured[:, :, 0].T / own, train.indirect[:, :, 0].T / own
    for count in (32, len(train)):
        yield f"intensities of {count} point lights", x[:, :count], y[:, :count]
    index = np.arange(DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * index / DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * index
    ring = np.sqrt(1.0 - height**2)
    towards = np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)
    lit = prt.light(ds, [prt.Lighting([prt.DirectionalLight(-way, (1.0, 1.0, 1.0))]) for way in towards])
    for order in orders:
        weight = 4.0 * np.pi / DIRECTIONS * harmonics(np.arccos(height), turn, order)
        x, y = (light[:, :, 0].T.astype(float) @ weight for light in (lit.measured, lit.indirect))
        yield f"{order**2} spherical harmonics of distant light", x, y


def harmonics(theta: np.ndarray, phi: np.ndarray, order: int) -> np.ndarray:
    """Real orthonormal spherical harmonics [directions, order²]."""
    columns = []
    for degree in range(order):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), theta, phi) * (np.sqrt(2.0) if m else 1.0)
            columns.append(value.imag if m < 0 else value.real)
    return np.stack(columns, axis=1)


def study(name: str, t: np.ndarray, y: np.ndarray, basis: int) -> None:
    """The two tables of one space of light."""
    rng = np.random.default_rng(0)
    t = t.astype(float)
    light = jnp.asarray(y, float)
    u = leading_basis(light, min(basis, t.shape[1]), rounding_floor(light, jnp.float32))[0]
    classical = np.asarray(u.T @ light)
    w, held_out = rng.normal(size=(2, t.shape[1], EXAMPLES))
    values = np.linalg.svd(t, compute_uv=False)
    print(f"\n{name}: T is {t.shape[0]} × {t.shape[1]}, singular values {values[0]:.3g} to {values[-1]:.3g},", end=" ")
    print(f"cond(T) = {values[0] / values[-1]:.2e}\n")
    lines, fits = [], {}
    for factor in RIDGES:
        line: list[object] = [f"{factor:g}"]
        for dtype in (jnp.float64, jnp.float32):
            fits[factor, dtype] = fit(t @ w, classical @ w, factor, dtype)
            from_w = fit(w, classical @ w, factor, dtype)
            transfers = fits[factor, dtype] @ t, from_w
            line.append(f"{np.linalg.norm(transfers[0] - classical, 2) / np.linalg.norm(classical, 2):.1e}")
            line += [f"{difference(transfer @ held_out, classical @ held_out):.1e}" for transfer in transfers]
        lines.append(line)
    parts = ("‖MT − P‖ / ‖P‖", "via x", "via w")
    table(("ridge", *(f"{bits}: {part}" for bits in ("float64", "float32") for part in parts)), lines)

    print()
    lines, truth = [], classical @ held_out
    x = t @ held_out
    for noise in NOISE:
        noisy = x + noise * rng.normal(size=x.shape) * np.sqrt(np.mean(x**2, axis=0))
        recovered = [inverse(t, dtype) @ noisy.astype(dtype) for dtype in (np.float64, np.float32)]
        answers = [(classical.astype(w.dtype) @ w) for w in recovered]
        answers[1:1] = [fits[factor, jnp.float64] @ noisy for factor in SHOWN]
        answers.append(fits[SHOWN[-1], jnp.float32].astype(np.float32) @ noisy.astype(np.float32))
        errors = [difference(recovered[0], held_out), *(difference(answer, truth) for answer in answers)]
        lines.append([f"{noise:g}", *(f"{error:.1e}" for error in errors)])
    ridges = [f"ridge {factor:g}" for factor in SHOWN]
    head = ("noise in x", "error of w = T⁺x", "P T⁺x", *ridges, "float32: P T⁺x", f"float32: {ridges[-1]}")
    table(head, lines)


def inverse(t: np.ndarray, dtype: type) -> np.ndarray:
    """T⁺ outright, with no singular value cut."""
    return np.linalg.pinv(t.astype(dtype), rcond=0.0)


def fit(x: np.ndarray, targets: np.ndarray, factor: float, dtype: type) -> np.ndarray:
    """The ridge regression of the linear methods, in `dtype` throughout."""
    columns = jnp.asarray(x, dtype)
    return np.asarray(ridge(columns, jnp.asarray(targets, dtype), relative_damping(columns, factor)), float)


def difference(found: np.ndarray, truth: np.ndarray) -> float:
    """Relative, in the Frobenius norm."""
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


if __name__ == "__main__":
    main()
