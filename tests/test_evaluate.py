"""Where an error comes from: the parts of a record add up, on the cube room."""

import sys
from dataclasses import asdict, replace

import numpy as np
import pytest

import prt_bench as prt
from prt_bench.errors import DatasetError
from prt_bench.example import example_dataset

DATASET = example_dataset()
TRAIN, TEST = DATASET.split("train"), DATASET.split("test")


@pytest.mark.parametrize("storage", ["float32", "float16"])
@pytest.mark.parametrize("name", ["svd-ridge", "operator-ridge", "mean"])
def test_squares_of_projection_and_coefficient_add_up(tmp_path, name, storage):
    model = prt.method(name).fit(TRAIN)
    errors = prt.evaluate(model, TEST, model.export(tmp_path / "asset", storage)).errors
    assert errors.relative_rmse**2 == pytest.approx(errors.projection**2 + errors.coefficient**2, rel=1e-5)
    assert errors.projection <= errors.relative_rmse


def test_figures_are_those_of_the_asset(tmp_path):
    model = prt.method("svd-ridge").fit(TRAIN)
    coarse = prt.evaluate(model, TEST, model.export(tmp_path / "asset", "float16")).errors
    fine = prt.evaluate(model, TEST).errors
    assert 1e-5 < coarse.storage < 1e-2
    assert fine.storage < 1e-5
    full = np.asarray(model.predict(TEST))
    relative = np.linalg.norm(full - TEST.indirect, axis=(1, 2)) / np.linalg.norm(TEST.indirect, axis=(1, 2))
    assert fine.relative_rmse == pytest.approx(np.sqrt(np.mean(relative**2)), rel=1e-5)


def test_an_asset_alone_is_enough(tmp_path):
    model = prt.method("svd-ridge").fit(TRAIN)
    asset = model.export(tmp_path / "asset")
    assert replace(prt.evaluate(model, TEST, asset).errors, storage=None) == prt.evaluate(asset, TEST).errors


def test_reference_error_is_the_noise_floor():
    """Half the rays against all of them: by construction the split-half standard error."""
    record = prt.evaluate(prt.method("reference").fit(TRAIN), TEST)
    assert record.errors.relative_rmse == pytest.approx(record.errors.noise_floor, rel=0.02)
    assert record.status == "oracle"


def test_projection_row_is_the_projection_figure_of_svd_ridge():
    oracle = prt.evaluate(prt.method("projection", basis=8).fit(TRAIN), TEST).errors
    fitted = prt.evaluate(prt.method("svd-ridge", basis=8).fit(TRAIN), TEST).errors
    assert oracle.relative_rmse == pytest.approx(fitted.projection, rel=1e-5)
    assert oracle.coefficient == pytest.approx(0.0, abs=1e-12)


def test_missing_rank_does_not_flatter_the_projection():
    """Zero columns of the basis span nothing; an ordinary QR would complete them with arbitrary directions."""
    model = prt.method("svd-ridge", basis=4).fit(TRAIN)
    padded = type(model)(np.pad(model.basis, ((0, 0), (0, 60))), np.pad(model.weights, ((0, 0), (0, 60), (0, 0))))
    plain, wide = (prt.evaluate(each, TEST).errors.projection for each in (model, padded))
    assert wide == pytest.approx(plain, rel=1e-6)


def test_chunks_do_not_change_the_figures(monkeypatch):
    model = prt.method("svd-ridge").fit(TRAIN)
    whole = prt.evaluate(model, TEST).errors
    monkeypatch.setattr(sys.modules["prt_bench.evaluate"], "_CHUNK_BYTES", 1)
    parts = prt.evaluate(model, TEST).errors
    for name, value in vars(whole).items():
        assert getattr(parts, name) == (value if value is None else pytest.approx(value, rel=1e-4))


def test_black_lightings_are_counted_and_left_out():
    arrays = {name: np.array(values) for name, values in DATASET.arrays.items()}
    for name in ("measured", "direct", "indirect"):
        arrays[name][TEST.rows[0]] = 0.0
    arrays["indirect_half"][0] = arrays["noise"][TEST.rows[0]] = 0.0
    errors = prt.evaluate(prt.method("svd-ridge").fit(TRAIN), replace(DATASET, arrays=arrays).split("test")).errors
    assert errors.black_lightings == 1
    assert np.isfinite(errors.relative_rmse)


def test_a_record_names_what_was_run():
    method = prt.method("svd-ridge", basis=8, ridge=1e-2)
    record = prt.evaluate(method.fit(TRAIN), TEST, method=method, seconds={"fit": 1.5})
    assert (record.scene, record.scenario, record.split) == ("cube", "point", "test")
    assert (record.method, record.label) == ("svd-ridge", "svd-ridge b8 ridge=0.01")
    assert record.settings == asdict(method)
    assert (record.settings["ridge"], record.settings["transfer"]) == (0.01, "shared")
    assert record.seconds == {"bake": 0.0, "fit": 1.5}
    assert record.bytes["asset"] == record.bytes["basis"] + record.bytes["transfer"] == 4 * (216 * 8 + 8 * 25)
    values = record.curves["singular_values"]
    assert values == sorted(values, reverse=True)


def test_an_empty_split_is_refused():
    empty = replace(DATASET, splits={"test": (3, 3)}).split("test")
    with pytest.raises(DatasetError, match="no lightings"):
        prt.evaluate(prt.method("mean").fit(TRAIN), empty)
