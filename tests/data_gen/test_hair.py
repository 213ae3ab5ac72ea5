"""Light among strands: the furnace, energy, halves, scales, one strand, the adjoint, methods, and what is refused."""

import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import prt_bench as prt
from data_gen import journal
from data_gen.effects import hair as effect
from data_gen.geometry import Part, assemble, box, solid
from data_gen.hair_paths import Fate, StrandPaths
from data_gen.medium_walk import walk_keys
from data_gen.resolve import HitResolver
from data_gen.strand_atlas import points_with_strands, unwrap_with_strands
from data_gen.strands import with_strands, without_strands
from data_gen.tracer import Tracer
from prt_bench.dataset import LightingDataset
from prt_bench.environment import EnvironmentMap
from prt_bench.errors import SceneError, SpecError
from prt_bench.evaluate import evaluate
from prt_bench.hair import Hair
from prt_bench.medium import Subsurface
from prt_bench.methods.operator import importance, respond
from prt_bench.scene import Material, Scene
from prt_bench.strands import Strands
from tests.data_gen.test_absent_effect import preprocessed
from tests.data_gen.tuft import FIBRES, GROUND, WHITE, tuft

BROWN = (0.1, 0.25, 0.6)
SMALL = {"scenario": "point", "lightings": 6, "texels": 64, "rays": 32, "measurements": 32}


def baked(scene: Scene, folder: Path, **settings: object) -> LightingDataset:
    return prt.bake(scene, **{**SMALL, **settings}, out=folder)  # pyright: ignore


def followed(scene: Scene, texels: int = 200, paths: int = 64, workers: int = 2) -> tuple[StrandPaths, object]:
    side = 64
    lightmap = unwrap_with_strands(scene, side)
    points = points_with_strands(scene, lightmap)
    tracer = Tracer(scene, workers)
    assert scene.strands is not None
    walker = StrandPaths(scene, scene.strands, tracer, HitResolver.create(scene.mesh, lightmap, points), 3)
    texel = np.arange(min(texels, 10 * len(scene.strands)))
    return walker, walker.follow(np.repeat(texel, paths), walk_keys(texel, paths, 0).ravel())


@pytest.fixture(scope="module")
def brown(tmp_path_factory: pytest.TempPathFactory) -> LightingDataset:
    return baked(tuft(Hair(BROWN), 120, ground=True), tmp_path_factory.mktemp("brown"))


@pytest.mark.parametrize("hair", [Hair(WHITE, variance=0.001, ior=2.5), Hair(WHITE, ior=1.0)])
def test_white_hair_disappears_in_a_white_furnace(hair: Hair, tmp_path: Path) -> None:
    """Light that is the same everywhere stays so among fibres that absorb nothing: direct and indirect add up to π L."""
    ds = baked(tuft(hair, 200), tmp_path, texels=64, rays=64, lightings=1)
    assert ds.transport.walks is not None
    fates = ds.transport.walks.fates["hair"]
    assert sum(map(sum, (counts for name, counts in fates.items() if name != "escaped"))) == 0
    sky = prt.EnvironmentLight(EnvironmentMap("white", np.ones((8, 16, 3), np.float32)))
    lit = prt.light(ds, [prt.Lighting([sky])])
    total = (lit.direct + lit.indirect)[0, :, 0] / np.pi
    assert total.mean() == pytest.approx(1.0, abs=0.05)
    assert np.mean(np.abs(total - 1.0)) < 0.15  # noise of 64 paths, and of the 64 suns that stand for the sky
    assert lit.direct.mean() < 0.6 * np.pi


def test_paths_lose_what_fibres_absorb() -> None:
    """Where no other fibre is near, a path ends as one event says: absorbed with 1 less the albedo, else escaped."""
    hair = Hair(BROWN)
    scene = tuft(hair, 1)
    _, found = followed(scene, paths=6000)
    share = np.mean(found.fate == Fate.ESCAPED, axis=0)  # pyright: ignore
    np.testing.assert_allclose(share, hair.albedo, atol=0.01)


