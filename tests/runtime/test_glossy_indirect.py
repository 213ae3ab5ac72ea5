"""Glossy indirect light: coefficients against irradiance and a path tracer, OpenGL against JAX, highlights, and refusals."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.glossy_reference import reference_radiance
from prt_bench.dataset import LightingDataset
from prt_bench.errors import AssetError, SpecError
from prt_bench.glossy import mirrored
from prt_bench.glossy_indirect import gloss, irradiance
from prt_bench.lights import Lighting, PointLight
from prt_bench.models import LinearModel
from prt_bench.runtime import Runtime, shaders
from prt_bench.scene import Glossy, Scene

from .conftest import points_on, quad_dataset

pytestmark = pytest.mark.gl

SPECULAR, EXPONENT = (0.4, 0.3, 0.2), 1.0
LAMP = Lighting([PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0))])
SMALL: dict[str, Any] = {
    "scenario": "point",
    "lightings": 6,
    "texels": 32,
    "rays": 128,
    "measurements": 16,
    "supersampling": 1,
}


def shiny(exponent: float = EXPONENT, which: int = 0) -> Scene:
    """The Cornell box with a lobe on one of its materials."""
    scene = prt.load_scene("cornell")
    made = replace(scene.materials[which], glossy=Glossy(SPECULAR, exponent), albedo=(0.4, 0.4, 0.4))
    return replace(scene, materials=(*scene.materials[:which], made, *scene.materials[which + 1 :]))


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> LightingDataset:
    return prt.bake(shiny(), **SMALL, out=tmp_path_factory.mktemp("glossy"))


@pytest.fixture(scope="module")
def lit(baked: LightingDataset) -> tuple[Any, LightingDataset]:
    found = prt.directional(baked)
    return found, found.dataset()


def test_the_first_coefficient_is_the_baked_irradiance(baked, lit) -> None:
    found, ds = lit
    coefficients = found.coefficients(ds.split("test").indirect)
    np.testing.assert_allclose(
        irradiance(coefficients), baked.split("test").indirect[:, found.rows], rtol=1e-4, atol=1e-6
    )
    np.testing.assert_allclose(found.light(ds.split("test").lightings[:2]), coefficients[:2], rtol=1e-4, atol=1e-6)
    assert 0 < ds.split("test").noise_floor < 0.3
    np.testing.assert_array_equal(ds.split("test").measured, baked.split("test").measured)


def test_lobes_reflect_what_paths_bring(baked, lit) -> None:
    """A lobe of exponent 1 has next to nothing beyond three bands: radiance towards the eye, less that of direct light."""
    found, _ = lit
    every = baked.points[found.rows]
    some = np.linspace(0, len(every) - 1, 40).astype(int)
    points = every[some]
    towards = np.array([0.0, 1.0, 3.0]) - points.position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    seen = np.einsum("pd,pd->p", towards, points.normal) > 0.05
    some, points, towards = some[seen], points[seen], towards[seen]
    whole, direct = (
        reference_radiance(baked.scene, LAMP, points, towards, 3000, bounces, diffuse_between=True).mean
        for bounces in (None, 0)
    )
    light = found.light([LAMP])[:, some]
    lobe = gloss(jnp.asarray(light), mirrored(jnp.asarray(towards), points.normal), jnp.full(len(points), EXPONENT))[0]
    ours = np.array(SPECULAR) * np.asarray(lobe) + 0.4 / np.pi * np.asarray(irradiance(light))[0]
    theirs = whole - direct
    assert np.linalg.norm(ours - theirs) < 0.08 * np.linalg.norm(theirs)
    without = np.linalg.norm(0.4 / np.pi * np.asarray(irradiance(light))[0] - theirs)
    assert without > 0.2 * np.linalg.norm(theirs)


def test_an_asset_draws_what_its_model_predicts(baked, lit, tmp_path: Path) -> None:
    found, ds = lit
    asset = prt.method("svd-ridge", basis=4).fit(ds.split("train")).export(tmp_path / "gloss")
    room = prt.method("svd-ridge", basis=4).fit(baked.split("train")).export(tmp_path / "room")
    runtime, test = Runtime(baked, size=(48, 36), shadow_resolution=512), ds.split("test")
    plain = runtime.load(room)
    shown = runtime.glossy(plain, asset, found.rows)
    expected = found.coefficients(asset.predict(test))[0]
    assert np.abs(shown.predict(np.asarray(test.measured[0])) - expected).max() <= 1e-3 * np.abs(expected).max()
    with_lobes, without = (runtime.frame(test.lightings[0], light, direct=False) for light in (shown, plain))
    assert np.all(with_lobes >= without - 1e-6)
    assert np.mean(np.any(with_lobes > without + 1e-6, axis=2)) > 0.1
    assert shown.bytes > plain.bytes
    other = prt.method("svd-ridge", basis=4).fit(baked.split("train"))
    with pytest.raises(AssetError, match="fit it to their own dataset"):
        runtime.glossy(plain, other.export(tmp_path / "other"), found.rows)
    with pytest.raises(AssetError, match="without lobes of its own"):
        runtime.glossy(shown, asset, found.rows)
    with pytest.raises(SpecError, match="no hit table of its own"):
        prt.method("operator-ridge", basis=4).fit(ds.split("train"))


def quads(exponent: float) -> tuple[Runtime, LightingDataset]:
    ds = quad_dataset(shiny(exponent))
    return Runtime(ds, size=(96, 72), shadow_resolution=256, shadows=False), ds


def pixels(runtime: Runtime, ds: LightingDataset) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of surfaces with a lobe: rows, columns, places and normals, by rays through their middles."""
    from data_gen.tracer import Tracer

    width, height = runtime.size
    rows, columns = (part.ravel() for part in np.mgrid[:height, :width])
    screen = np.stack([2 * (columns + 0.5) / width - 1, 1 - 2 * (rows + 0.5) / height], axis=1)
    ends = [
        np.column_stack([screen, np.full(len(rows), depth), np.ones(len(rows))]) @ np.linalg.inv(runtime.camera).T
        for depth in (-1.0, 1.0)
    ]
    near, far = (end[:, :3] / end[:, 3:] for end in ends)
    way = (far - near) / np.linalg.norm(far - near, axis=1, keepdims=True)
    hits = Tracer(ds.scene, 1).intersect(near, way)
    at = np.flatnonzero((hits.face >= 0) & hits.front & (ds.scene.mesh.material[hits.face] == 0))
    share = np.stack([1 - hits.u - hits.v, hits.u, hits.v], axis=1)[at]
    points = points_on(ds.scene, hits.face[at], share)
    return rows[at], columns[at], points.position, points.normal


