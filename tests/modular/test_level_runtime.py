"""Levels in OpenGL against their operator in JAX, with traced shadows, and as a frame shows them."""

import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.direct import direct_irradiance
from data_gen.levels import EDGE, block_samples, scene_of
from data_gen.tracer import Tracer
from prt_bench.errors import AssetError, RuntimeUnavailable
from prt_bench.lights import Lighting, PointLight, SpotLight, emitters
from prt_bench.modular.atlas import LevelAtlas
from prt_bench.modular.level import Level, maze, transfer
from prt_bench.runtime import headless
from prt_bench.runtime.level import LevelRuntime
from prt_bench.scene import Camera

from .conftest import SIDE

pytestmark = pytest.mark.gl
ALBEDO = ((0.7, 0.7, 0.6), (0.7, 0.5, 0.7), (0.6, 0.7, 0.7), (0.5, 0.4, 0.3), (0.3, 0.5, 0.7), (0.7, 0.3, 0.2))
LIGHT = Lighting(
    [PointLight((0.4, 0.7, 0.3), (9.0, 8.0, 7.0)), SpotLight((2.5, 0.9, -0.4), (0.4, -1.0, 0.2), (5.0, 9.0, 4.0))]
)


@pytest.fixture(scope="module", autouse=True)
def gl():
    try:
        return headless()
    except RuntimeUnavailable as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def level():
    return maze(5, seed=1)


@pytest.fixture(scope="module")
def loaded(level, any_dictionary):
    points = block_samples(level, SIDE, ALBEDO)
    operator = transfer(level, any_dictionary)
    return operator, points, LevelRuntime(
        LevelAtlas(level, SIDE), operator, scene_of(level, ALBEDO), points, EDGE, (64, 64), 1024
    )  # fmt: skip


@pytest.mark.parametrize("bounces", [1, 3])
def test_opengl_is_the_operator(bounces, level, loaded):
    operator, points, runtime = loaded
    direct, found = runtime.solve(LIGHT, bounces)
    albedo = jnp.asarray(points.albedo.reshape(found.shape) * operator.solid[:, :, None], jnp.float32)
    wanted = np.asarray(operator(jnp.asarray(direct), albedo, bounces))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * wanted.max())
    traced = direct_irradiance(Tracer(runtime.scene), points, emitters([LIGHT]))[0].reshape(found.shape)
    wanted = np.asarray(operator(jnp.asarray(traced), albedo, bounces))
    assert np.linalg.norm(found - wanted) < 1e-3 * np.linalg.norm(wanted)
    source = LevelAtlas(level, SIDE).source
    shown = np.where(source[:, None] >= 0, found.reshape(-1, 3)[source], 0.0)
    np.testing.assert_array_equal(runtime.image().reshape(-1, 3), shown)


def test_a_frame_shows_the_floor_on_both_sides_of_a_seam_and_on_it(level, loaded):
    _, _, runtime = loaded
    _, light = runtime.solve(LIGHT, 2)
    side, other = next(iter(level.open[0].items()))
    step = np.delete(np.array(level.cells[other]) - level.cells[0], 1)
    table = light.reshape(len(level.cells), 6, SIDE, SIDE, 3)[:, 3]  # the floor: along x, then z
    middle = [SIDE // 2 - 1, SIDE // 2]
    ends = [middle if at == 0 else [SIDE - 1 if at > 0 else 0] for at in step]
    starts = [middle if at == 0 else [0 if at > 0 else SIDE - 1] for at in step]
    edges = 0.5 * (table[0][np.ix_(*ends)].mean((0, 1)) + table[other][np.ix_(*starts)].mean((0, 1)))
    for share, wanted in ((0.0, table[0][np.ix_(middle, middle)].mean((0, 1))), (0.5, edges)):
        x, z = EDGE * (np.delete(level.cells[0], 1) + share * step)
        runtime.look_from(Camera((x, 0.3, z), (x, -1.0, z), up=(0.0, 0.0, 1.0), fov_y=2.0))
        found = runtime.frame(LIGHT, 2, direct=False)[31:33, 31:33].mean((0, 1))
        np.testing.assert_allclose(found, np.array(ALBEDO[3]) / np.pi * wanted, rtol=0.01), side
    with pytest.raises(ValueError, match="direct light, indirect light"):
        runtime.frame(LIGHT, direct=False, indirect=False)


def test_what_is_not_of_one_level_is_refused(level, loaded, any_dictionary):
    operator, points, _ = loaded
    other = Level(((0, 0), (1, 0)))
    for atlas, given in ((LevelAtlas(other, SIDE), points), (LevelAtlas(level, SIDE), points[:9])):
        with pytest.raises(AssetError, match="does not fit"):
            LevelRuntime(atlas, operator, scene_of(level), given, EDGE)


@pytest.mark.parametrize(
    ("level", "bounces"), [(Level(((0, 0),)), 1), (maze(9, seed=3, layers=3), 3)], ids=["one", "layers"]
)
def test_a_closed_block_and_blocks_above_each_other_are_the_operator_too(level, bounces, any_dictionary):
    operator, points = transfer(level, any_dictionary), block_samples(level, SIDE, ALBEDO)
    runtime = LevelRuntime(LevelAtlas(level, SIDE), operator, scene_of(level, ALBEDO), points, EDGE, (8, 8), 256)
    direct, found = runtime.solve(LIGHT, bounces)
    albedo = points.albedo.reshape(found.shape) * operator.solid[:, :, None]
    wanted = operator(jnp.asarray(direct), jnp.asarray(albedo, jnp.float32), bounces)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * found.max())
