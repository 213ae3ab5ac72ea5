"""Networks on the GPU against the models they were exported from, in both precisions and for shapes that divide by nothing."""

import jax
import numpy as np
import pytest

from prt_bench.learned.fields import LEVELS, Field, FieldModel
from prt_bench.learned.models import ResidualModel
from prt_bench.learned.networks import Network
from prt_bench.lights import Lighting, PointLight
from prt_bench.runtime.layers import blocks, network_code

from .conftest import linear_model

pytestmark = pytest.mark.gl
PARITY = 1e-3


def relative(found, wanted):
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def residual_model(ds, basis, hidden, channels, seed=0):
    keys = jax.random.split(jax.random.key(seed), 2)
    network = Network.random(keys[0], [len(ds.groups), *hidden])
    biases = tuple(0.3 * jax.random.normal(keys[1], bias.shape) for bias in network.biases)
    head = 3.0 * jax.random.normal(keys[1], (channels, basis, hidden[-1]))
    return ResidualModel(linear_model(ds, basis, channels), Network(network.matrices, biases), head)


def light(ds, scale=1.0):
    x = np.random.default_rng(0).exponential(size=(len(ds.groups), 3)).astype(np.float32)
    return scale * x


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize(
    ("basis", "hidden", "channels"), [(16, (128, 128), 3), (5, (7,), 1), (6, (33, 10, 3), 3), (70, (160,), 1)]
)
def test_coefficients_and_light_are_those_of_the_model(dtype, basis, hidden, channels, runtime, cornell, export):
    model = residual_model(cornell, basis, hidden, channels)
    asset = export(model, dtype)
    loaded, wanted = runtime.load(asset), asset.model()
    x = light(cornell)
    u = np.asarray(wanted.transfer(x[None]))
    plain = np.asarray(wanted.linear.transfer(x[None]))
    assert relative(plain, u) > 0.1, "the network has a say"
    assert relative(loaded.coefficients_of(x), u[0]) < 0.1 * PARITY
    assert relative(loaded.predict(x), np.asarray(wanted.reconstruct(u))[0]) < PARITY
    assert relative(loaded.coefficients_of(x), np.asarray(model.transfer(x[None]))[0]) < (
        1e-5 if dtype == "float32" else 1e-2
    )


@pytest.mark.parametrize("scale", [1e-25, 1e25])
def test_light_of_any_size_and_none(scale, runtime, cornell, export):
    loaded = runtime.load(export(residual_model(cornell, 4, (12,), 3)))
    x = light(cornell)
    plain = loaded.coefficients_of(x)
    np.testing.assert_allclose(loaded.coefficients_of(np.float32(scale) * x) / scale, plain, rtol=1e-4, atol=1e-4)
    red = x * np.array([1, 0, 0], np.float32)
    found = loaded.coefficients_of(red)
    np.testing.assert_allclose(found[:, 0], plain[:, 0], rtol=1e-6)
    assert not found[:, 1:].any()
    assert not loaded.coefficients_of(0 * x).any()


def test_weights_lie_on_the_gpu_as_they_are_stored(runtime, cornell, export):
    model = residual_model(cornell, 8, (32,), 3)
    sizes = {dtype: runtime.load(export(model, dtype)).transfer_pass._network.bytes for dtype in ("float32", "float16")}
    numbers = len(cornell.groups) * 32 + 3 * 8 * 32
    assert sizes == {"float32": 4 * (numbers + 32), "float16": 2 * numbers + 4 * 32}


def test_blocks_hold_four_inputs_of_neighbouring_outputs():
    matrix = np.arange(15.0).reshape(3, 5)
    found = blocks(matrix)
    assert found.shape == (2, 3, 4)
    np.testing.assert_array_equal(found[0, 2], matrix[2, :4])
    np.testing.assert_array_equal(found[1, 1], [matrix[1, 4], 0, 0, 0])


def test_every_layer_has_code_of_its_own():
    code = network_code("64_32_8_4")
    assert code.count("squareplus") == 2
    assert "o < 32u" in code
    assert "o < 8u" in code
    assert "o < 4u" in code


def field_model(ds, encoding, functions, width, depth, seed=0):
    keys = jax.random.split(jax.random.key(seed), 3)
    points, mesh = ds.points, ds.scene.mesh
    box = np.append(points.position.mean(axis=0), 1.0 / np.ptp(points.position, axis=0).max())
    field = Field.random(keys[0], encoding, box, width, depth, functions)
    biases = tuple(0.3 * jax.random.normal(keys[1], bias.shape) for bias in field.network.biases)
    grids = tuple(10.0 * grid for grid in field.grids)
    head = jax.random.normal(keys[2], field.head.shape)
    field = Field(Network(field.network.matrices, biases), head, box, grids, field.octaves)
    normal = mesh.normals[points.face]
    return FieldModel(field, linear_model(ds, functions, 3).weights, points.position, normal)


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize(
    ("encoding", "functions", "width", "depth"),
    [("none", 5, 7, 1), ("frequency", 16, 32, 2), ("grid", 6, 16, 2)],
)
def test_fields_are_those_of_the_model(dtype, encoding, functions, width, depth, runtime, cornell, export):
    model = field_model(cornell, encoding, functions, width, depth)
    asset = export(model, dtype)
    loaded, wanted = runtime.load(asset), asset.model()
    x = light(cornell)
    predicted = np.asarray(wanted.reconstruct(wanted.transfer(x[None])))[0]
    assert relative(loaded.predict(x), predicted) < PARITY
    full = np.asarray(model.reconstruct(model.transfer(x[None])))[0]
    assert relative(loaded.predict(x), full) < (1e-4 if dtype == "float32" else 2e-2)
    numbers = sum(array.size for name, array in asset.arrays.items() if name.startswith("grid"))
    assert numbers == (2 * sum(side**3 for side in LEVELS) if encoding == "grid" else 0)


def test_a_frame_shows_the_field_where_a_texture_would(runtime, cornell, export):
    """The same functions from the network and from a lightmap; they differ by what a texel's bilinear lookup does."""
    model = field_model(cornell, "none", 4, 12, 1)
    loaded = runtime.load(export(model))
    lighting = Lighting([PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0))])
    x = runtime.measure(lighting)
    baked = runtime.lightmap(np.asarray(model.reconstruct(model.transfer(x[None].astype(float))))[0])
    found, wanted = (runtime.frame(lighting, indirect, direct=False) for indirect in (loaded, baked))
    assert relative(found, wanted) < 0.02
