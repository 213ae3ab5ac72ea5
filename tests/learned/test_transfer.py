"""Fields of transfer vectors: what is known needs no learning, what is learned is learned, and what ships comes back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import FitError
from prt_bench.learned.fields import Field, box_of
from prt_bench.learned.transfer import FieldShape, TransferField, fit_transfer, open_vectors, relative_error
from prt_bench.spherical import evaluate, quadrature

RNG = np.random.default_rng(0)
NORMAL = RNG.normal(size=(512, 3))
NORMAL /= np.linalg.norm(NORMAL, axis=1, keepdims=True)
POSITION = 0.5 * NORMAL + [1.0, 2.0, 3.0]
OPEN = np.asarray(open_vectors(NORMAL, 3))[:, None]
SMALL = FieldShape(16, 1, "none", 60)


def test_open_vectors_are_integrals_over_the_hemisphere():
    """Against a quadrature of max(n·ω, 0) y_k, whose kink it resolves to a few parts in ten thousand."""
    direction, weight = quadrature(200)
    cosine = np.maximum(NORMAL[:5] @ direction.T, 0.0)
    wanted = np.einsum("pq,q,qk->pk", cosine, weight, np.asarray(evaluate(direction, 5)))
    np.testing.assert_allclose(open_vectors(NORMAL[:5], 5), wanted, atol=1e-3)


def test_an_open_body_is_known_without_training():
    found, _ = fit_transfer(POSITION, NORMAL, OPEN, SMALL)
    values = found(jnp.asarray(POSITION, jnp.float32), jnp.asarray(NORMAL, jnp.float32))
    assert relative_error(values, OPEN) < 1e-5
    assert found.order == 3


@pytest.fixture(scope="module")
def hidden():
    """Bands of the ball lie in shade, and what three channels reflect differs."""
    share = 1.0 / (1.0 + np.exp(-6.0 * np.sin(3.0 * NORMAL[:, :1, None] + 2.0 * NORMAL[:, 1:2, None])))
    return OPEN * share * np.array([1.0, 0.7, 0.4])[:, None]


def test_training_lowers_the_error_and_is_the_same_twice(hidden):
    shape = FieldShape(8, 1, "none", 300, 3e-3)
    fits = [fit_transfer(POSITION, NORMAL, hidden, shape, jax.random.key(3)) for _ in range(2)]
    found, curves = fits[0]
    values = found(jnp.asarray(POSITION, jnp.float32), jnp.asarray(NORMAL, jnp.float32))
    assert relative_error(values, hidden) < 0.5 * relative_error(OPEN, hidden)
    assert curves["validation_error"].min() < 0.9 * curves["validation_error"][0]
    for a, b in zip(found.arrays().values(), fits[1][0].arrays().values(), strict=True):
        assert np.array_equal(a, b)


def test_what_ships_is_the_same_field():
    first, second = jax.random.split(jax.random.key(0))
    field = Field.random(first, "grid", box_of(jnp.asarray(POSITION, jnp.float32)), 16, 1, 27)
    found = TransferField(
        Field(field.network, jax.random.normal(second, field.head.shape, jnp.float32), field.box, field.grids), 3
    )
    loaded = TransferField.from_arrays({name: jnp.asarray(array) for name, array in found.arrays().items()})
    place = jnp.asarray(POSITION, jnp.float32), jnp.asarray(NORMAL, jnp.float32)
    assert np.array_equal(loaded(*place), found(*place))
    assert loaded.rows == 3
    assert found.bytes == sum(array.nbytes for array in found.arrays().values())


def test_points_that_cannot_be_fitted_are_refused(hidden):
    with pytest.raises(FitError, match="at least 16"):
        fit_transfer(POSITION[:8], NORMAL[:8], hidden[:8], SMALL)
    with pytest.raises(FitError, match="finite"):
        fit_transfer(POSITION, NORMAL, np.where(hidden > 0.5, np.nan, hidden), SMALL)
