"""The closed-form baseline on synthetic light, where the right answer is known."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.contract import CHECKS, example_dataset
from prt_bench.errors import FitError
from prt_bench.metrics import relative_rmse

RECEIVERS, POINTS = 60, 20


def synthetic(lightings=200, rank=12, offset=3.0, seed=0, channels=1):
    """Light with a strong mean and `rank` directions; indirect light is a fixed matrix times measured light."""
    system = np.random.default_rng(99)
    directions, transport = system.normal(size=(POINTS, rank)), system.uniform(0, 1, (RECEIVERS, POINTS))
    rng = np.random.default_rng(seed)
    latent = rng.normal(size=(lightings, rank, channels)) * np.geomspace(1, 0.05, rank)[:, None]
    measured = offset + np.einsum("mr,nrc->nmc", directions, latent)
    return SimpleNamespace(measured=measured, indirect=np.einsum("tm,nmc->ntc", transport, measured))


def scaled(ds, factors):
    factors = np.asarray(factors)[:, None, None]
    return SimpleNamespace(measured=ds.measured * factors, indirect=ds.indirect * factors)


TRAIN, TEST = synthetic(), synthetic(seed=1)


def error(model, test=TEST):
    return relative_rmse(np.asarray(model.predict(test)), test.indirect)


def floor(model, mean):
    """Best the basis could do, the mean being tied to ‖x‖ as the method has it."""
    centre = 0.0
    if mean:
        centre = model.basis[:, :1] * model.weights[0, 0, -1] * np.linalg.norm(TEST.measured, axis=1, keepdims=True)
    u = model.basis[:, int(mean) :]
    residual = TEST.indirect - centre
    return relative_rmse(np.asarray(centre + np.einsum("tb,sb,nsc->ntc", u, u, residual, optimize=True)), TEST.indirect)


@pytest.mark.parametrize("mean", [True, False])
@pytest.mark.parametrize("basis", [4, 8, 12])
def test_error_is_close_to_the_projection(basis, mean):
    """A8/A9: normalising or centring one side alone leaves errors of tens of percent where the basis allows far less."""
    model = prt.method("svd-ridge", basis=basis, ridge=1e-8, mean=mean).fit(TRAIN)
    assert floor(model, mean) * (1 - 1e-9) <= error(model) <= 1.05 * floor(model, mean) + 1e-6


def test_a_full_basis_recovers_linear_transport():
    assert error(prt.method("svd-ridge", basis=14, ridge=1e-12).fit(TRAIN)) < 1e-5


def test_the_mean_counts_as_a_basis_function():
    model = prt.method("svd-ridge", basis=16).fit(synthetic(rank=18))
    assert model.basis.shape == (RECEIVERS, 16)
    np.testing.assert_allclose(jnp.linalg.norm(model.basis, axis=0), 1.0, rtol=1e-12)


def test_a_basis_of_one_is_the_mean_method():
    np.testing.assert_allclose(
        prt.method("svd-ridge", basis=1).fit(TRAIN).predict(TEST),
        prt.method("mean").fit(TRAIN).predict(TEST),
        rtol=1e-12,
    )


def test_only_the_mean_breaks_superposition():
    """The mean scaled by the norm is homogeneous, not additive; without it the model is linear."""
    for mean, additive in ((True, False), (False, True)):
        model = prt.method("svd-ridge", basis=6, mean=mean).fit(TRAIN)
        x = jnp.asarray(TEST.measured)
        together = model.transfer(x[:1] + x[1:2])
        apart = model.transfer(x[:1]) + model.transfer(x[1:2])
        assert bool(jnp.allclose(together, apart, rtol=1e-10)) is additive


def test_the_unit_of_light_does_not_matter():
    """A5 through the whole fit."""
    plain = prt.method("svd-ridge", basis=12).fit(TRAIN).predict(TEST)
    for factor in (1e-3, 1e6):
        np.testing.assert_allclose(
            prt.method("svd-ridge", basis=12).fit(scaled(TRAIN, [factor])).predict(TEST), plain, rtol=1e-9
        )


def test_every_intensity_weighs_the_same():
    """A7: twelve decades of intensity in one dataset; no lighting is lost beside the brightest."""
    factors = np.geomspace(1e-6, 1e6, 200)
    model = prt.method("svd-ridge", basis=14, ridge=1e-10).fit(scaled(TRAIN, factors))
    test = scaled(TEST, factors)
    found = np.asarray(model.predict(test))
    worst = np.max(np.linalg.norm(found - test.indirect, axis=(1, 2)) / np.linalg.norm(test.indirect, axis=(1, 2)))
    assert worst < 1e-4


def test_black_lightings_change_nothing():
    """A6: dropped from the fit, and predicted as black."""
    dark = np.zeros((2, POINTS, 1))
    with_black = SimpleNamespace(
        measured=np.concatenate([dark, TRAIN.measured]),
        indirect=np.concatenate([np.zeros((2, RECEIVERS, 1)), TRAIN.indirect]),
    )
    model = prt.method("svd-ridge", basis=12).fit(with_black)
    np.testing.assert_allclose(
        model.predict(TEST), prt.method("svd-ridge", basis=12).fit(TRAIN).predict(TEST), rtol=1e-9
    )
    np.testing.assert_array_equal(model.transfer(jnp.asarray(dark)), 0.0)


def test_a_lighting_that_misses_the_measurement_points_does_not_rule_the_fit():
    """Seen with spots: over ‖x‖ its indirect light has a thousand times the weight of any other lighting's."""
    missed = SimpleNamespace(measured=TRAIN.measured.copy(), indirect=TRAIN.indirect.copy())
    missed.measured[0] = 1e-3 * np.abs(TRAIN.measured[0]) * (np.arange(POINTS) == 3)[:, None]
    sound, plain, paper = (
        error(prt.method("svd-ridge", basis=12, mean=False, normalise=by).fit(light))
        for by, light in (("indirect", missed), ("indirect", TRAIN), ("measured", missed))
    )
    assert sound < 2 * plain < 0.1 < paper


