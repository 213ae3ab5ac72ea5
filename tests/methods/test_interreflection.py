"""Inter-reflections under fixed light: diffuse ones against the operator, glossy ones against the path tracer."""

from dataclasses import replace

import numpy as np
import pytest

import prt_bench as prt
from data_gen.glossy_reference import reference_radiance
from prt_bench.environment import EnvironmentMap
from prt_bench.errors import SpecError
from prt_bench.example import example_dataset
from prt_bench.glossy import BouncedTripleModel, Surface
from prt_bench.methods.interreflection import bounced_transfer, fix_light
from prt_bench.scene import Glossy

SKY = np.ones((8, 16, 3)) * [1.0, 0.8, 0.6]
SKY[:, :8] *= 0.3  # darker on the left
LIGHTING = prt.Lighting([prt.EnvironmentLight(EnvironmentMap("sky", SKY.astype(np.float32)))])


def room(rays: int = 256, **lobe: object) -> prt.LightingDataset:
    """Five walls, a lobe on all of them where one is asked for."""
    ds = example_dataset(texels=6, rays=rays, walls=5)
    if not lobe:
        return ds
    materials = [
        replace(m, albedo=tuple(0.5 * value for value in m.albedo), glossy=Glossy(**lobe)) for m in ds.scene.materials
    ]
    scene = replace(ds.scene, materials=tuple(materials))
    points = replace(ds.points, albedo=0.5 * ds.points.albedo)
    return replace(ds, transport=replace(ds.transport, scene=scene, receivers=points, samples=points))


class Lit:
    """What a model observes of one lighting."""

    lightings = (LIGHTING,)
    measured = np.zeros((1, 1, 3))


def surface(ds: prt.LightingDataset) -> Surface:
    return Surface(ds.points.normal, ds.points.albedo, *ds.scene.glossy_at(ds.points.face, ds.points.barycentric))


def towards(ds: prt.LightingDataset) -> np.ndarray:
    eye = np.array([0.1, 0.2, 0.9]) - ds.points.position
    return eye / np.linalg.norm(eye, axis=1, keepdims=True)


def test_diffuse_bounces_are_those_of_the_operator():
    """Enough of them are all that `sh-texture` has; one less than all is not."""
    ds = room(rays=64)
    texture = prt.method("sh-texture", order=3).fit(ds)
    wanted = np.asarray(texture.reconstruct(texture.measure(Lit)))[0]
    found = []
    for bounces in (ds.transport.bounces, ds.transport.bounces - 1):
        model = fix_light(ds, LIGHTING, 3, bounces)
        found.append(np.asarray(model.reconstruct(model.measure(Lit)))[0])
    np.testing.assert_allclose(found[0], wanted, rtol=2e-5)
    assert np.abs(found[1] - wanted).max() > 1e-4 * wanted.max()


def test_glossy_bounces_agree_with_the_path_tracer():
    """What reflections add to direct light under an even sky, which one coefficient holds; broad lobes, which few bands hold.

    Lobes left out on the way, or mirror directions the wrong way round, miss by more than twice the bound.
    """
    sky = prt.Lighting([prt.EnvironmentLight(EnvironmentMap("even", np.ones((4, 8, 3), np.float32)))])
    light = np.zeros((25, 3))
    light[0] = np.sqrt(4.0 * np.pi)
    ds = room(rays=512, specular=(0.4, 0.3, 0.2), exponent=4.0)
    some = slice(None, None, 3)
    direct, *traced = (
        reference_radiance(ds.scene, sky, ds.points[some], towards(ds)[some], 1024, bounces) for bounces in (0, 1, 2)
    )
    for bounces, estimate in enumerate(traced, 1):
        wanted = estimate.mean - direct.mean
        errors, sums = [], []
        for transport in (ds.transport, replace(ds.transport, scene=dull(ds.scene))):
            basis = bounced_transfer(transport, light, bounces)
            model, bare = (BouncedTripleModel(part, np.zeros(3)) for part in (basis, basis * only_first(basis)))
            found, without = (
                np.asarray(each.radiance(light[None], surface(ds), towards(ds)))[0, some] for each in (model, bare)
            )
            errors.append(np.linalg.norm(found - without - wanted) / np.linalg.norm(wanted))
            sums.append(abs((found - without).sum() / wanted.sum() - 1.0))
        assert errors[0] < 0.11  # of which two thirds are the path tracer's noise
        assert sums[0] < 0.02 < 0.05 < sums[1]


def dull(scene: prt.Scene) -> prt.Scene:
    """Without lobes."""
    return replace(scene, materials=tuple(replace(m, glossy=None) for m in scene.materials))


def only_first(basis: np.ndarray) -> np.ndarray:
    return (np.arange(basis.shape[1]) == 0)[:, None]


def test_light_that_is_not_fixed_is_the_direct_part_alone():
    ds = room(specular=(0.3, 0.2, 0.1), exponent=12.0)
    model = fix_light(ds, LIGHTING)
    free = prt.method("sh-triple", interreflection=False).fit(ds)
    u = model.measure(Lit)
    added = [np.asarray(model.reconstruct(s * u) - free.reconstruct(s * u)) for s in (1.0, 3.0)]
    np.testing.assert_allclose(added[0], added[1], rtol=1e-4, atol=1e-6)
    assert added[0].min() > 0


@pytest.mark.parametrize(("change", "message"), [({"bounces": 0}, "at least 1"), ({"order": 9}, "from 1 to 8")])
def test_what_cannot_be_stored_is_refused(change: dict, message: str):
    with pytest.raises(SpecError, match=message):
        fix_light(room(rays=8), LIGHTING, **change)
