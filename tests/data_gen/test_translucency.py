"""Light through translucent bodies: the operator against the path tracer, energy, gradients, halves and bounces."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen import journal
from data_gen.direct import direct_irradiance
from data_gen.effects import subsurface
from data_gen.medium_walk import Fate
from data_gen.reference import indirect_irradiance, leaving_light
from data_gen.tracer import Tracer
from prt_bench.chain import indirect_light
from prt_bench.dataset import LightingDataset, Transport
from prt_bench.errors import SpecError
from prt_bench.lights import DirectionalLight, Lighting, emitters
from prt_bench.medium import Subsurface
from prt_bench.methods.interreflection import bounced_transfer
from prt_bench.methods.operator import importance, respond
from prt_bench.transport import tail_bounds
from tests.data_gen.ball import BALL, LAMP, MEDIUM, SMALL, room, traced
from tests.oracles.operator_light import squared_error


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> LightingDataset:
    return prt.bake(room(), **SMALL, streamed=16, vertices=True, out=tmp_path_factory.mktemp("data"))


def test_the_operator_agrees_with_the_independent_path_tracer(tmp_path: Path) -> None:
    """Through the medium, and between bodies and walls; the oracle's noise taken out of the comparison."""
    scene = room(albedo=(0.03, 0.03, 0.03))
    transport = traced(scene, tmp_path, texels=48, rays=256)
    points, albedo = transport.receivers, jnp.asarray(transport.samples.albedo, jnp.float32)
    direct = jnp.asarray(direct_irradiance(Tracer(scene), transport.samples, emitters([LAMP])))
    owner, rng = scene.mesh.material[points.face], np.random.default_rng(0)
    here = rng.choice(np.flatnonzero(owner == BALL), 300, replace=False)
    there = rng.choice(np.flatnonzero((owner != BALL) & ~transport.buried), 300, replace=False)
    through = leaving_light(scene, points.position[here], points.normal[here], points.face[here], LAMP, 256)
    around = indirect_irradiance(scene, points.position[there], points.normal[there], LAMP, 256)

    def light(transport: Transport) -> np.ndarray:
        return np.asarray(indirect_light(transport, direct, albedo), float)[0]

    assert transport.walks is not None
    indirect = light(transport)
    leaving = indirect * transport.walks.colour[owner]
    for found, oracle in ((leaving[here], through), (indirect[there], around)):
        squared, uncertainty = squared_error(found, *oracle.halves)
        assert squared < 0.08**2 + 2 * uncertainty
        assert found.mean() == pytest.approx(oracle.mean.mean(), rel=0.03)
        assert squared_error(1.1 * found, *oracle.halves)[0] > squared + 0.003
    without = light(replace(transport, walks=None))
    assert squared_error(without[there], *around.halves)[0] > 0.1**2  # the ground and the wall see the ball's light


def test_light_that_is_the_same_everywhere_returns_the_colour(dataset: LightingDataset) -> None:
    """κ is what K makes of E = 1, on average; and no row of K gives back more than the boundary lets in and out."""
    transport = dataset.transport
    assert transport.walks is not None
    scattering = transport.receiver_scattering()
    assert scattering is not None
    back = np.asarray(scattering(jnp.ones((len(transport.samples), 1, 3))))[:, 0]
    np.testing.assert_allclose(back.mean(axis=0), transport.walks.colour[BALL], rtol=1e-3)
    assert back.max() <= 1.0
    assert back.mean() < 1.0 - MEDIUM.reflected
    assert np.all(np.diff(back.mean(axis=0)) < 0)  # blue is absorbed most


def test_a_white_body_with_a_matched_boundary_vanishes_in_even_light(tmp_path: Path) -> None:
    """White furnace: K 1 = 1, row by row and exactly."""
    transport = traced(room(Subsurface.of_albedo((1, 1, 1), (0.1,) * 3, 0.4, 1.0)), tmp_path)
    scattering = transport.sample_scattering()
    assert scattering is not None
    even = np.asarray(scattering(jnp.ones((len(transport.samples), 1, 1))))
    np.testing.assert_allclose(even, 1.0, rtol=1e-6)
    assert transport.walks is not None


