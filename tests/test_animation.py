"""One basis over keyframes and a transfer for each: against plain fits, and against regressions written out."""

from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.animation import common_basis, fit_keyframes, hat_blend
from prt_bench.clip import Clip
from prt_bench.errors import DatasetError, FitError, SpecError
from prt_bench.example import example_dataset
from prt_bench.methods.base import Method
from prt_bench.methods.examples import normalised
from prt_bench.models import ProjectionModel

BASIS, RIDGE = 6, 1e-3
PLAIN = prt.method("svd-ridge", basis=BASIS, ridge=RIDGE, mean=False, transfer="per-channel")


@dataclass(frozen=True)
class Oracle(Method):
    """A method whose model is not linear in what it measures."""

    name: ClassVar[str] = "oracle"
    basis: int = 2

    def fit(self, ds, key=None):
        return ProjectionModel(jnp.eye(ds.indirect.shape[1], 2))


@pytest.fixture(scope="module")
def ds() -> prt.LightingDataset:
    return example_dataset(lightings=36, measurements=16)


@pytest.fixture(scope="module")
def clip(ds) -> Clip:
    """Three keyframes whose lightings crowd in different parts of the room, so that their transfers differ."""
    order = np.argsort(ds.measured[:36, :, 0].sum(axis=1))
    arrays = {name: np.asarray(values)[order] for name, values in ds.arrays.items() if name != "indirect_half"}
    sorted_ds = replace(ds, arrays=arrays, all_lightings=tuple(ds.all_lightings[i] for i in order))
    return Clip(tuple(replace(sorted_ds, rows=(at, at + 12), splits={"train": (at, at + 12)}) for at in (0, 12, 24)))


@pytest.mark.parametrize(
    "method",
    [
        PLAIN,
        prt.method("svd-ridge", basis=BASIS, mean=False),
        prt.method("operator-ridge", basis=BASIS, ridge=3e-2, prior=0.5),
    ],
    ids=lambda method: method.label,
)
def test_one_keyframe_is_the_plain_fit(ds, method):
    train, test = ds.split("train"), ds.split("test")
    plain = np.asarray(method.fit(train).predict(test))
    assert np.allclose(fit_keyframes(method, Clip((train,))).keyframe(0).predict(test), plain, rtol=0, atol=1e-9)
    assert np.ptp(plain) > 0.1


def test_each_matrix_is_the_regression_of_its_keyframe_on_the_common_basis(clip):
    """W = C Xᵀ (X Xᵀ + λ I)⁻¹ per channel, by the normal equations, in float64."""
    model = fit_keyframes(PLAIN, clip)
    u = np.asarray(model.basis)
    for index, part in enumerate(clip):
        examples = normalised(part.measured, part.indirect)
        for channel in range(3):
            x, y = (np.asarray(light, np.float64)[:, channel::3] for light in (examples.x, examples.y))
            damping = RIDGE * np.sum(x**2) / len(x)
            expected = u.T @ y @ x.T @ np.linalg.inv(x @ x.T + damping * np.eye(len(x)))
            assert np.allclose(model.weights[index, channel, :, :-1], expected, rtol=0, atol=1e-8)
            assert np.all(np.asarray(model.weights[index, channel, :, -1]) == 0)
    gap = np.abs(np.asarray(model.weights[0] - model.weights[1])).max()
    assert gap > 1e-2


def test_the_basis_leads_the_light_of_all_keyframes(clip):
    u = np.asarray(common_basis(clip, BASIS))
    y = np.asarray(normalised(clip.measured, clip.indirect).y)
    assert np.allclose(u.T @ u, np.eye(BASIS), atol=1e-12)
    tail = np.sqrt(np.sum(np.linalg.svd(y, compute_uv=False)[BASIS:] ** 2))
    assert np.linalg.norm(y - u @ (u.T @ y)) == pytest.approx(tail, rel=1e-6)
    alone = np.asarray(common_basis(Clip((clip[0],)), BASIS))
    assert np.linalg.norm(y - alone @ (alone.T @ y)) > 1.05 * tail


def test_a_transfer_per_keyframe_fits_better_than_one_for_all(clip):
    own, one = fit_keyframes(PLAIN, clip), PLAIN.fit(clip)
    best = np.asarray(one.basis)
    for index, part in enumerate(clip):
        wanted = np.einsum("tb,ntc->nbc", best, part.indirect)
        errors = [
            np.linalg.norm(np.einsum("tb,ntc->nbc", best, np.asarray(model.predict(part))) - wanted)
            for model in (own.keyframe(index), one)
        ]
        assert errors[0] < 0.9 * errors[1]


def test_repeating_a_keyframe_changes_nothing(ds):
    train, test = ds.split("train"), ds.split("test")
    twice = Clip((train, train))
    plain = np.asarray(PLAIN.fit(train).predict(test))
    assert np.allclose(PLAIN.fit(twice).predict(test), plain, atol=1e-9)
    assert np.allclose(fit_keyframes(PLAIN, twice).keyframe(1).predict(test), plain, atol=1e-9)


def test_blends_mix_predictions(clip):
    model = fit_keyframes(PLAIN, clip)
    predictions = [np.asarray(model.keyframe(index).predict(clip)) for index in range(3)]
    assert np.array_equal(model.at([0, 1, 0]).predict(clip), predictions[1])
    mixed = 0.25 * predictions[0] + 0.75 * predictions[2]
    assert np.allclose(model.at([0.25, 0, 0.75]).predict(clip), mixed, atol=1e-9)
    with pytest.raises(FitError, match="2 blend weights were given for 3 keyframes"):
        model.at([0.5, 0.5])


def test_hats_interpolate_between_neighbours_and_across_the_end_of_the_period():
    times = np.array([0.1, 0.3, 0.7])
    for index, time in enumerate(times):
        assert np.allclose(hat_blend(time, times), np.eye(3)[index])
    assert np.allclose(hat_blend(0.4, times), [0, 0.75, 0.25])
    assert np.allclose(hat_blend(0.9, times), [0.5, 0, 0.5])
    assert np.allclose(hat_blend(1.9, times), [0.5, 0, 0.5])


def test_fits_are_deterministic(clip):
    first, second = fit_keyframes(PLAIN, clip), fit_keyframes(PLAIN, clip)
    assert np.array_equal(first.basis, second.basis)
    assert np.array_equal(first.weights, second.weights)


def test_a_clip_is_its_keyframes_one_after_another(ds, clip):
    assert len(clip) == 3
    assert np.array_equal(clip.measured[12:24], clip[1].measured)
    assert np.array_equal(clip.indirect[24:], clip[2].indirect)
    tests = Clip((ds, ds)).split("test")
    assert np.array_equal(tests.indirect_half[:18], ds.split("test").indirect_half)
    assert tests.noise_floor == pytest.approx(ds.split("test").noise_floor)


def test_what_is_refused(ds):
    with pytest.raises(DatasetError, match=r"keyframe 1 .* has other points"):
        Clip((ds, example_dataset(seed=1, lightings=36, measurements=16)))
    with pytest.raises(DatasetError, match="at least one keyframe"):
        Clip(())
    train = Clip((ds.split("train"),))
    with pytest.raises(SpecError, match="'mean' has no basis"):
        fit_keyframes(prt.method("mean"), train)
    with pytest.raises(SpecError, match="'oracle b2' does not fit a linear model"):
        fit_keyframes(Oracle(), train)
