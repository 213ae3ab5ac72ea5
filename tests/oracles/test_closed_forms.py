"""The operator on scenes whose indirect light is known in closed form."""

from pathlib import Path

import numpy as np
import pytest

from data_gen.plan import plan
from data_gen.scenes import furnace, load_scene, two_plates
from data_gen.trace import trace
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.lights import DirectionalLight, Lighting, PointLight
from tests.oracles.operator_light import operator_light

COLOUR = np.array([3.0, 2.0, 1.0])
RAYS = 256


def traced(name: str, texels: int, folder: Path) -> Transport:
    scene = load_scene(name)
    return trace(scene, plan(scene, texels=texels, rays=RAYS), 0, folder, Tracer(scene))


def test_furnace_is_lit_evenly_by_the_geometric_series(tmp_path: Path) -> None:
    transport = traced("furnace", 64, tmp_path)
    lamp = np.array([0.3, -0.2, 0.1])
    _, found = operator_light(transport, [Lighting([PointLight(lamp, COLOUR, 0.0)])])
    # The light's whole power 4πI arrives on the area: mean(E_dir) = 4πI / area.
    expected = furnace.indirect_irradiance(4.0 * np.pi / transport.scene.mesh.areas.sum()) * COLOUR
    error = found[0] / expected - 1.0
    # Independent rays would scatter by std(E_dir) / mean(E_dir) / √RAYS, here 0.49 / 16 = 3 %; Sobol' rays by 0.26 %.
    # That the faces are flat and the texels finite shows in neither.
    assert np.sqrt(np.mean(error**2)) < 5e-3
    assert abs(error.mean()) < 5e-4


@pytest.mark.parametrize(("plate", "direct"), [(two_plates.FLOOR, 0.8), (two_plates.WALL, 0.6)])
def test_two_plates_exchange_their_view_factor(plate: int, direct: float, tmp_path: Path) -> None:
    transport = traced("two-plates", 64, tmp_path)
    here = transport.scene.mesh.material[transport.receivers.face] == plate
    lighting = Lighting([DirectionalLight([0.0, -0.6, -0.8], COLOUR)])  # 0.6 on the floor, 0.8 on the wall
    _, found = operator_light(transport, [lighting], bounces=1)
    factor = two_plates.view_factor(transport.receivers.position[here])[:, None]
    arriving = two_plates.ALBEDO * direct * COLOUR
    # A row counts hits, a binomial for independent rays: z would have unit variance. With Sobol' rays it has 0.19².
    deviation = np.sqrt(factor * (1.0 - factor) / RAYS) * arriving
    z = (found[0, here] - factor * arriving) / deviation
    assert np.abs(z).max() < 1.5
    assert np.sqrt(np.mean(z**2)) < 0.4
    assert abs(found[0, here].mean() / (factor * arriving).mean() - 1.0) < 2e-3


def test_bounces_of_two_plates_shrink_by_albedo_and_view_factor(tmp_path: Path) -> None:
    transport = traced("two-plates", 32, tmp_path)
    lighting = Lighting([DirectionalLight([0.0, -0.6, -0.8], COLOUR)])
    one, two, everything = (operator_light(transport, [lighting], bounces)[1] for bounces in (1, 2, None))
    second = two - one
    largest = two_plates.ALBEDO * two_plates.view_factor(transport.receivers.position).max()
    assert np.all(second >= 0)
    assert second.max() <= 1.05 * largest * one.max()
    np.testing.assert_allclose(everything, one + second, rtol=3 * largest**2)
    assert np.all(everything >= two)
