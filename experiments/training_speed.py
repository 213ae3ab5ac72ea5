"""Throughput of the training loop beside the same network and updates in other frameworks, in one run and by turns.

The network of `mlp-coefficients` at its default size, Adam with the same rate, the same batches of the same random light:
steps per second of `prt_bench.learned.training` (a scan over steps under one `jit`, guards and clipping included), of plain
optax with one jitted call per step, and of flax and PyTorch where they are installed. Compiling is not counted; rounds
alternate, and the median counts.

    python experiments/training_speed.py [--width 128] [--depth 2] [--batch 256] [--steps 100] [--rounds 5]
"""

import argparse
import importlib.util
import time
from collections.abc import Callable
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import optax

import prt_bench  # noqa: F401  float64 is on, as in a fit
from prt_bench.learned.light import Light
from prt_bench.learned.networks import Network, homogeneous
from prt_bench.learned.training import _chunk, _optimiser

EXAMPLES, MEASUREMENTS, FUNCTIONS, RATE = 3072, 256, 64, 2e-3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("width", 128), ("depth", 2), ("batch", 256), ("steps", 100), ("rounds", 5)):
        parser.add_argument(f"--{name}", type=int, default=default)
    settings = parser.parse_args()
    rng = np.random.default_rng(0)
    light = Light(
        jnp.asarray(rng.exponential(size=(EXAMPLES, MEASUREMENTS, 1)), jnp.float32),
        jnp.asarray(rng.normal(size=(EXAMPLES, FUNCTIONS, 3)), jnp.float32),
    )
    sizes = [MEASUREMENTS] + [settings.width] * settings.depth
    works: dict[str, Callable[[], object]] = {
        "prt_bench": scanned(sizes, light, settings),
        "optax, a call per step": called(sizes, light, settings),
    }
    for name, make in (("flax", in_flax), ("torch", in_torch)):
        if importlib.util.find_spec(name):
            works[name] = make(sizes, light, settings)
        else:
            print(f"{name} is not installed, and left out")
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for round_ in range(settings.rounds + 1):
        for name, work in works.items():
            started = time.perf_counter()
            work()
            if round_:
                seconds[name].append(time.perf_counter() - started)
    ours = float(np.median(seconds["prt_bench"]))
    print("| framework | steps per second | of ours |\n|---|---|---|")
    for name, taken in seconds.items():
        median = float(np.median(taken))
        print(f"| {name} | {settings.steps / median:.0f} | {ours / median:.2f} |")


def loss(weights, fixed, batch, key):
    """That of `mlp-coefficients`."""
    return jnp.mean((homogeneous(*weights, batch.x) - batch.targets) ** 2)


def weights_of(sizes):
    return Network.random(jax.random.key(0), sizes), jnp.zeros((3, FUNCTIONS, sizes[-1]), jnp.float32)


def scanned(sizes, light, settings):
    """One chunk of ours."""
    weights = weights_of(sizes)
    moments = _optimiser(RATE, 1).init(weights)
    plan = (RATE, 1, settings.steps, settings.batch)
    return lambda: jax.block_until_ready(_chunk(weights, moments, None, light, jax.random.key(1), loss, plan))


def called(sizes, light, settings):
    """The textbook loop: one jitted call per step, batches drawn on the host."""
    optimiser = optax.adam(RATE)
    start = weights_of(sizes)
    rows = np.random.default_rng(1).integers(0, EXAMPLES, (settings.steps, settings.batch))

    @jax.jit
    def step(weights, moments, which):
        slope = jax.grad(loss)(weights, None, jax.tree.map(lambda a: a[which], light), None)
        change, moments = optimiser.update(slope, moments)
        return optax.apply_updates(weights, change), moments

    def work():
        weights, moments = start, optimiser.init(start)
        for which in rows:
            weights, moments = step(weights, moments, which)
        return jax.block_until_ready(weights)

    return work


def in_flax(sizes, light, settings):
    """The same network as a linen module, with flax's own train state, one jitted call per step."""
    from flax import linen
    from flax.training.train_state import TrainState

    class Residual(linen.Module):
        @linen.compact
        def __call__(self, x):
            size = jnp.sqrt(jnp.mean(x**2, axis=1, keepdims=True))
            v = x / size
            for width in sizes[1:]:
                v = linen.Dense(width)(v)
                v = 0.5 * (v + jnp.sqrt(v * v + 1.0))
            return size * linen.Dense(3 * FUNCTIONS, use_bias=False)(v)

    x, targets = light.x[:, :, 0], light.targets.reshape(EXAMPLES, -1)
    model, optimiser = Residual(), optax.adam(RATE)
    apply = model.apply  # one object for all rounds, or `step` is compiled anew in each
    start = model.init(jax.random.key(0), x[:1])
    rows = np.random.default_rng(1).integers(0, EXAMPLES, (settings.steps, settings.batch))

    @jax.jit
    def step(state, which):
        slope = jax.grad(lambda p: jnp.mean((state.apply_fn(p, x[which]) - targets[which]) ** 2))(state.params)
        return state.apply_gradients(grads=slope)

    def work():
        state = TrainState.create(apply_fn=apply, params=start, tx=optimiser)
        for which in rows:
            state = step(state, which)
        return jax.block_until_ready(state.params)

    return work


def in_torch(sizes, light, settings):
    """The same network in PyTorch, on as many threads as it takes by itself."""
    import torch

    x = torch.from_numpy(np.asarray(light.x[:, :, 0]).copy())
    targets = torch.from_numpy(np.asarray(light.targets.reshape(EXAMPLES, -1)).copy())
    rows = torch.from_numpy(np.random.default_rng(1).integers(0, EXAMPLES, (settings.steps, settings.batch)))

    class Squareplus(torch.nn.Module):
        def forward(self, v):
            return 0.5 * (v + torch.sqrt(v * v + 1.0))

    layers = []
    for into, out in pairwise(sizes):
        layers += [torch.nn.Linear(into, out), Squareplus()]
    network = torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], 3 * FUNCTIONS, bias=False))

    def work():
        optimiser = torch.optim.Adam(network.parameters(), lr=RATE)
        for which in rows:
            batch = x[which]
            size = torch.sqrt(torch.mean(batch**2, dim=1, keepdim=True))
            optimiser.zero_grad()
            torch.mean((size * network(batch / size) - targets[which]) ** 2).backward()
            optimiser.step()

    return work


if __name__ == "__main__":
    main()