def test_every_pixel_reads_its_lobe(export) -> None:
    """Coefficients that are the same everywhere: what a pixel shows beyond diffuse light is the lobe about its own mirror
    direction, and of a lamp the closed form (s + 1) / 2π · cosˢα cosθ I / r²."""
    exponent = 12.0
    runtime, ds = quads(exponent)
    specular, _ = ds.scene.glossy_at(ds.points.face, ds.points.barycentric)
    rows_at = np.flatnonzero(specular.any(axis=1))
    rng = np.random.default_rng(0)
    held = rng.normal(size=9) + 4.0 * (np.arange(9) == 0)
    weights = np.zeros((1, 1, runtime.measurement.count + 1))
    weights[0, 0, 0] = 1.0
    asset = export(LinearModel(jnp.asarray(np.tile(held, len(rows_at))[:, None]), jnp.asarray(weights)))
    dark = runtime.lightmap(np.zeros((len(ds.points), 3)))
    shown = runtime.glossy(dark, asset, rows_at)
    measured = runtime.measure(LAMP)[0]
    rows, columns, place, normal = pixels(runtime, ds)
    eye = np.asarray(ds.scene.camera.position)
    towards = (eye - place) / np.linalg.norm(eye - place, axis=1, keepdims=True)
    mirror = np.asarray(mirrored(jnp.asarray(towards), normal))
    coefficients = np.broadcast_to(held[:, None] * measured, (1, len(place), 9, 3))
    lobe = gloss(jnp.asarray(coefficients), jnp.asarray(mirror), jnp.full(len(place), exponent))[0]
    frame = runtime.frame(LAMP, shown, direct=False)[rows, columns]
    expected = np.array(SPECULAR) * np.maximum(np.asarray(lobe), 0.0)
    inside = np.abs(frame - expected).max(axis=1) <= 1e-3 * expected.max()
    assert inside.mean() > 0.97  # all but pixels at edges

    whole, diffuse = (runtime.frame(LAMP, light)[rows, columns] for light in (shown, dark))
    lamp = np.asarray(LAMP.lights[0].position) - place  # pyright: ignore
    square = np.sum(lamp**2, axis=1)
    way = lamp / np.sqrt(square)[:, None]
    aligned, cosine = (np.maximum(np.einsum("pd,pd->p", part, way), 0.0) for part in (mirror, normal))
    radius = float(LAMP.lights[0].radius)  # pyright: ignore
    strength = (exponent + 1.0) / (2.0 * np.pi) * aligned**exponent * cosine / (square + radius**2)
    highlight = np.array(SPECULAR) * strength[:, None] * np.array([5.0, 4.0, 3.0])
    off = np.abs(whole - diffuse - frame - highlight).max(axis=1)
    assert np.mean(off <= 2e-3 * highlight.max()) > 0.97
    assert highlight.max() > 0.5


def test_scenes_and_frames_without_it_have_none_of_it(cornell, gl) -> None:
    with pytest.raises(SpecError, match="no surface of 'cornell' has a glossy lobe"):
        prt.directional(cornell)
    asset_defines = {"SHADED": 1, "INDIRECT": 1, "DIRECT": 1, "RECONSTRUCT_LIGHTMAP": 1, "DEPTH_OFFSET": "0.0",
                     "SURFACE_END": "1.0", "RAY_OFFSET": "0.0", "ATLAS_SIZE": "64.0"}  # fmt: skip
    plain = set(shaders.program(gl, "draw.vert", "draw.frag", asset_defines))
    lobes = set(
        shaders.program(gl, "draw.vert", "draw.frag", {**asset_defines, "GLOSSY": 1, "DIRECTIONAL": 1, "ORDER": 3})
    )
    assert {"arriving", "eye", "in_specular"} <= lobes
    assert not {"arriving", "eye", "in_specular"} & plain