def test_energy_is_accounted_for_and_colours_share_paths() -> None:
    _, found = followed(tuft(Hair(BROWN), 120, ground=True))
    fate, visits = found.fate, found.visits  # pyright: ignore
    assert np.all((fate == Fate.ESCAPED) | (fate == Fate.ABSORBED) | (fate == Fate.SURFACE))
    absorbed = np.mean(fate == Fate.ABSORBED, axis=0)
    assert absorbed[0] < absorbed[1] < absorbed[2]
    assert np.all(visits.passed[:, 0] | ~visits.passed[:, 1:].any(axis=1))  # red is absorbed least
    assert np.all(np.isin(np.flatnonzero(fate[:, 0] == Fate.SURFACE), visits.path[visits.surface]))


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_paths_are_the_same_at_every_scale(scale: float) -> None:
    here, there = (followed(tuft(Hair(BROWN), 60, factor, ground=True), 100, 32)[1] for factor in (1.0, scale))
    same = np.mean(here.fate == there.fate)  # pyright: ignore
    assert same > 0.97  # rounding turns some paths elsewhere
    shares = [np.mean(part.fate == Fate.ESCAPED) for part in (here, there)]  # pyright: ignore
    assert shares[0] == pytest.approx(shares[1], abs=0.01)


def test_paths_do_not_depend_on_workers() -> None:
    one, two = (followed(tuft(Hair(BROWN), 80), workers=workers)[1] for workers in (1, 2))
    np.testing.assert_array_equal(one.fate, two.fate)  # pyright: ignore
    np.testing.assert_array_equal(one.visits.sample, two.visits.sample)  # pyright: ignore


