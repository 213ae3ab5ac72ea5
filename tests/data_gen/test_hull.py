"""Hulls around bodies: where they lie, what of them shows, and light measured on them."""

from dataclasses import replace

import numpy as np
import pytest

import prt_bench as prt
from data_gen.direct import direct_irradiance
from data_gen.geometry import assemble, box, quad
from data_gen.hull import MARGIN, hull_scene
from data_gen.sampling import measurement_points
from data_gen.scenes import load_scene
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError, SpecError
from prt_bench.lights import emitters
from prt_bench.scene import Camera, Material, Scene

HALF = 0.25  # exact in binary, so that corners coincide
GROUND = quad([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], 0)


def scene(*parts) -> Scene:
    return Scene("test", assemble(list(parts)), (Material("grey", (0.5, 0.5, 0.5)),) * 2, Camera((0, 1, 4), (0, 0, 0)))


def block(at=(0.0, 1.0, 0.0), half=HALF):
    return box((half, half, half), 1).transformed(np.eye(3), at)


def facets(of: Scene):
    """Middles, normals and areas of the facets that stand for bodies."""
    hull = hull_scene(of, Tracer(of))
    body = hull.mesh.material == 1
    return hull.mesh.triangles.mean(axis=1)[body], hull.mesh.normals[body], hull.mesh.areas[body]


def test_the_hull_of_a_block_is_a_wider_block():
    middle, normal, area = facets(scene(block()))
    margin = MARGIN * 2 * HALF * np.sqrt(3)
    wider = np.abs(middle - (0, 1, 0)).max(axis=1) - HALF
    assert np.all((wider > 0.3 * margin) & (wider < margin))
    np.testing.assert_allclose(area.sum(), 24 * (HALF + wider.mean()) ** 2, rtol=1e-6)
    assert np.all(np.einsum("fd,fd->f", middle - (0, 1, 0), normal) > 0), "normals point outward"


def test_hollows_are_bridged():
    """Two blocks of side a that share an edge are one body; their hull is a prism over a hexagon, 12.8 a² in area."""
    step = assemble([block((0, 1, 0)), block((2 * HALF, 1 + 2 * HALF, 0))])
    middle, _, area = facets(replace(scene(block()), mesh=replace(step, material=np.ones(len(step.faces), int))))
    assert 1.0 < area.sum() / ((10 + 2 * np.sqrt(2)) * (2 * HALF) ** 2) < 1.15
    assert np.linalg.norm(middle - (HALF, 1 + HALF, 0), axis=1).min() > HALF, "no facet lies in the notch"


def test_sheets_stay_and_what_they_hide_is_left_out():
    of = scene(GROUND, block((0, HALF, 0)))
    hull = hull_scene(of, Tracer(of))
    sheet = hull.mesh.material == 0
    np.testing.assert_allclose(hull.mesh.areas[sheet].sum(), 4.0)
    assert hull.mesh.triangles[~sheet][..., 1].min() >= 0.0
    assert hull.mesh.normals[~sheet][:, 1].min() > -0.9, "the underside stands on the ground"
    assert hull.mesh.areas[~sheet].sum() > 0.75 * 5 / 6 * 24 * HALF**2


def test_a_body_within_the_hull_of_another_is_left_out():
    alone = facets(scene(block()))[2].sum()
    assert facets(scene(block(), block(half=0.5 * HALF)))[2].sum() == pytest.approx(alone)


@pytest.mark.parametrize("name", ["furnace", "two-plates"])
def test_rooms_and_sheets_alone_are_refused(name):
    with pytest.raises(SceneError, match=f"scene '{name}' has no body"):
        prt.plan(load_scene(name), measure_on="hull")


def test_elsewhere_is_refused():
    with pytest.raises(SpecError, match="'surface' or 'hull', not 'moon'"):
        prt.plan(load_scene("cornell"), measure_on="moon")


def test_a_bake_measures_there(tmp_path):
    """Direct light at points off the surface, which nothing buries; a coarse fit on them predicts indirect light."""
    of = load_scene("cornell")
    settings = {"lightings": 24, "texels": 24, "rays": 32, "measurements": 64, "supersampling": 2, "out": tmp_path}
    hull, surface = (prt.bake(of, "point", measure_on=where, **settings) for where in ("hull", "surface"))
    assert hull.metadata["measure_on"] == "hull"
    assert hull.path != surface.path
    np.testing.assert_array_equal(hull.indirect, surface.indirect)
    tracer = Tracer(of)
    assert not tracer.inside(hull.dense_points.position).any()
    wanted = direct_irradiance(tracer, hull.dense_points, emitters(hull.lightings), True)[:, hull.groups].mean(axis=2)
    np.testing.assert_allclose(hull.measured, wanted, rtol=1e-5, atol=1e-6)
    points = measurement_points(hull_scene(of, tracer), 64, 2, 0, tracer)[0]
    np.testing.assert_allclose(hull.measurement_points.position, points.position)
    off = np.abs(hull.measurement_points.position[:, [0, 2]]).max(axis=1) < 0.99
    assert off.any()
    model = prt.method("svd-ridge", basis=8).fit(hull.split("train"))
    assert prt.evaluate(model, hull.split("test")).errors.relative_rmse < 0.8
    with pytest.raises(SpecError, match="measure poses on the surface"):
        prt.bake(of, "point", layout=hull, **settings)
