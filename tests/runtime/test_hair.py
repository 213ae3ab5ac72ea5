"""Frames with hair: direct light that a strand scatters against the scattering function, shadows, and indirect light."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import prt_bench as prt
from data_gen.strands import with_strands, without_strands
from prt_bench.dataset import LightingDataset
from prt_bench.hair import Hair, Inclination, albedo_at, far_scattering
from prt_bench.lights import DirectionalLight, Lighting
from prt_bench.runtime import Runtime
from prt_bench.runtime.fibres import fibre_code, lobe_tables
from prt_bench.scene import Camera
from prt_bench.strands import Strands
from tests.data_gen.tuft import FIBRES, tuft

ROUGH = Hair((0.1, 0.4, 1.2), variance=0.1, scale=0.4)
EYE = (0.0, 0.3, 2.0)


def one_strand(folder: Path, hair: Hair) -> LightingDataset:
    """A thick upright strand, seen from the front and somewhat above its middle."""
    scene = without_strands(tuft(hair, 1))
    nodes = np.array([(0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.001, 0.0)])
    scene = with_strands(scene, Strands(nodes, np.array([0, 3]), np.array([0.2]), np.array([FIBRES])))
    scene = replace(scene, camera=Camera(EYE, (0.0, 0.0, 0.0), fov_y=10.0))
    return prt.bake(scene, "directional", 1, 16, 8, 4, out=folder)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> LightingDataset:
    return one_strand(tmp_path_factory.mktemp("strand"), ROUGH)


@pytest.mark.parametrize("towards", [(0.3, 0.2, 1.0), (1.0, -0.4, 0.1), (-0.2, 0.1, -1.0), (0.05, 1.0, 0.3)])
def test_a_strand_scatters_light_as_its_fibres_do(dataset: LightingDataset, towards: tuple[float, ...]) -> None:
    """L_o = S E for a light of irradiance E, at each pixel of the strand, from the front and from behind."""
    runtime = Runtime(dataset, size=(32, 32), shadows=False)
    light, irradiance = np.array(towards) / np.linalg.norm(towards), np.array([3.0, 2.0, 1.0])
    frame = runtime.frame(Lighting([DirectionalLight(-light, irradiance)]))
    out = np.array(EYE) / np.linalg.norm(EYE)
    azimuth = np.arctan2(light[0], light[2]) - np.arctan2(out[0], out[2])
    into, leaving = (Inclination.of(np.array([vector[1]])) for vector in (light, out))
    expected = far_scattering(dataset.scene.materials[FIBRES].hair, leaving, into, np.array([azimuth]))[0]  # pyright: ignore
    middle = frame[14:18, 15:17].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, expected * irradiance, rtol=0.03)


def test_indirect_light_on_a_strand_is_multiplied_by_its_albedo(dataset: LightingDataset) -> None:
    runtime = Runtime(dataset, size=(32, 32))
    along = np.linspace(1.0, 2.0, 10)
    light = runtime.lightmap(np.repeat(along[:, None], 3, axis=1))
    dark = Lighting([DirectionalLight((0.0, -1.0, 0.0), (0.0, 0.0, 0.0))])
    frame = runtime.frame(dark, light, direct=False)
    albedo = np.array(dataset.scene.materials[FIBRES].albedo)
    np.testing.assert_allclose(frame[15:17, 15:17].mean(axis=(0, 1)), 1.5 * albedo / np.pi, rtol=0.02)
    column = frame[:, 15, 0]
    assert np.all(np.diff(column[column > 0]) < 0)  # brighter towards the tip, which is up
    np.testing.assert_allclose(frame, runtime.frame(dark, light), atol=1e-6)


def test_strands_shadow_each_other_and_the_ground(tmp_path: Path) -> None:
    ds = prt.bake(tuft(ROUGH, 150, ground=True), "directional", 1, 64, 8, 16, out=tmp_path)
    lamp = Lighting([DirectionalLight((0.0, -1.0, -0.3), (2.0, 2.0, 2.0))])
    lit, shadowed = (Runtime(ds, (96, 96), 2048, shadows).frame(lamp).mean() for shadows in (False, True))
    assert 0.2 * lit < shadowed < 0.95 * lit


def test_tables_hold_all_that_lobes_return() -> None:
    table = lobe_tables(ROUGH)
    assert table.shape[:1] + table.shape[3:] == (4, 3)
    total = table.mean(axis=2).sum(axis=0) * 2.0 * np.pi
    sine = (np.arange(len(total)) + 0.5) / len(total)
    np.testing.assert_allclose(total, albedo_at(ROUGH, Inclination.of(sine)), rtol=2e-3)
    code = fibre_code([ROUGH, Hair(variance=0.01)])
    assert code.count("vec4(") == 2
    assert "1.000000000e-02" in code
