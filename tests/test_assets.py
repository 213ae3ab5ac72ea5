"""Assets survive the disk exactly, and damaged ones are refused in one sentence."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.assets import load_asset
from prt_bench.errors import AssetError
from prt_bench.models import LinearModel, NearestModel, ReferenceModel

RNG = np.random.default_rng(0)


def linear():
    return LinearModel(jnp.asarray(RNG.normal(size=(9, 4))), jnp.asarray(RNG.normal(size=(1, 4, 6))))


@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_weights_come_back_as_stored(tmp_path, dtype):
    model = linear()
    model.export(tmp_path / "asset", dtype)
    asset = load_asset(tmp_path / "asset")
    np.testing.assert_array_equal(asset.arrays["basis"], np.asarray(model.basis).astype(dtype))
    np.testing.assert_array_equal(asset.arrays["weights"], np.asarray(model.weights).astype("float32"))
    assert asset.bytes == {"basis": 36 * np.dtype(dtype).itemsize, "weights": 24 * 4}
    assert isinstance(asset.model(), LinearModel)


def test_kernels_tell_models_apart(tmp_path):
    model = NearestModel(jnp.ones((9, 3)), jnp.ones((3, 5)))
    assert isinstance(model.export(tmp_path / "asset").model(), NearestModel)


def test_equal_weights_give_equal_files(tmp_path):
    model = linear()
    assert model.export(tmp_path / "a").sha256 == model.export(tmp_path / "b").sha256


def test_an_asset_can_be_written_again(tmp_path):
    linear().export(tmp_path / "asset")
    again = linear().export(tmp_path / "asset")
    assert load_asset(tmp_path / "asset").sha256 == again.sha256


def flip_a_bit(folder):
    data = bytearray((folder / "weights.safetensors").read_bytes())
    data[-1] ^= 1
    (folder / "weights.safetensors").write_bytes(data)


def truncate(folder):
    data = (folder / "weights.safetensors").read_bytes()
    (folder / "weights.safetensors").write_bytes(data[: len(data) // 2])


def edit(**changes):
    def damage(folder):
        manifest = json.loads((folder / "manifest.json").read_text())
        (folder / "manifest.json").write_text(json.dumps({**manifest, **changes}))

    return damage


def drop(folder, key):
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest[key]
    (folder / "manifest.json").write_text(json.dumps(manifest))


DAMAGE = {
    "a flipped bit": (flip_a_bit, "truncated or altered"),
    "truncated": (truncate, "truncated or altered"),
    "wrong hash": (edit(sha256="0" * 64), "truncated or altered"),
    "future version": (edit(version=99), "version 99"),
    "unknown kernels": (edit(kernels={"measure": "direct", "transfer": "psychic", "reconstruct": "basis"}), "psychic"),
    "manifest cut short": (lambda folder: (folder / "manifest.json").write_text('{"version"'), "not valid JSON"),
    "not a manifest": (lambda folder: (folder / "manifest.json").write_text("[1]"), "is not the manifest"),
    "someone else's manifest": (edit(format="web app"), "is not the manifest"),
    "manifest without its hash": (lambda folder: drop(folder, "sha256"), "lacks sha256"),
    "no weights": (lambda folder: (folder / "weights.safetensors").unlink(), "weights.safetensors is missing"),
    "no manifest": (lambda folder: (folder / "manifest.json").unlink(), "manifest.json is missing"),
}


@pytest.mark.parametrize("case", DAMAGE)
def test_damage_is_refused(tmp_path, case):
    damage, sentence = DAMAGE[case]
    linear().export(tmp_path / "asset")
    damage(tmp_path / "asset")
    with pytest.raises(AssetError, match=sentence):
        load_asset(tmp_path / "asset")


def test_a_foreign_folder_is_left_alone(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "draft.tex").write_text("precious")
    with pytest.raises(AssetError, match="not a runtime asset"):
        linear().export(tmp_path / "thesis")
    assert (tmp_path / "thesis" / "draft.tex").read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["thesis"]


def test_weights_that_do_not_fit_are_refused_and_nothing_is_written(tmp_path):
    model = LinearModel(jnp.full((9, 4), 1e6), jnp.ones((1, 4, 6)))
    with pytest.raises(AssetError, match="'basis' are not finite in float16"):
        model.export(tmp_path / "asset", "float16")
    assert list(tmp_path.iterdir()) == []


def test_oracles_do_not_ship(tmp_path):
    with pytest.raises(AssetError, match="oracle"):
        ReferenceModel().export(tmp_path / "asset")


def test_unknown_storage_is_refused(tmp_path):
    with pytest.raises(AssetError, match="float32 or float16, not 'int3'"):
        linear().export(tmp_path / "asset", "int3")