def test_direct_light_on_a_fibre_is_the_mean_around_it(tmp_path: Path) -> None:
    """sin(t, ω)/π of the irradiance across the light, on a strand that nothing shadows."""
    nodes = np.array([(0.0, -0.5, 0.0), (0.0, 0.5, 0.0)])
    bare = without_strands(tuft(Hair(WHITE), 1))
    scene = with_strands(bare, Strands(nodes, np.array([0, 2]), np.array([0.02]), np.array([FIBRES])))
    ds = baked(scene, tmp_path, texels=16, lightings=1, measurements=4)
    for direction in ((1.0, 0.0, 0.0), (0.3, -1.0, 0.2), (0.0, 1.0, 0.0)):
        lit = prt.light(ds, [prt.Lighting([prt.DirectionalLight(direction, (2.0, 2.0, 2.0))])])
        sine = np.hypot(direction[0], direction[2]) / np.linalg.norm(direction)
        np.testing.assert_allclose(lit.direct[0], 2.0 * sine / np.pi, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(lit.indirect, 0.0, atol=1e-6)  # a straight strand does not see itself


def test_what_is_stored(brown: LightingDataset) -> None:
    walks = brown.transport.walks
    assert walks is not None
    assert walks.receivers is walks.samples
    fibre = brown.points.clearance > 0  # pyright: ignore
    assert np.array_equal(walks.samples.rows, np.flatnonzero(fibre))
    np.testing.assert_allclose(walks.colour[FIBRES], brown.scene.materials[FIBRES].albedo, rtol=1e-6)
    assert brown.metadata["effects"] == ["hair"]
    assert np.all(np.asarray(brown.transport.receiver_hits[:])[fibre] == len(brown.transport.samples))
    assert brown.indirect[:, fibre].mean() > 0
    assert brown.indirect[:, ~fibre].mean() > 0  # the ground sees the hair
    np.testing.assert_array_equal(brown.shown_direct, brown.direct)
    again = LightingDataset.open(brown.path)  # pyright: ignore
    np.testing.assert_array_equal(again.points.clearance, brown.points.clearance)


def test_a_bake_that_stops_while_it_looks_for_the_sky_goes_on_to_the_same_bits(
    brown: LightingDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(effect, "_LOOKING", 400)
    add, done = journal.Journal.add, []

    def add_then_stop(self: journal.Journal, chunk: int, **entry: object) -> None:
        add(self, chunk, **entry)
        done.append(chunk)
        if len(done) == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(journal.Journal, "add", add_then_stop)
        with pytest.raises(KeyboardInterrupt):
            baked(brown.scene, tmp_path)
    again = baked(brown.scene, tmp_path)
    assert again.metadata["actual"]["resumed"]
    assert again.metadata["actual"]["shadow_rays"] < brown.metadata["actual"]["shadow_rays"]
    np.testing.assert_array_equal(again.indirect, brown.indirect)


def test_the_halves_are_estimates_of_their_own(brown: LightingDataset) -> None:
    transport = brown.transport
    light = jnp.ones((len(transport.samples), 1, 3), jnp.float32)
    both, first, second = (transport.sample_scattering(half)(light) for half in (None, 0, 1))  # pyright: ignore
    np.testing.assert_allclose(both, 0.5 * (first + second), rtol=1e-5, atol=1e-7)
    assert float(jnp.mean(jnp.abs(first - second))) > 0


def test_the_adjoint_is_that_of_the_operator(brown: LightingDataset) -> None:
    rng = np.random.default_rng(0)
    albedo = jnp.asarray(brown.transport.samples.albedo, jnp.float32)
    direct = rng.random((len(albedo), 2)).astype(np.float32)
    u = rng.normal(size=(len(brown.points), 3))
    forward = np.einsum("tcn,tb->cnb", respond(brown.transport, albedo, direct), u)
    backward = np.einsum("sn,csb->cnb", direct, importance(brown.transport, albedo, jnp.asarray(u)))
    np.testing.assert_allclose(forward, backward, rtol=2e-3, atol=1e-3 * np.abs(forward).max())


@pytest.mark.parametrize("name", ["svd-ridge", "operator-ridge", "mean"])
def test_methods_run_without_knowing_of_hair(brown: LightingDataset, name: str) -> None:
    model = prt.method(name).fit(brown.split("train"))
    record = evaluate(model, brown.split("test"))
    assert record.status == "ok"
    assert np.isfinite(record.errors.rmse)  # pyright: ignore


def test_transfer_vectors_refuse_hair(brown: LightingDataset) -> None:
    with pytest.raises(SpecError, match="has hair, which transfer vectors do not know"):
        prt.method("sh-texture").fit(brown.split("train"))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"gather_texels": 32}, "gather samples; leave gather_texels out"),
        ({"vertices": True}, "no vertices of its own"),
        ({"mips": 1}, "cannot be halved"),
        ({"texels": 16}, "ask for"),
    ],
)
def test_settings_that_hair_does_not_have_are_refused(settings: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises((SceneError, SpecError), match=message) as error:
        baked(tuft(Hair(), 120, ground=True), tmp_path, **settings)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_the_plan_says_what_hair_costs() -> None:
    with_hair = prt.plan(tuft(Hair(), 120, ground=True), texels=64, rays=32)
    without = prt.plan(without_strands(tuft(Hair(), 120, ground=True)), texels=64, rays=32)
    rows = {row["what"]: row for row in with_hair.to_json()}
    assert rows["effects"]["decision"] == "diffuse, hair"
    assert "120 strands of 10 texels" in rows["hair"]["why"]
    assert not any("hair" in str(row) for row in without.to_json())
    assert with_hair.cost.shadow_rays > without.cost.shadow_rays
    black = replace(Hair(), absorption=(1e3, 1e3, 1e3))
    assert prt.plan(tuft(black, 120), texels=64, rays=32).cost.gather_rays < with_hair.cost.gather_rays


def test_predicted_rays_are_those_that_were_traced(brown: LightingDataset) -> None:
    """Paths are followed to count their rays, and light is measured at strands for each of its uses."""
    predicted, actual = brown.metadata["predicted"], brown.metadata["actual"]
    assert actual["gather_rays"] == pytest.approx(predicted["gather_rays"], rel=0.25)
    assert actual["shadow_rays"] == pytest.approx(predicted["shadow_rays"], rel=0.35)


def test_black_walls_around_hair_change_nothing_between_fibres(tmp_path: Path) -> None:
    """Paths out of the hair see the light that comes in there, whether they go on to the sky or to a wall."""
    alone = tuft(Hair(BROWN), 60)
    assert alone.strands is not None
    walls = box((2.0, 2.0, 2.0), GROUND)
    mesh = assemble([Part(walls.vertices, walls.faces[:, ::-1], GROUND)])
    black = Material("wall", (0.0, 0.0, 0.0))
    room = replace(without_strands(alone), mesh=mesh, materials=(black, alone.materials[FIBRES]))
    lamp = prt.Lighting([prt.PointLight((1.0, 1.2, 0.8), (1.0, 1.0, 1.0))])
    within, outside = (
        prt.light(baked(scene, tmp_path, lightings=1), [lamp]).indirect[0, -600:]
        for scene in (with_strands(room, alone.strands), alone)
    )
    assert outside.mean() > 0.01
    assert within.mean(axis=0) == pytest.approx(outside.mean(axis=0), rel=0.03)


def test_black_hair_is_dark_and_finite(tmp_path: Path) -> None:
    ds = baked(tuft(Hair((1e6, 1e6, 1e6), ior=1.0), 40, ground=True), tmp_path, lightings=1)
    assert np.all(np.isfinite(ds.indirect))
    fibre = ds.points.clearance > 0  # pyright: ignore
    assert ds.indirect[:, fibre].max() < 1e-3 * ds.direct.max()


def test_a_scene_without_hair_holds_and_compiles_none_of_it(tmp_path: Path) -> None:
    ds = baked(without_strands(tuft(Hair(), 5, ground=True)), tmp_path, lightings=1, measurements=8)
    assert ds.transport.walks is None
    assert ds.points.clearance is None
    assert not [path for path in tmp_path.rglob("*") if re.search("strand|clearance", path.name)]
    for name in ("draw.vert", "draw.frag"):
        text = (Path(__file__).parents[2] / "shaders" / name).read_text(encoding="utf-8")
        code = re.sub(r"//.*", "", text)
        every = set(re.findall(r"#ifdef\s+(\w+)", code))
        assert "fibre" in preprocessed(code, every)
        assert not re.search("fibre|hair", preprocessed(code, every - {"HAIR"}))


def test_hair_on_a_translucent_body(tmp_path: Path) -> None:
    """Skin with a medium under hair: one table for both, and light from the body's inside reaches the strands."""
    ball = solid(trimesh.creation.icosphere(subdivisions=2, radius=0.3), 2)
    medium = Subsurface.of_albedo((0.99, 0.9, 0.8), (0.05, 0.05, 0.05))
    base = tuft(Hair(BROWN), 60, ground=True)
    ground = without_strands(base)
    assert base.strands is not None
    mesh = assemble([Part(ground.mesh.vertices, ground.mesh.faces, 0), ball])
    skin = Material("skin", (0.0, 0.0, 0.0), subsurface=medium)
    scene = with_strands(replace(ground, mesh=mesh, materials=(*ground.materials, skin)), base.strands)
    ds = baked(scene, tmp_path, lightings=1)
    walks = ds.transport.walks
    assert walks is not None
    assert ds.metadata["effects"] == ["subsurface", "hair"]
    assert set(walks.fates) == {"skin", "hair"}
    assert np.all(np.diff(walks.samples.rows) > 0)
    assert set(walks.samples.material) == {FIBRES, 2}
    assert np.all(np.isfinite(ds.indirect))
    owner = ds.scene.mesh.material[ds.points.face]
    # Light on the body alone reaches strands through paths that end on it and go on along its walks.
    light = np.zeros((len(ds.transport.samples), 1, 3), np.float32)
    light[ds.scene.mesh.material[ds.transport.samples.face] == 2] = 1.0
    leaving = np.asarray(ds.transport.sample_scattering()(jnp.asarray(light)))[:, 0]  # pyright: ignore
    on_hair = walks.samples.material == FIBRES
    assert leaving[on_hair].mean() > 0.01
    assert leaving[on_hair, 0].mean() > leaving[on_hair, 2].mean()
    assert ds.indirect[:, owner == 2].mean() > 0
