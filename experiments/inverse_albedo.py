"""Inverse albedo: what colour the walls are, from light observed on them under known lamps.

Observed is the indirect light of a few lightings at points of the scene, as the independent path tracer of
`data_gen/reference.py` renders it: it shares no rays with the operator and brings noise of its own. Adam moves one albedo per
material down the gradient of the relative squared error through albedo → operator → all bounces → indirect light, from the
same grey for all. `one bounce` solves the linear problem that is left when light is taken to bounce once: what the further
bounces are worth. Where all bounces are simulated the answer is limited by noise, and by rays and samples of the operator.

    python experiments/inverse_albedo.py [--scene cornell] [--lights 4] [--points 1000] [--paths 64 1024] [--data FOLDER]
"""

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from _descent import descend
from _frames import arguments, bake, table

from data_gen.direct import direct_irradiance
from data_gen.reference import indirect_irradiance
from data_gen.tracer import Tracer
from prt_bench.lights import emitters
from prt_bench.transport import final_gather, radiosity

COLUMNS = ("paths", "noise", "by", "largest error of an albedo", "root mean square", "seconds")
START = 0.5


def main() -> None:
    parser = arguments(__doc__, None, scene="cornell", lights=4, points=1000, paths=[64, 1024], steps=80)
    settings = parser.parse_args()
    ds = bake(settings.scene, "point", settings.data, streamed=2048)
    tracer, transport = Tracer(ds.scene), ds.transport
    lightings = ds.split("test").lightings[: settings.lights]
    lit = np.flatnonzero(~transport.buried)
    rows = np.sort(np.random.default_rng(0).choice(lit, min(settings.points, len(lit)), replace=False))
    at = transport.receivers[rows]
    direct = jnp.asarray(direct_irradiance(tracer, transport.samples, emitters(lightings)), float)
    gather = transport.sample_gather(differentiable=True)
    final = type(gather).from_hits(np.asarray(transport.receiver_hits[:])[rows], len(transport.samples), True)
    material = np.asarray(ds.scene.mesh.material)[transport.samples.face]
    true = np.array([each.albedo for each in ds.scene.materials], float)

    def simulate(albedo: jax.Array, bounces: int) -> jax.Array:
        return final_gather(final, radiosity(gather, albedo[material], direct, bounces - 1))

    lines = []
    for paths in settings.paths:
        seen = [
            indirect_irradiance(ds.scene, at.position, at.normal, each, paths, seed=index)
            for index, each in enumerate(lightings)
        ]
        wanted = jnp.asarray(np.stack([each.mean for each in seen]))
        size = jnp.sqrt(jnp.mean(wanted**2, axis=(1, 2), keepdims=True))
        noise = float(np.sqrt(np.mean(np.stack([each.standard_error for each in seen]) ** 2 / np.asarray(size) ** 2)))

        def misfit(free: jax.Array, _: None, wanted: jax.Array = wanted, size: jax.Array = size) -> jax.Array:
            found = simulate(jax.nn.sigmoid(free), transport.bounces)
            return jnp.mean(((found - wanted) / size) ** 2)

        ways = {
            "gradient, all bounces": lambda misfit=misfit: jax.nn.sigmoid(
                descend(misfit, np.full(true.shape, np.log(START / (1 - START))), settings.steps, 0.2)
            ),
            "one bounce, linear": lambda wanted=wanted, size=size: one_bounce(simulate, wanted / size, size, len(true)),
        }
        for way, solve in ways.items():
            started = time.perf_counter()
            found = np.asarray(solve())
            seconds = time.perf_counter() - started
            off = np.abs(found - true)
            lines.append([str(paths), f"{noise:.1%}", way, f"{off.max():.4f}", f"{np.sqrt(np.mean(off**2)):.4f}",
                          f"{seconds:.0f}"])  # fmt: skip
            for name, a, b in zip([each.name for each in ds.scene.materials], found, true, strict=True):
                print(f"{paths} paths, {way}: {name} {np.round(a, 4)} (true {np.round(b, 4)})")
    print()
    table(COLUMNS, lines)


def one_bounce(
    simulate: Callable[[jax.Array, int], jax.Array], wanted: jax.Array, size: jax.Array, materials: int
) -> jax.Array:
    """Least squares for the albedos [materials, 3] of light that bounces once: E = Σ ρ_m E_m, each channel on its own."""
    alone = [jnp.zeros((materials, 3)).at[each].set(1.0) for each in range(materials)]
    columns = jnp.stack([simulate(albedo, 1) / size for albedo in alone], axis=-1)
    return jnp.stack(
        [
            jnp.linalg.lstsq(columns[:, :, c].reshape(-1, materials), wanted[:, :, c].ravel())[0]
            for c in range(wanted.shape[2])
        ],
        axis=1,
    )


if __name__ == "__main__":
    main()
