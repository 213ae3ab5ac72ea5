"""Samples and their splats in the runtime: shaders against NumPy, and light that is spread evenly and not through walls."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from data_gen.geometry import assemble, quad
from data_gen.meshless import hemispheres, walls_around
from data_gen.particles import thinned
from data_gen.sampling import random_points
from data_gen.tracer import Tracer
from prt_bench.clusters import clusters_of
from prt_bench.depth import ClusteredVisibility, hemisphere_directions
from prt_bench.errors import AssetError, LightError
from prt_bench.lights import DirectionalLight, Lighting, PointLight, RectLight, SpotLight
from prt_bench.points import SurfacePoints
from prt_bench.runtime import Runtime
from prt_bench.runtime.indirect import Indirect
from prt_bench.runtime.samples import SamplePasses
from prt_bench.runtime.splats import SplattedLight
from prt_bench.sampled import ClusteredTransfer, SampledLight, reaches
from prt_bench.scene import Camera, Material, Scene
from tests.runtime.conftest import quad_dataset

pytestmark = pytest.mark.gl

LAMP = Lighting(
    (
        PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0)),
        RectLight((-0.3, 1.9, 0.1), (0.2, 0.0, 0.0), (0.0, 0.0, 0.2), (9.0, 9.0, 8.0)),
        SpotLight((0.5, 1.0, 0.5), (0.0, -1.0, 0.0), (3.0, 1.0, 1.0)),
    )
)


def sampled(
    scene: Scene, points: SurfacePoints, directions: int = 120, size: int = 11, channels: int = 3
) -> SampledLight:
    """Traced visibility, and a random transfer between random bases."""
    tracer, rng = Tracer(scene), np.random.default_rng(0)
    owner = clusters_of(points, 6, bend=0.8).owner(points)
    around = hemisphere_directions(directions)
    seen = ClusteredVisibility.fit(hemispheres(tracer, points, around), around, owner, size, 0.25)
    bases = rng.normal(size=(len(points), 3)), rng.normal(size=(len(points), 5))
    transfer = ClusteredTransfer(owner, *bases, rng.normal(size=(channels, 5 * 6, 3 * 6)))
    return SampledLight(points, seen, transfer, reaches(points), walls_around(tracer, points, scene.mesh.normals))


@pytest.fixture(scope="module")
def model(cornell) -> SampledLight:
    points = random_points(cornell.scene, 4000)
    return sampled(cornell.scene, points[thinned(points, np.full(len(points), 0.14))])


@pytest.fixture(scope="module")
def loaded(runtime, model) -> SplattedLight:
    return runtime.splats(model)


def shown(runtime: Runtime, loaded: SplattedLight, indirect: np.ndarray) -> np.ndarray:
    """A frame of indirect light that is given at the samples."""
    values = np.zeros((len(indirect), 3, 4), "<f4")
    values[:, 2, :3] = indirect[loaded.samples.order]
    loaded.samples.lights.write(values.tobytes())
    loaded.splat()
    runtime.shade(runtime.light(LAMP), loaded, direct=False)
    return runtime.screen.read_linear()


def test_shaders_find_the_light_that_numpy_finds(runtime, model, loaded):
    loaded.samples.run(runtime.light(LAMP))
    direct, unshadowed, indirect = loaded.samples.read()
    stored = model.quantised()
    wanted = stored.direct(LAMP)
    np.testing.assert_allclose(direct, wanted, atol=1e-5 * wanted.max())
    np.testing.assert_allclose(indirect, stored.indirect(wanted), atol=1e-5 * np.abs(stored.indirect(wanted)).max())
    assert np.linalg.norm(wanted) < 0.97 * np.linalg.norm(unshadowed)
    assert np.linalg.norm(model.direct(LAMP) - wanted) < 1e-3 * np.linalg.norm(wanted)


def test_odd_sizes_and_one_channel(runtime, cornell, model):
    few = sampled(cornell.scene, model.points[::4], directions=37, size=4, channels=1)
    passes = SamplePasses(runtime.context, few)
    passes.run(runtime.light(LAMP))
    stored = few.quantised()
    wanted = stored.direct(LAMP)
    grey = stored._replace(transfer=stored.transfer._replace(blocks=np.repeat(stored.transfer.blocks, 3, axis=0)))
    direct, _, indirect = passes.read()
    np.testing.assert_allclose(direct, wanted, atol=1e-5 * wanted.max())
    np.testing.assert_allclose(indirect, grey.indirect(wanted), atol=1e-5 * np.abs(grey.indirect(wanted)).max())


def test_even_light_stays_even_and_every_pixel_has_some(cornell, runtime, loaded):
    found = shown(runtime, loaded, np.full((loaded.samples.count, 3), 2.5))
    wanted = runtime.frame(LAMP, runtime.lightmap(np.full((len(cornell.points), 3), 2.5)), direct=False)
    np.testing.assert_allclose(found, wanted, rtol=1e-5)


def test_slivers_without_samples_have_the_light_around_them(runtime, cornell, model):
    """Samples of one wall alone leave others dark, but for the pixels beside it."""
    back = np.flatnonzero(model.points.normal[:, 2] > 0.9)
    part = model.points[back]
    owner = np.zeros(len(part), int)
    seen = model.visibility._replace(cluster=owner, coefficients=model.visibility.coefficients[back])
    transfer = ClusteredTransfer(owner, np.zeros((len(part), 1)), np.zeros((len(part), 1)), np.zeros((1, 1, 1)))
    loaded = runtime.splats(SampledLight(part, seen, transfer, model.reach[back], model.walls[back]))
    frame = shown(runtime, loaded, np.ones((len(part), 3)))
    wanted = runtime.frame(LAMP, runtime.lightmap(np.ones((len(cornell.points), 3))), direct=False)
    lit = np.asarray(frame.any(axis=-1))
    np.testing.assert_allclose(frame[lit], wanted[lit], rtol=1e-5)
    facing = runtime.frame(LAMP, runtime.lightmap(cornell.points.normal[:, 2:] > 0.9), direct=False).any(axis=-1)
    assert lit[facing].all()
    beyond = np.asarray(distance_transform_edt(~facing))
    assert lit[(beyond > 0) & (beyond <= 2) & np.asarray(wanted.any(axis=-1))].all()
    assert not lit[beyond > 50].any()


def test_light_that_varies_is_interpolated(cornell, runtime, model, loaded):
    def light(points: SurfacePoints) -> np.ndarray:
        return 2.0 + points.position + 0.5 * points.normal

    found = shown(runtime, loaded, light(model.points))
    wanted = runtime.frame(LAMP, runtime.lightmap(light(cornell.points)), direct=False)
    assert np.linalg.norm(found - wanted) < 0.03 * np.linalg.norm(wanted)


def test_light_does_not_leak_through_a_thin_wall_along_the_floor():
    """A wall 2 cm thick between light and dark, where splats reach 20 cm."""
    parts = [
        quad([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)], 0),
        quad([(0.01, 0, 1), (0.01, 0, -1), (0.01, 0.3, -1), (0.01, 0.3, 1)], 0),
        quad([(-0.01, 0, -1), (-0.01, 0, 1), (-0.01, 0.3, 1), (-0.01, 0.3, -1)], 0),
    ]
    scene = Scene("thin", assemble(parts), (Material("white", (1.0,) * 3),), Camera((-2.0, 2.5, 0.1), (0.0, 0.0, 0.0)))
    runtime = Runtime(quad_dataset(scene, 8, 4, 1), size=(96, 72))
    loaded = runtime.splats(sampled(scene, random_points(scene, 900), directions=12, size=1))
    bright = loaded.samples
    left = np.frombuffer(bright.samples.read(), "<f4").reshape(-1, 20)[:, 0] < 0
    indirect = np.empty((bright.count, 3))
    indirect[bright.order] = left[:, None] * np.pi
    frame = shown(runtime, loaded, indirect)
    assert set(np.unique(frame.round(5))) == {0.0, 1.0}
    assert 0.1 < frame.mean() < 0.9


def test_shadows_multiply_light_of_the_pixels(cornell, runtime, model, loaded):
    """None where buffers are empty, as without shadows at all; else most of what maps say."""
    lamp = Lighting(LAMP.lights[:1])

    def direct(light: Indirect) -> np.ndarray:
        return runtime.frame(lamp, light) - runtime.frame(lamp, light, direct=False)

    empty = model.visibility._replace(mean=0 * model.visibility.mean, basis=0 * model.visibility.basis)
    everything = direct(runtime.splats(model._replace(visibility=empty)))
    unshadowed = Runtime(cornell, size=runtime.size, shadows=False).frame(lamp)
    np.testing.assert_allclose(everything, unshadowed, atol=1e-5 * unshadowed.max())
    wanted = runtime.frame(lamp)
    np.testing.assert_allclose(direct(runtime.splats(model, shadow_maps=True)), wanted, atol=1e-5 * wanted.max())
    assert np.linalg.norm(direct(loaded) - wanted) < 0.85 * np.linalg.norm(everything - wanted)


def test_what_samples_cannot_take_is_refused(runtime, model, loaded):
    with pytest.raises(LightError, match="not directional"):
        runtime.frame(Lighting((DirectionalLight((0.0, -1.0, 0.0), (1.0, 1.0, 1.0)),)), loaded)
    two = model._replace(transfer=model.transfer._replace(blocks=model.transfer.blocks[:2]))
    with pytest.raises(AssetError, match="2 channels"):
        runtime.splats(two)