@pytest.mark.parametrize("transfer", ["shared", "per-channel"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.float16])
def test_constant_light_is_not_blown_up(transfer, dtype):
    """B3: one light under many colours; a ridge relative to what centring leaves of it divides by rounding."""
    rng = np.random.default_rng(0)
    seen, colour = TRAIN.measured[:1], rng.uniform(0.2, 1.0, (24, 1, 3))
    bounced = TRAIN.indirect[:1] * np.array([1.0, 0.8, 0.5])
    train = SimpleNamespace(measured=(seen * colour).astype(dtype), indirect=(bounced * colour).astype(dtype))
    test = SimpleNamespace(measured=np.repeat(TEST.measured, 3, axis=2), indirect=np.repeat(TEST.indirect, 3, axis=2))
    model = prt.method("svd-ridge", basis=6, transfer=transfer)
    with pytest.warns(UserWarning, match="basis functions are zero" if dtype == np.float64 else ""):
        found = np.abs(np.asarray(model.fit(train).predict(test)))
    assert found.max() < 4 * np.abs(test.indirect).max()


def test_every_channel_has_a_mean_of_its_own():
    """Constant light of three channels that bounce differently is predicted exactly by means alone, whatever the ridge."""
    colours = np.random.default_rng(0).uniform(0.2, 1.0, (24, 1, 3))
    shapes = np.abs(np.random.default_rng(1).normal(size=(1, RECEIVERS, 3)))
    light = SimpleNamespace(measured=np.abs(TRAIN.measured[:1]) * colours, indirect=shapes * colours)
    with pytest.warns(UserWarning, match="rank"):
        model = prt.method("svd-ridge", basis=4, transfer="per-channel", ridge=100.0).fit(light)
    np.testing.assert_allclose(model.predict(light), light.indirect, rtol=1e-9)


def test_only_black_lightings_are_refused():
    dark = SimpleNamespace(measured=np.zeros((3, POINTS, 1)), indirect=np.zeros((3, RECEIVERS, 1)))
    with pytest.raises(FitError, match="no training lighting"):
        prt.method("svd-ridge").fit(dark)


