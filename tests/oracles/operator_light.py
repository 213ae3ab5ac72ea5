"""What the traced operator says about any lightings and any number of bounces, and how far that is from an oracle."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from data_gen.direct import direct_irradiance
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.lights import Lighting, emitters
from prt_bench.transport import indirect


def operator_light(
    transport: Transport, lightings: list[Lighting], bounces: int | None = None
) -> tuple[Float[np.ndarray, "N T 3"], Float[np.ndarray, "N T 3"]]:
    """Direct and indirect irradiance at the receivers, which must be the gather samples; None is all bounces."""
    direct = direct_irradiance(Tracer(transport.scene), transport.receivers, emitters(lightings))
    albedo = jnp.asarray(transport.samples.albedo, jnp.float32)
    gathered = indirect(transport.sample_gather(), albedo, jnp.asarray(direct), bounces or transport.bounces)
    return direct, np.asarray(gathered, float)


def squared_error(
    estimate: Float[np.ndarray, "T 3"], first: Float[np.ndarray, "T 3"], second: Float[np.ndarray, "T 3"]
) -> tuple[float, float]:
    """Relative squared error against an oracle known only by two independent noisy halves, and its standard error.

    The halves' errors are independent with mean zero, so mean((x − A)(x − B)) is free of their noise, as is mean(A B).
    """
    products = np.mean((estimate - first) * (estimate - second), axis=1)
    signal = np.mean(first * second)
    return float(products.mean() / signal), float(products.std() / np.sqrt(len(products)) / signal)
