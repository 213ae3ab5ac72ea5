"""Every method and every frame on a translucent scene."""

from pathlib import Path

import jax
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.dataset import LightingDataset
from prt_bench.methods import neural_transfer
from tests.data_gen.ball import BALL, LAMP, SMALL, room


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> LightingDataset:
    return prt.bake(room(), **SMALL, streamed=16, vertices=True, out=tmp_path_factory.mktemp("data"))


ORACLES = ("projection", "reference")
QUICK = {
    "mlp-coefficients": {"epochs": 2},
    "mlp-decoder": {"steps": 50},
    "linear-finetuned": {"epochs": 2},
    "neural-transfer": {"steps": 50},
}


@pytest.mark.parametrize("name", sorted(prt.methods()))
def test_every_method_runs_without_knowing(dataset: LightingDataset, name: str, tmp_path: Path) -> None:
    """Fit, predict, evaluate; and what is exported says the same."""
    model = prt.method(name, **QUICK.get(name, {})).fit(dataset.split("train"), jax.random.key(0))
    test = dataset.split("test")
    predicted = np.asarray(model.predict(test))
    assert predicted.shape == test.indirect.shape
    assert np.all(np.isfinite(predicted))
    error = prt.evaluate(model, test).errors.relative_rmse
    assert error is not None
    assert 0 <= error < np.inf
    if name not in ORACLES:
        again = np.asarray(prt.load_asset(model.export(tmp_path / "asset").path).predict(test))
        assert np.linalg.norm(again - predicted) <= 1e-3 * np.linalg.norm(predicted)


def test_a_network_is_taught_what_textures_hold(dataset: LightingDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """All light as receivers show it, not direct light at full."""
    taught = []

    def keep(position: object, normal: object, vectors: np.ndarray, *rest: object) -> None:
        taught.append(np.asarray(vectors))
        raise InterruptedError

    monkeypatch.setattr(neural_transfer, "fit_transfer", keep)
    train = dataset.split("train")
    with pytest.raises(InterruptedError):
        prt.method("neural-transfer").fit(train)
    np.testing.assert_array_equal(taught[0], prt.method("sh-texture").fit(train).arrays()["basis"])


def test_frames_show_light_times_colour(dataset: LightingDataset) -> None:
    """(ρ E_dir + κ y) / π on the ball, ρ (E_dir + y) / π elsewhere."""
    from prt_bench.errors import RuntimeUnavailable
    from prt_bench.runtime import Runtime

    try:
        runtime = Runtime(dataset, (64, 48))
    except RuntimeUnavailable as reason:
        pytest.skip(str(reason))
    assert dataset.transport.walks is not None
    even = runtime.lightmap(np.ones((len(dataset.points), 3), np.float32))
    frame = runtime.frame(LAMP, even, direct=False)
    colours = [dataset.transport.walks.colour[BALL], np.full(3, 0.6), np.array((0.7, 0.2, 0.1))]
    pixels = frame.reshape(-1, 3)
    distance = [np.abs(pixels - np.asarray(colour) / np.pi).max(axis=1) < 1e-5 for colour in colours]
    assert all(each.sum() > 20 for each in distance)
    assert np.all(np.any(distance, axis=0) | (pixels.max(axis=1) < 1e-6))
    assert runtime.frame(LAMP)[24, 30].max() == 0  # alone, direct light leaves the ball black