@pytest.mark.parametrize("field", ["measured", "indirect"])
def test_nan_is_refused(field):
    damaged = SimpleNamespace(measured=TRAIN.measured.copy(), indirect=TRAIN.indirect.copy())
    getattr(damaged, field)[5, 3, 0] = np.nan
    with pytest.raises(FitError, match=f"{field} light has values that are not finite"):
        prt.method("svd-ridge").fit(damaged)


def test_asking_for_more_than_the_rank_warns_and_does_no_harm():
    """B2."""
    with pytest.warns(UserWarning, match="rank 13; 7 basis functions are zero"):
        wide = prt.method("svd-ridge", basis=20, ridge=1e-12, mean=False).fit(synthetic(rank=12))
    assert error(wide) < 1e-5


def test_a_cut_through_equal_singular_values_warns():
    """B5: a rig of two mirrored halves; which of a pair comes first is rounding."""
    rng = np.random.default_rng(0)
    half_x, half_y = rng.uniform(size=(8, 10, 1)), rng.uniform(size=(8, 30, 1))
    mirrored = SimpleNamespace(
        measured=np.concatenate([np.pad(half_x, ((0, 0), (0, 10), (0, 0))), np.pad(half_x, ((0, 0), (10, 0), (0, 0)))]),
        indirect=np.concatenate([np.pad(half_y, ((0, 0), (0, 30), (0, 0))), np.pad(half_y, ((0, 0), (30, 0), (0, 0)))]),
    )
    with pytest.warns(UserWarning, match="singular values 3 and 4 are equal"):
        prt.method("svd-ridge", basis=3, mean=False).fit(mirrored)


def test_white_lights_teach_coloured_ones():
    """H3: channels are examples of one map, so a red light at test is no surprise."""
    white = SimpleNamespace(
        measured=np.repeat(TRAIN.measured, 3, axis=2), indirect=np.repeat(TRAIN.indirect, 3, axis=2)
    )
    red = np.array([1.0, 0.0, 0.0])
    coloured = SimpleNamespace(measured=TEST.measured * red, indirect=TEST.indirect * red)
    assert error(prt.method("svd-ridge", basis=14, ridge=1e-10).fit(white), coloured) < 1e-5


def test_a_matrix_per_channel_learns_what_a_shared_one_cannot():
    """Each channel with a transport of its own, in a common span."""
    train, test = synthetic(channels=3), synthetic(channels=3, seed=1)
    mixing = np.random.default_rng(4).normal(size=(3, POINTS, POINTS))

    def chromatic(ds):
        light = np.einsum("cij,njc->nic", mixing, ds.measured)
        return SimpleNamespace(
            measured=ds.measured, indirect=np.einsum("ti,nic->ntc", np.eye(RECEIVERS, POINTS), light)
        )

    errors = {
        transfer: error(
            prt.method("svd-ridge", basis=20, mean=False, transfer=transfer, ridge=1e-10).fit(chromatic(train)),
            chromatic(test),
        )
        for transfer in ("shared", "per-channel")
    }
    assert errors["per-channel"] < 1e-4 < 0.1 < errors["shared"]


def test_colours_unseen_in_training():
    """H3, Fig. 5 of the paper: taught by white lights, channels as examples survive coloured ones, coupled ones do not."""
    ds = example_dataset(lightings=64, measurements=48)
    lit, test = ds.split("train"), ds.split("test")
    colour, held_out = (np.array([lighting.lights[0].intensity for lighting in part.lightings]) for part in (lit, test))
    seen = colour.any(axis=1)
    white = SimpleNamespace(
        measured=lit.measured[seen] / colour[seen, None], indirect=lit.indirect[seen] / colour[seen, None]
    )
    colours = {"white": 1.0 / held_out[:, None], "red": np.array([1.0, 0.1, 0.1]) / held_out[:, None]}
    models = {
        transfer: prt.method("svd-ridge", basis=16, mean=False, transfer=transfer).fit(white)
        for transfer in ("shared", "per-channel", "coupled")
    }
    errors = {
        (transfer, name): error(
            model, SimpleNamespace(measured=test.measured * factor, indirect=test.indirect * factor)
        )
        for transfer, model in models.items()
        for name, factor in colours.items()
    }
    assert errors["coupled", "white"] < errors["shared", "white"] < 0.3
    for transfer in ("shared", "per-channel"):
        assert errors[transfer, "red"] < 1.2 * errors[transfer, "white"]
    assert errors["coupled", "red"] > 2.5 * errors["coupled", "white"]


