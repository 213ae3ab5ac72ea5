"""Receivers between nodes: exact where light is linear, refined where it is not, never across an edge, right as a whole."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.lattice import Cells, regions
from data_gen.nodes import Seen, interpolate
from prt_bench.errors import SpecError
from prt_bench.methods.escaping import transfer_vectors
from prt_bench.methods.operator import importance, respond
from prt_bench.points import Lightmap, SurfacePoints

SIDE = 97
SETTINGS = {"lightings": 1, "texels": 80, "gather_texels": 48, "rays": 64, "measurements": 16}
NODES = {"node_rays": 512, "node_tolerance": 0.05}


def two_walls() -> tuple[Lightmap, SurfacePoints]:
    """A round disc and a square in two charts; the square's upper half faces another way."""
    row, column = np.divmod(np.arange(SIDE**2), SIDE)
    disc = np.hypot(row - 48.0, column - 24.0) < 22.0
    square = (column > 55) & (column < 95) & (row > 3) & (row < 90)
    texel = np.flatnonzero(disc | square)
    face = np.where(disc[texel], 0, np.where(row[texel] < 41, 1, 2))
    facing = np.array([(0.0, 0, 1), (0, 1, 0), (1, 0, 0)])[face]
    position = np.column_stack([column[texel], row[texel], np.zeros(len(texel))]) / SIDE
    lightmap = Lightmap(SIDE, texel, np.zeros((3, 3, 2)), np.array([0, 1, 1]))
    return lightmap, SurfacePoints(position, facing, np.full((len(texel), 3), 0.5), face, np.zeros((len(texel), 3)))


def looking(values: np.ndarray, asked: list[int]) -> Callable[[np.ndarray], Seen]:
    """Rays that see `values` [T, F] without noise."""

    def look(chosen: np.ndarray) -> Seen:
        asked.extend(chosen.tolist())
        return Seen(values[chosen], values[chosen], np.zeros((len(chosen), 2)))

    return look


def spread(found, values: np.ndarray) -> np.ndarray:
    return np.einsum("tc,tck->tk", found.weight, values[found.nodes][found.corner])


def test_linear_light_is_exact_from_few_nodes():
    """A row taken for a column, or shares of the wrong end, would miss it."""
    lightmap, points = two_walls()
    values = 1.0 + points.position @ np.array([[1.0, -2.0], [0.3, 1.0], [0.0, 0.0]]) + points.normal[:, :2]
    asked: list[int] = []
    found = interpolate(lightmap, points, np.zeros(len(points), bool), 0.01, looking(values, asked))
    np.testing.assert_allclose(spread(found, values), values, atol=1e-5)
    assert len(found.nodes) < 0.2 * len(points)
    assert sorted(asked) == sorted(set(asked)) == sorted(found.nodes)
    np.testing.assert_allclose(found.weight.sum(axis=1), 1.0, atol=1e-6)


def test_nodes_never_lie_in_another_region():
    """Nor where another body stands; a constant there would be predicted from any node."""
    lightmap, points = two_walls()
    buried = np.hypot(*(points.position[:, :2] - (0.8, 0.7)).T) < 0.05
    found = interpolate(lightmap, points, buried, 0.5, looking(np.ones((len(points), 1)), []))
    used = found.nodes[found.corner]
    assert np.array_equal(points.face[used], np.repeat(points.face[:, None], 4, axis=1))
    assert np.array_equal(buried[used], np.repeat(buried[:, None], 4, axis=1))


def test_an_edge_of_light_is_refined_and_the_rest_is_not():
    lightmap, points = two_walls()
    far = points.position[:, 1] - 0.37 * points.position[:, 0] - 0.3
    values = np.column_stack([1.0 / (1.0 + np.exp(-far * SIDE / 1.5))])  # a penumbra some texels wide
    found = interpolate(lightmap, points, np.zeros(len(points), bool), 0.02, looking(values, []))
    assert np.abs(spread(found, values) - values).max() < 0.04
    near = np.abs(far[found.nodes]) * SIDE < 8
    assert near.mean() > 1.5 * (np.abs(far) * SIDE < 8).mean()
    loose = interpolate(lightmap, points, np.zeros(len(points), bool), 0.3, looking(values, []))
    assert len(loose.nodes) < 0.8 * len(found.nodes)


