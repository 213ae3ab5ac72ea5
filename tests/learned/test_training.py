"""The training loop: it finds what is known, survives bad updates, and depends on its arguments alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import FitError, SpecError
from prt_bench.learned import training
from prt_bench.learned.training import Schedule, train

RNG = np.random.default_rng(0)
X = jnp.asarray(RNG.normal(size=(200, 6)), jnp.float32)
TRUE = jnp.asarray(RNG.normal(size=(6, 3)), jnp.float32)
EXAMPLES, HELD = (X[:150], X[:150] @ TRUE), (X[150:], X[150:] @ TRUE)
SCHEDULE = Schedule(epochs=100, batch=32, rate=5e-2, chunks=10, patience=10)


def squares(weights, fixed, batch, key):
    return jnp.mean((batch[0] @ weights - batch[1]) ** 2)


def held_error(weights, fixed, held):
    return jnp.mean((held[0] @ weights - held[1]) ** 2)


def run(examples=EXAMPLES, loss=squares, schedule=SCHEDULE, seed=0, checkpoint=None):
    start = jnp.zeros((6, 3), jnp.float32)
    return train(start, None, examples, HELD, loss, held_error, schedule, jax.random.key(seed), "test", checkpoint)


def same(a, b):
    np.testing.assert_array_equal(a.weights, b.weights)
    assert a.history.keys() == b.history.keys()
    for name in a.history:
        np.testing.assert_array_equal(a.history[name], b.history[name])


def test_it_finds_the_map_that_made_the_targets():
    found = run()
    np.testing.assert_allclose(found.weights, TRUE, atol=2e-2)
    assert found.history["training_steps"][[0, -1]].tolist() == [0, 470]
    assert found.history["validation_error"][0] == pytest.approx(float(held_error(jnp.zeros((6, 3)), None, HELD)))
    assert found.history["training_loss"][-1] < 1e-2 * found.history["training_loss"][0]


def test_a_seed_gives_the_same_bits_and_another_seed_others():
    same(run(), run())
    assert not np.array_equal(run(seed=1).weights, run().weights)


def test_the_weights_kept_are_those_with_the_least_error_held_out():
    """Targets that are noise cannot be learned: what training began with is kept, and it stops early."""
    noise = jnp.asarray(RNG.normal(size=(150, 3)), jnp.float32)
    found = train(
        TRUE, None, (EXAMPLES[0], noise), HELD, squares, held_error, Schedule(100, 32, 5e-2, 10, 2), jax.random.key(0)
    )
    np.testing.assert_array_equal(found.weights, TRUE)
    assert len(found.history["training_steps"]) == 3


class Stopped(Exception):
    """What an interrupt raises in the test."""


@pytest.mark.parametrize("after", [1, 4])
def test_a_resumed_training_ends_with_the_bits_of_an_uninterrupted_one(after, tmp_path, monkeypatch):
    plain, kept, written = run(), training._keep, []

    def interrupted(*arguments):
        kept(*arguments)
        written.append(arguments)
        if len(written) == after:
            raise Stopped

    monkeypatch.setattr(training, "_keep", interrupted)
    with pytest.raises(Stopped):
        run(checkpoint=tmp_path / "state")
    monkeypatch.setattr(training, "_keep", kept)
    advanced, steps = training._advance, []
    monkeypatch.setattr(training, "_advance", lambda *a: steps.append(0) or advanced(*a))
    same(run(checkpoint=tmp_path / "state"), plain)
    assert len(steps) == SCHEDULE.chunks - after
    same(run(checkpoint=tmp_path / "state"), plain)
    assert len(steps) == SCHEDULE.chunks - after, "a finished training is not run again"


def test_a_checkpoint_of_another_training_is_not_taken_up(tmp_path):
    run(seed=3, checkpoint=tmp_path / "state")
    same(run(checkpoint=tmp_path / "state"), run())


def one_infinite(weights, fixed, batch, key):
    """A loss whose gradient is infinite for about one batch in eight."""
    bad = jax.random.uniform(key) < 0.125
    return squares(weights, fixed, batch, key) * jnp.where(bad, jnp.inf, 1.0)


def test_updates_that_are_not_finite_are_left_out():
    found = run(loss=one_infinite)
    assert found.skipped > 10
    np.testing.assert_allclose(found.weights, TRUE, atol=5e-2)


def never(weights, fixed, batch, key):
    return squares(weights, fixed, batch, key) * jnp.nan


def test_a_training_without_a_finite_update_is_refused():
    with pytest.raises(FitError, match="no update of the last"):
        run(loss=never)


def test_held_out_light_that_is_not_finite_is_refused():
    with pytest.raises(FitError, match="cannot begin"):
        train(TRUE, None, EXAMPLES, (HELD[0] * jnp.nan, HELD[1]), squares, held_error, SCHEDULE, jax.random.key(0))


@pytest.mark.parametrize("name", ["epochs", "batch", "rate", "chunks", "patience"])
def test_schedules_are_checked(name):
    with pytest.raises(SpecError, match=name):
        Schedule(**{name: 0})


def test_small_sets_take_few_steps():
    chunks, steps, batch = Schedule(epochs=3, batch=256, chunks=40).plan(50)
    assert (chunks * steps, batch) == (3, 50)