def test_coupled_channels_learn_that_channels_mix():
    """What each channel receives may depend on all three, which no other form can say: fluorescence, for one."""
    train, test = synthetic(channels=3), synthetic(channels=3, seed=1)
    mixing = np.random.default_rng(4).normal(size=(3, 3))

    def mixed(ds):
        return SimpleNamespace(measured=ds.measured, indirect=np.einsum("cd,ntd->ntc", mixing, ds.indirect))

    errors = {
        transfer: error(
            prt.method(
                "svd-ridge", basis=13 if transfer == "per-channel" else 37, mean=False, transfer=transfer, ridge=1e-10
            ).fit(mixed(train)),
            mixed(test),
        )
        for transfer in ("per-channel", "coupled")
    }
    assert errors["coupled"] < 1e-4 < 0.05 < errors["per-channel"]


def test_the_error_of_coupled_channels_splits_at_its_own_projection():
    ds = example_dataset()
    model = prt.method("svd-ridge", basis=8, mean=False, transfer="coupled").fit(ds.split("train"))
    found = prt.evaluate(model, ds.split("test")).errors
    assert 0.01 < found.projection < found.relative_rmse
    assert found.projection**2 + found.coefficient**2 == pytest.approx(found.relative_rmse**2, rel=1e-4)


def test_one_channel_coupled_is_the_plain_form():
    coupled = prt.method("svd-ridge", basis=8, transfer="coupled").fit(TRAIN)
    np.testing.assert_array_equal(coupled.predict(TEST), prt.method("svd-ridge", basis=8).fit(TRAIN).predict(TEST))


@pytest.mark.parametrize("holds", ["shapes", "one channel", "ships", "fit gradient"])
def test_contract_of_coupled_channels(holds):
    CHECKS[holds](prt.method("svd-ridge", basis=8, transfer="coupled"), example_dataset())


@pytest.mark.parametrize("case", ["plain", "duplicates", "black", "symmetric"])
def test_gradient_of_the_fit_matches_differences(case):
    """Measured and indirect light of the training split, through basis, mean and ridge, to held-out predictions."""
    rng = np.random.default_rng(0)
    measured, indirect = rng.uniform(0.2, 1, (9, 6, 2)), rng.uniform(0.2, 1, (9, 11, 2))
    if case == "duplicates":
        measured[1], indirect[1], measured[:, 2] = measured[0], indirect[0], measured[:, 3]
    if case == "black":
        measured[4] = indirect[4] = 0.0
    if case == "symmetric":
        measured[3:6], indirect[3:6] = measured[:3, ::-1], indirect[:3, ::-1]
        measured[6:], indirect[6:] = measured[:3], indirect[:3]
    x = jnp.asarray(rng.uniform(0.2, 1, (4, 6, 2)))
    weight = rng.normal(size=(4, 11, 2))
    method = prt.method("svd-ridge", basis=4, ridge=0.05)

    @jax.jit
    def loss(measured, indirect):
        model = method.fit(SimpleNamespace(measured=measured, indirect=indirect))
        return jnp.sum(weight * model.reconstruct(model.transfer(x)))

    slopes = jax.jit(jax.grad(loss, argnums=(0, 1)))(measured, indirect)
    lit = np.any(measured, axis=1, keepdims=True)  # a black lighting stays black: the map has a kink there
    steps = [rng.normal(size=measured.shape) * lit, rng.normal(size=indirect.shape) * lit]
    ahead, behind = (loss(measured + e * steps[0], indirect + e * steps[1]) for e in (1e-6, -1e-6))
    slope = sum(float(jnp.vdot(s, step)) for s, step in zip(slopes, steps, strict=True))
    assert all(bool(jnp.all(jnp.isfinite(s))) for s in slopes)
    assert slope == pytest.approx(float(ahead - behind) / 2e-6, rel=1e-5, abs=1e-6)
