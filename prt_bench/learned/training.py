"""One training loop for every learned model: Adam under one `jit`, a scan over steps, in chunks that can be told and kept.

What is trained, on what and for which loss is the caller's. Bits depend on the arguments alone: a training that was
interrupted and resumed ends where an uninterrupted one does.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from prt_bench.errors import FitError, SpecError
from prt_bench.progress import meter, say

Loss = Callable[[Any, Any, Any, jax.Array], Float[Array, ""]]
"""(weights, fixed, examples of a batch, key) → loss. A function of a module: compiled code is kept by its identity."""
Score = Callable[[Any, Any, Any], Float[Array, ""]]
"""(weights, fixed, held out) → error."""


CURVES = ("training_steps", "training_loss", "validation_error")
"""What is told of every chunk."""


_LEAST_STEPS = 10  # in a chunk: looking at what is held out costs as much as a few steps
_WARM_UP = 20  # one over the share of the steps in which the rate rises


@dataclass(frozen=True)
class Schedule:
    """`epochs` passes over the examples in batches of `batch`, at a `rate` that rises for a twentieth of the steps
    and falls along a cosine.

    After each of `chunks` equal parts the held-out lightings are looked at, and training stops when `patience` parts in a
    row have not lowered their error by a thousandth. Small sets of examples thus take few steps.
    """

    epochs: int = 200
    batch: int = 256
    rate: float = 2e-3
    chunks: int = 40
    patience: int = 6

    def __post_init__(self) -> None:
        for name in ("epochs", "batch", "rate", "chunks", "patience"):
            if not getattr(self, name) > 0:
                raise SpecError(f"{name} of a training schedule must be positive, not {getattr(self, name)}")

    @classmethod
    def lasting(cls, steps: int, examples: int, batch: int, rate: float, patience: int) -> Self:
        """Passes over so many `examples` that come to about `steps` batches, for what needs them however few there are."""
        return cls(max(1, -(-steps * min(batch, examples) // examples)), batch, rate, patience=patience)

    def plan(self, examples: int) -> tuple[int, int, int]:
        """Chunks, steps in each, and examples per batch, for a number of examples."""
        batch = min(self.batch, examples)
        steps = max(1, self.epochs * examples // batch)
        chunks = max(1, min(self.chunks, steps // _LEAST_STEPS))
        return chunks, -(-steps // chunks), batch


class Trained(NamedTuple):
    """The weights with the least error on what was held out, and how they came about.

    `history` holds a number per chunk: "training_steps" done, mean "training_loss", "validation_error"; the first is of the
    weights that training began with, where the loss is that of all examples. `skipped` counts the updates that were left out
    as not finite.
    """

    weights: Any
    history: dict[str, Float[np.ndarray, " k"]]
    skipped: int


class _State(NamedTuple):
    weights: Any
    moments: Any
    best: Any
    chunk: Array
    best_chunk: Array
    skipped: Array
    curves: Float[Array, "3 K"]  # steps, loss, held-out error


def train(
    weights: Any,
    fixed: Any,
    examples: Any,
    held: Any,
    loss: Loss,
    score: Score,
    schedule: Schedule,
    key: jax.Array,
    name: str = "training",
    checkpoint: Path | None = None,
) -> Trained:
    """Train `weights`, a pytree of float arrays, on `examples`, whose arrays have the example as their first axis.

    An update that is not finite is left out, so that one bad batch ruins nothing. `fixed` is passed on to `loss` and
    `score` and not trained. With a `checkpoint` the state is written there after every chunk, and a file that the same
    training left is taken up; an interrupt then costs one chunk at most. Raises `FitError` where the held-out error is not
    finite at the start, or no update of a whole chunk was. Not differentiable.
    """
    count = len(jax.tree.leaves(examples)[0])
    chunks, steps, batch = schedule.plan(count)
    first = float(_score(score, weights, fixed, held))
    if not np.isfinite(first):
        raise FitError(f"{name} cannot begin: the error on the lightings held out is {first}")
    begun = _first_loss(loss, weights, fixed, examples, key)
    curves = jnp.zeros((3, chunks + 1)).at[:, 0].set(jnp.array([0.0, begun, first]))
    zero = jnp.zeros((), jnp.int32)
    state = _State(weights, _optimiser(schedule.rate, 1).init(weights), weights, zero, zero, zero, curves)
    mark = _mark(state, fixed, examples, held, key, (loss, score, schedule)) if checkpoint else ""
    state = _resumed(checkpoint, mark, state) if checkpoint else state
    with meter(name, chunks) as tell:
        while (at := int(state.chunk)) < chunks and at - int(state.best_chunk) < schedule.patience:
            state = _advance(state, fixed, examples, held, key, (loss, score), (schedule.rate, chunks, steps, batch))
            told = np.asarray(state.curves[:, at + 1])
            if not np.isfinite(told[1]):
                raise FitError(f"{name}: no update of the last {steps} steps was finite; lower its rate")
            if checkpoint:
                _keep(checkpoint, mark, state)
            tell(at + 1, f"loss {told[1]:.3g}, held out {told[2]:.4g}")
    done = np.array(state.curves[:, : int(state.chunk) + 1], np.float64)
    if not np.isfinite(done[1, 0]):  # an example is not, and all were counted: the batches that were finite say more
        done[1, 0] = done[1, 1]
    history: dict[str, np.ndarray] = dict(zip(CURVES, done, strict=True))
    return Trained(state.best, history, int(state.skipped))


def _optimiser(rate: float, steps: int) -> optax.GradientTransformation:
    rates = optax.warmup_cosine_decay_schedule(0.05 * rate, rate, steps // _WARM_UP, max(steps, 2), 0.01 * rate)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rates))


@eqx.filter_jit
def _score(score: Score, weights: Any, fixed: Any, held: Any) -> Float[Array, ""]:
    return score(weights, fixed, held)


@eqx.filter_jit
def _first_loss(loss: Loss, weights: Any, fixed: Any, examples: Any, key: jax.Array) -> Float[Array, ""]:
    return loss(weights, fixed, examples, key)


def _advance(
    state: _State, fixed: Any, examples: Any, held: Any, key: jax.Array, functions: tuple[Loss, Score],
    plan: tuple[float, int, int, int],
) -> _State:  # fmt: skip
    """One chunk, and what it did to the error on the lightings held out."""
    loss, score = functions
    _, _, steps, _ = plan
    at = int(state.chunk)
    key = jax.random.fold_in(key, at)
    weights, moments, mean, skipped = _chunk(state.weights, state.moments, fixed, examples, key, loss, plan)
    error = _score(score, weights, fixed, held)
    least = float(state.curves[2, int(state.best_chunk)])
    better = float(error) < least * (1.0 - 1e-3)
    told = jnp.array([(at + 1.0) * steps, mean, error])
    return _State(
        weights,
        moments,
        weights if better else state.best,
        state.chunk + 1,
        state.chunk + 1 if better else state.best_chunk,
        state.skipped + skipped,
        state.curves.at[:, at + 1].set(told),
    )


@eqx.filter_jit
def _chunk(
    weights: Any, moments: Any, fixed: Any, examples: Any, key: jax.Array, loss: Loss, plan: tuple[float, int, int, int]
) -> tuple[Any, Any, Array, Array]:
    """`steps` updates: the weights, Adam's moments, the mean loss of the finite ones (NaN where none was), those skipped."""
    rate, chunks, steps, batch = plan
    optimiser = _optimiser(rate, chunks * steps)
    count = len(jax.tree.leaves(examples)[0])

    def step(carry: tuple[Any, Any], key: jax.Array) -> tuple[tuple[Any, Any], Array]:
        weights, moments = carry
        which, rest = jax.random.split(key)
        rows = jnp.arange(count) if batch == count else jax.random.randint(which, (batch,), 0, count)
        chosen = jax.tree.map(lambda array: array[rows], examples)
        value, slope = jax.value_and_grad(loss)(weights, fixed, chosen, rest)
        change, moved = optimiser.update(slope, moments, weights)
        sound = finite((value, slope))
        new = optax.apply_updates(weights, change), moved
        return keep(sound, new, carry), jnp.where(sound, value, jnp.nan)

    (weights, moments), values = jax.lax.scan(step, (weights, moments), jax.random.split(key, steps))
    return weights, moments, jnp.nanmean(values), jnp.sum(jnp.isnan(values), dtype=jnp.int32)


