"""Halved lightmaps: frames from afar average texels, never across charts, and nothing changes near by."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from data_gen.atlas import lightmap_points, unwrap
from data_gen.scenes import load_scene
from prt_bench.lights import DirectionalLight, Lighting
from prt_bench.runtime import Runtime
from prt_bench.scene import Camera

from .conftest import quad_dataset

SIZE = (48, 36)
NEAR = Camera((0.9, 0.4, 1.3), (0.9, 0.0, 0.9), fov_y=30.0)
"""Onto the ground, a pixel of which is smaller than a texel."""
DARKNESS = Lighting([DirectionalLight((0, -1, 0), (0, 0, 0))])


@pytest.fixture(scope="module")
def objects():
    return load_scene("objects")


def dataset(scene, mips, apart=None):
    """No ray is traced; `apart` packs charts for another number of mip levels than the runtime is told of."""
    lightmap = unwrap(scene, 256, mips=mips if apart is None else apart, texture_set=True)
    lightmap = eqx.tree_at(lambda map_: map_.mips, lightmap, mips)
    receivers = lightmap_points(scene, lightmap)
    ds = quad_dataset(load_scene("cornell"))
    buried = np.zeros(len(receivers), bool)
    transport = replace(ds.transport, scene=scene, lightmap=lightmap, receivers=receivers, buried=buried)
    return replace(ds, transport=transport, dense_points=receivers[: len(ds.dense_points)])


def shown(ds, values, size=SIZE, camera=None):
    """A frame that shows `values` [T] at the receivers as they are."""
    runtime = Runtime(ds, size, camera=camera)
    irradiance = np.pi * values[:, None] / ds.points.albedo
    return runtime.frame(DARKNESS, runtime.lightmap(irradiance), direct=False)


def off_the_marks(ds, seed=0):
    """Share of pixels whose colour is that of no chart, where every chart has one of five far apart."""
    lightmap = ds.lightmap
    marks = np.random.default_rng(seed).integers(1, 6, lightmap.chart.max() + 1).astype(float)
    frame = shown(ds, marks[lightmap.chart[ds.points.face]])
    drawn = frame.max(axis=-1) > 0
    return float(np.mean(np.abs(frame[drawn] - np.round(frame[drawn])).max(axis=-1) > 1e-3))


@pytest.mark.parametrize("mips", [0, 1, 2])
def test_charts_never_mix(objects, mips):
    assert off_the_marks(dataset(objects, mips)) == 0.0


def test_charts_packed_too_tightly_would_mix(objects):
    assert off_the_marks(dataset(objects, 2, apart=0)) > 0.02


def test_texels_are_averaged_from_afar(objects):
    """Every other texel is bright: far frames show the mean, which frames without halved images miss by far."""
    worst = {}
    for mips in (0, 2):
        ds = dataset(objects, mips)
        side = ds.lightmap.resolution
        bright = (ds.lightmap.texel % side + ds.lightmap.texel // side) % 2
        frame = shown(ds, 1.0 + bright, (16, 12))
        pixels = frame[frame.max(axis=-1) > 0]
        worst[mips] = np.sqrt(np.mean((pixels - 1.5) ** 2))
    assert worst[2] < 0.35 * worst[0]


def test_frames_from_near_read_the_full_image(objects):
    ds = dataset(objects, 2)
    values = 1.0 + np.random.default_rng(1).random(len(ds.points))
    apart = {}
    for name, camera in (("near", NEAR), ("far", objects.camera)):
        halved, whole = (shown(each, values, camera=camera) for each in (ds, unhalved(ds)))
        apart[name] = np.abs(halved - whole).max()
    assert apart["near"] < 1e-5
    assert apart["far"] > 0.1


def unhalved(ds):
    lightmap = eqx.tree_at(lambda map_: map_.mips, ds.lightmap, 0)
    return replace(ds, transport=replace(ds.transport, lightmap=lightmap))