def test_fates_are_counted_and_add_up(dataset: LightingDataset) -> None:
    walks = dataset.transport.walks
    assert walks is not None
    counts = walks.fates["ball"]
    assert set(counts) == {fate.name.lower() for fate in Fate}
    assert counts["alive"] == counts["lost"] == [0, 0, 0]
    tables = (walks.receivers, walks.vertices)
    assert all(table is not None for table in tables)
    points = sum(len(table.rows) for table in tables if table is not None)
    np.testing.assert_array_equal(np.sum(list(counts.values()), axis=0), points * SMALL["rays"])


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_and_interruptions_change_nothing(
    dataset: LightingDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    monkeypatch.setattr(subsurface, "_POINTS", 60)
    add, count = journal.Journal.add, 0

    def add_then_stop(self: journal.Journal, chunk: int, **entry: object) -> None:
        nonlocal count
        add(self, chunk, **entry)
        count += 1
        if count == 4:
            raise KeyboardInterrupt

    settings = {**SMALL, "streamed": 16, "vertices": True, "out": tmp_path, "workers": workers}
    if workers == 2:
        monkeypatch.setattr(journal.Journal, "add", add_then_stop)
        with pytest.raises(KeyboardInterrupt):
            prt.bake(room(), **settings)
    assert prt.bake(room(), **settings).hash == dataset.hash


def test_the_adjoint_is_the_transpose_of_the_operator(dataset: LightingDataset) -> None:
    transport, rng = dataset.transport, np.random.default_rng(0)
    direct = rng.random((len(transport.samples), 2)).astype(np.float32)
    u = rng.normal(size=(len(transport.receivers), 3))
    albedo = jnp.asarray(transport.samples.albedo, jnp.float32)
    there = np.einsum("tcp,tb->cbp", respond(transport, albedo, direct).astype(float), u)
    back = np.einsum("csb,sp->cbp", np.asarray(importance(transport, albedo, jnp.asarray(u))), direct)
    np.testing.assert_allclose(back, there, rtol=1e-4, atol=1e-4 * np.abs(there).max())


def test_the_bake_is_the_chain_and_the_operator(dataset: LightingDataset) -> None:
    """Three ways to the same light: the bake's two halves, the differentiable chain, and the operator of the methods."""
    transport = dataset.transport
    test = dataset.split("test")
    direct = direct_irradiance(Tracer(dataset.scene), transport.samples, emitters(test.lightings[:2]))
    albedo = jnp.asarray(transport.samples.albedo, jnp.float32)
    chain = np.asarray(indirect_light(transport, jnp.asarray(direct), albedo))
    scale = test.indirect[:2].max()
    grey = respond(transport, albedo, direct.mean(axis=2).T)
    np.testing.assert_allclose(chain.mean(), test.indirect[:2].mean(), rtol=0.02)
    from_grey = np.asarray(
        indirect_light(transport, jnp.asarray(np.repeat(direct.mean(axis=2, keepdims=True), 3, axis=2)), albedo)
    )
    np.testing.assert_allclose(np.moveaxis(grey, 2, 0), from_grey, atol=2e-5 * scale)


@pytest.mark.parametrize("of", ["albedo", "direct"])
def test_gradients_reach_through_bodies(dataset: LightingDataset, of: str) -> None:
    """albedo, direct light → operator → indirect light, against finite differences."""
    transport = dataset.transport
    test, rng = dataset.split("test"), np.random.default_rng(3)
    direct = direct_irradiance(Tracer(dataset.scene), transport.samples, emitters(test.lightings[:1])).astype(float)
    albedo = np.asarray(transport.samples.albedo, float) * 0.9 + 0.02
    wanted = np.asarray(test.indirect[1:2], float)

    def loss(value: jax.Array) -> jax.Array:
        light, colour = (value, albedo) if of == "direct" else (direct, value)
        return jnp.mean((indirect_light(transport, jnp.asarray(light), jnp.asarray(colour)) - wanted) ** 2)

    at = direct if of == "direct" else albedo
    along = rng.normal(size=at.shape) * (np.abs(at) if of == "direct" else 1.0)
    slope = float(jnp.sum(jax.grad(loss)(jnp.asarray(at)) * along))
    step = 1e-4
    wide, narrow = (
        float(loss(jnp.asarray(at + h * along)) - loss(jnp.asarray(at - h * along))) / (2 * h) for h in (2 * step, step)
    )
    assert slope == pytest.approx((4 * narrow - wide) / 3, rel=1e-6)
    assert slope != 0


def test_the_tail_bound_knows_of_bodies(dataset: LightingDataset) -> None:
    transport = dataset.transport
    gather, within = transport.sample_gather(), transport.sample_scattering()
    albedo = transport.samples.albedo.astype(np.float32)
    with_bodies, without = (tail_bounds(gather, albedo, 6, part) for part in (within, None))
    assert np.all(with_bodies[:4] > without[:4])
    assert dataset.metadata["bounces"] >= 4


def test_coarser_samples_and_nodes_give_nearly_the_same(tmp_path: Path) -> None:
    light = Lighting([DirectionalLight([-0.3, -1.0, 0.4], (1.0, 1.0, 1.0))])
    found = []
    for settings in ({}, {"gather_texels": 24, "node_rays": 32}):
        transport = traced(room(), tmp_path, texels=32, **settings)
        assert (transport.nodes is None) == (not settings)
        direct = direct_irradiance(Tracer(room()), transport.samples, emitters([light]))
        albedo = jnp.asarray(transport.samples.albedo, jnp.float32)
        found.append(np.asarray(indirect_light(transport, jnp.asarray(direct), albedo)))
    whole, other = found
    assert 0 < np.linalg.norm(other - whole) < 0.3 * np.linalg.norm(whole)
    assert other.mean() == pytest.approx(whole.mean(), rel=0.05)


def test_fixed_light_says_that_it_does_not_enter_bodies(dataset: LightingDataset) -> None:
    with pytest.raises(SpecError, match="translucent bodies, which bounces of fixed light do not enter"):
        bounced_transfer(dataset.transport, np.ones((4, 3)), 1)