def finite(tree: Any) -> Array:
    """Whether every number of a pytree is finite."""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(tree)]))


def keep(sound: Array, new: Any, old: Any) -> Any:
    """The new state where the update was sound, else the old one with all it remembers: Adam never forgets a NaN."""
    return jax.tree.map(lambda a, b: jnp.where(sound, a, b), new, old)


def _mark(state: _State, fixed: Any, examples: Any, held: Any, key: jax.Array, rest: tuple) -> str:
    """What a checkpoint must have been written for: the first state, the data, the seed and the schedule."""
    digest = hashlib.sha256(repr((rest[0].__qualname__, rest[1].__qualname__, rest[2])).encode())
    for leaf in jax.tree.leaves((state.weights, fixed, examples, held, jax.random.key_data(key))):
        digest.update(repr((np.shape(leaf), np.asarray(leaf).dtype)).encode() + np.asarray(leaf).tobytes())
    return digest.hexdigest()


def _keep(path: Path, mark: str, state: _State) -> None:
    """Write mark and state in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        file.write(mark.encode())
        eqx.tree_serialise_leaves(file, state)
    partial.replace(path)


def _resumed(path: Path, mark: str, state: _State) -> _State:
    """The state kept at `path`, where the same training left it, else the first one."""
    if not path.is_file():
        return state
    with path.open("rb") as file:
        if file.read(len(mark)) != mark.encode():
            say(f"{path} is the checkpoint of another training, and is begun anew")
            return state
        return eqx.tree_deserialise_leaves(file, state)