def test_noise_alone_does_not_ask_for_more_nodes():
    """Where nodes differ by less than their noise, which halves of rays overstate; else every texel would be one."""
    lightmap, points = two_walls()
    rng = np.random.default_rng(0)
    noisy = 1.0 + 0.1 * rng.normal(size=(len(points), 30)) / np.sqrt(30)

    def look(chosen: np.ndarray, known: bool) -> Seen:
        return Seen(noisy[chosen], noisy[chosen], np.full((len(chosen), 2), 0.02 * known))

    count = [
        len(interpolate(lightmap, points, np.zeros(len(points), bool), 0.01, lambda c, k=known: look(c, k)).nodes)
        for known in (True, False)
    ]
    assert count[0] < 0.4 * len(points)
    assert count[1] == len(points)


def test_cells_cover_every_texel_at_every_level():
    lightmap, points = two_walls()
    home = regions(lightmap, points, np.zeros(len(points), bool))
    assert np.array_equal(np.unique(home), [-1, 0, 1, 2])
    cells = Cells.whole(home)
    while True:
        assert np.array_equal(np.unique(cells.texels()[0]), lightmap.texel)
        if cells.small.all():
            break
        cells = cells.halved().occupied()


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory):
    """The room with every texel traced, and with nodes; the former with as many rays, for its own noise not to hide theirs."""
    folder, room = tmp_path_factory.mktemp("data"), prt.load_scene("room")
    plain = prt.bake(room, "directional", **{**SETTINGS, "rays": 512}, out=folder)
    return plain, prt.bake(room, "directional", **SETTINGS, **NODES, out=folder)


def test_light_between_nodes_is_that_of_a_bake_of_all_texels(pair):
    plain, ds = pair
    transport = ds.transport
    assert transport.nodes is not None
    assert len(transport.nodes.points) == transport.receiver_hits.shape[0] < 0.8 * len(ds.points)
    wanted, found = (np.asarray(part.split("test").indirect) for part in pair)
    assert np.linalg.norm(found - wanted) < 0.06 * np.linalg.norm(wanted)
    vectors = [transfer_vectors(part.transport, part.transport.samples.albedo.astype(np.float32), 5) for part in pair]
    for ours, theirs in zip(*reversed(vectors), strict=True):
        assert np.linalg.norm(ours - theirs) < 0.06 * np.linalg.norm(theirs)
    np.testing.assert_array_equal(ds.split("test").direct.shape, plain.split("test").direct.shape)


def test_the_adjoint_is_that_of_the_interpolated_operator(pair):
    """⟨u, 𝒮 d⟩ = ⟨𝒮ᵀ u, d⟩; an adjoint that forgot the shares would weigh nodes alike."""
    transport = pair[1].transport
    rng = np.random.default_rng(0)
    albedo = jnp.asarray(transport.samples.albedo[:, :1], jnp.float32)
    d, u = rng.random((len(transport.samples), 3)), rng.normal(size=(len(transport.receivers), 2))
    forward = np.einsum("tb,tcp->cbp", u, respond(transport, albedo, d.astype(np.float32)))
    backward = np.einsum("csb,sp->cbp", importance(transport, albedo, jnp.asarray(u, jnp.float32)), d)
    np.testing.assert_allclose(backward, forward, rtol=1e-4, atol=1e-4 * np.abs(forward).max())


def test_nodes_resume_and_repeat_to_the_same_bits(pair, tmp_path, monkeypatch):
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("data_gen.trace._write_nodes", stop)
        with pytest.raises(KeyboardInterrupt):
            prt.bake(prt.load_scene("room"), "directional", **SETTINGS, **NODES, out=tmp_path, workers=1)
    again = prt.bake(prt.load_scene("room"), "directional", **SETTINGS, **NODES, out=tmp_path, workers=2)
    assert again.hash == pair[1].hash
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"node_rays": 3}, "even number"),
        ({"node_rays": 64, "node_tolerance": 0.0}, "between 0 and 1"),
        ({"node_rays": 64, "texels": 32, "gather_texels": None}, "are the gather samples"),
    ],
)
def test_what_cannot_be_interpolated_is_refused(change, message):
    with pytest.raises(SpecError, match=message):
        prt.plan(prt.load_scene("room"), "directional", **{**SETTINGS, **change})


def test_a_plan_says_what_is_traced():
    room = prt.load_scene("room")
    table = prt.plan(room, "directional", **SETTINGS, **NODES).table()
    assert "512 rays, at nodes" in table
    assert "all traced" in prt.plan(room, "directional", **SETTINGS).table()
