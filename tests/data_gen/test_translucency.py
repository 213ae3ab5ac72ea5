"""Translucent scenes from end to end: the operator against the path tracer, in every method and frame; and scenes without."""

import re
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import prt_bench as prt
from data_gen import journal
from data_gen import trace as trace_module
from data_gen.direct import direct_irradiance
from data_gen.effects import subsurface
from data_gen.geometry import assemble, quad, solid
from data_gen.medium_walk import Fate
from data_gen.reference import indirect_irradiance, leaving_light
from data_gen.trace import trace, transport_key
from data_gen.tracer import Tracer
from prt_bench.chain import indirect_light
from prt_bench.dataset import LightingDataset, Transport
from prt_bench.errors import SceneError, SpecError
from prt_bench.lights import DirectionalLight, Lighting, PointLight, emitters
from prt_bench.medium import Subsurface
from prt_bench.methods import neural_transfer
from prt_bench.methods.interreflection import bounced_transfer
from prt_bench.methods.operator import importance, respond
from prt_bench.scene import Camera, Material, Scene
from prt_bench.store import read_scene, write_scene
from prt_bench.transport import tail_bounds
from tests.oracles.operator_light import squared_error

GROUND, WALL, BALL = range(3)
BLACK = (0.0, 0.0, 0.0)
MEDIUM = Subsurface.of_albedo((0.97, 0.95, 0.85), (0.1, 0.12, 0.2), 0.3, 1.3)
SMALL = {"scenario": "point", "lightings": 10, "texels": 24, "rays": 32, "measurements": 24, "supersampling": 2}
LAMP = Lighting([PointLight([0.3, 0.9, -1.0], (3.0, 2.0, 1.0), 0.0)])


def room(medium: Subsurface | None = MEDIUM, albedo: tuple[float, float, float] = BLACK) -> Scene:
    """A ball of radius 0.4 over the ground beside a wall."""
    ball = solid(trimesh.creation.icosphere(subdivisions=2, radius=0.4), BALL)
    parts = [
        quad([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], GROUND),
        quad([(-1, 0, 1), (-1, 0, -1), (-1, 1, -1), (-1, 1, 1)], WALL),
        ball.transformed(np.eye(3), (-0.1, 0.45, 0.0)),
    ]
    materials = (
        Material("ground", (0.6, 0.6, 0.6)),
        Material("wall", (0.7, 0.2, 0.1)),
        Material("ball", albedo, subsurface=medium),
    )
    return Scene("ball", assemble(parts), materials, Camera((0.6, 0.9, 2.6), (-0.1, 0.4, 0.0)))


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


def traced(scene: Scene, folder: Path, **settings: int) -> Transport:
    return trace(scene, prt.plan(scene, **{"texels": 24, "rays": 32, **settings}), 0, folder, Tracer(scene))


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


ORACLES = ("projection", "reference")
QUICK = {
    "mlp-coefficients": {"epochs": 2},
    "mlp-decoder": {"epochs": 2},
    "linear-finetuned": {"epochs": 2},
    "neural-transfer": {"steps": 50},
}


@pytest.mark.parametrize("name", sorted(prt.methods()))
def test_every_method_runs_without_knowing(dataset: LightingDataset, name: str, tmp_path: Path) -> None:
    """Fit, predict, evaluate; and what is exported says the same."""
    model = prt.method(name, **QUICK.get(name, {})).fit(dataset.split("train"), jax.random.key(0))
    test = dataset.split("test")
    predicted = np.asarray(model.predict(test))
    assert predicted.shape == test.indirect.shape
    assert np.all(np.isfinite(predicted))
    error = prt.evaluate(model, test).errors.relative_rmse
    assert error is not None
    assert 0 <= error < np.inf
    if name not in ORACLES:
        again = np.asarray(prt.load_asset(model.export(tmp_path / "asset").path).predict(test))
        assert np.linalg.norm(again - predicted) <= 1e-3 * np.linalg.norm(predicted)


def test_a_network_is_taught_what_textures_hold(dataset: LightingDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """All light as receivers show it, not direct light at full."""
    taught = []

    def keep(position: object, normal: object, vectors: np.ndarray, *rest: object) -> None:
        taught.append(np.asarray(vectors))
        raise InterruptedError

    monkeypatch.setattr(neural_transfer, "fit_transfer", keep)
    train = dataset.split("train")
    with pytest.raises(InterruptedError):
        prt.method("neural-transfer").fit(train)
    np.testing.assert_array_equal(taught[0], prt.method("sh-texture").fit(train).basis)


def test_frames_show_light_times_colour(dataset: LightingDataset) -> None:
    """(ρ E_dir + κ y) / π on the ball, ρ (E_dir + y) / π elsewhere."""
    from prt_bench.errors import RuntimeUnavailable
    from prt_bench.runtime import Runtime

    try:
        runtime = Runtime(dataset, (64, 48))
    except RuntimeUnavailable as reason:
        pytest.skip(str(reason))
    assert dataset.transport.walks is not None
    even = runtime.lightmap(np.ones((len(dataset.points), 3), np.float32))
    frame = runtime.frame(LAMP, even, direct=False)
    colours = [dataset.transport.walks.colour[BALL], np.full(3, 0.6), np.array((0.7, 0.2, 0.1))]
    pixels = frame.reshape(-1, 3)
    distance = [np.abs(pixels - np.asarray(colour) / np.pi).max(axis=1) < 1e-5 for colour in colours]
    assert all(each.sum() > 20 for each in distance)
    assert np.all(np.any(distance, axis=0) | (pixels.max(axis=1) < 1e-6))
    assert runtime.frame(LAMP)[24, 30].max() == 0  # alone, direct light leaves the ball black


def preprocessed(text: str, defined: set[str]) -> str:
    """What is left of a shader after `#ifdef`, `#else` and `#endif`."""
    kept, states = [], []
    for line in text.splitlines():
        if match := re.match(r"\s*#(ifdef|else|endif)\s*(\w*)", line):
            kind, name = match.groups()
            if kind == "ifdef":
                states.append(name in defined)
            elif kind == "else":
                states[-1] = not states[-1]
            else:
                states.pop()
        elif all(states):
            kept.append(line)
    return "\n".join(kept)


class TestAbsent:
    """A scene without media pays nothing for them."""

    def test_hashes_and_keys_are_those_of_before(self) -> None:
        for name, scene_hash, key in (
            ("cornell", "2e242a587a4febf7b0e7280978d03914a329e655214e24712faa4ed150ba2560", "ce7bac8e1ed5"),
            ("room", "38b24650561e7d9e69c3bee65f88cb1cf328e3286998d013bd034f258bf2e54b", "180c65c97a1e"),
            ("furnace", "4dfab40a5df5fe4fb1509fac1f2dd069a80ef36ce029848b9c41178c3e1d3643", "543994c58e96"),
        ):
            scene = prt.load_scene(name)
            assert scene.hash == scene_hash
            assert transport_key(scene, prt.plan(scene, texels=24, rays=32), 0) == key
        assert room().hash != room(None).hash
        assert room().hash != room(replace(MEDIUM, ior=1.31)).hash

    def test_nothing_is_traced_stored_or_decided(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: object, **__: object) -> None:
            raise AssertionError("a scene without media asked for walks")

        assert "subsurface" in str(prt.plan(room()).to_json())
        for name in ("follow", "bodies", "write_walks", "WalkTracer", "check_closed", "predicted_events"):
            monkeypatch.setattr(subsurface, name, refuse)
        for name in ("write_walks", "WalkTracer"):
            monkeypatch.setattr(trace_module, name, refuse)
        scene = room(None)
        ds = prt.bake(scene, **SMALL, out=tmp_path)
        assert ds.transport.walks is None
        assert ds.transport.sample_scattering() is None
        assert ds.transport.receiver_scattering() is None
        assert not [path for path in tmp_path.rglob("*") if "walks" in path.name]
        assert ds.metadata["effects"] == []
        assert not any("subsurface" in str(row) for row in ds.metadata["plan"])
        np.testing.assert_array_equal(ds.shown_direct, ds.direct)

    def test_the_bake_is_bit_identical_where_the_operator_has_no_media(self, tmp_path: Path) -> None:
        """The solver with `scattering=None` is the solver that has never heard of it."""
        transport = traced(room(None), tmp_path)
        gather, albedo = transport.sample_gather(), jnp.asarray(transport.samples.albedo, jnp.float32)
        light = jnp.asarray(np.random.default_rng(0).random((2, len(albedo), 3)), jnp.float32)
        from prt_bench.transport import radiosity

        text = radiosity.lower(gather, albedo, light, 3).as_text()
        assert "scatter" not in text.replace("scatter_dimension", "")
        by_hand = jnp.zeros_like(jnp.moveaxis(light, 0, 1))
        for _ in range(3):
            out = albedo[:, None] * (jnp.moveaxis(light, 0, 1) + by_hand)
            by_hand = gather(out.reshape(len(albedo), -1)).reshape(out.shape)
        expected = albedo[:, None] * (jnp.moveaxis(light, 0, 1) + by_hand)
        np.testing.assert_allclose(radiosity(gather, albedo, light, 3), expected, rtol=1e-6)

    def test_the_shader_has_no_instruction_for_it(self) -> None:
        for name in ("draw.vert", "draw.frag"):
            text = (Path(__file__).parents[2] / "shaders" / name).read_text(encoding="utf-8")
            code = re.sub(r"//.*", "", text)
            every = set(re.findall(r"#ifdef\s+(\w+)", code))
            assert "colour" in preprocessed(code, every)
            assert "colour" not in preprocessed(code, every - {"TRANSLUCENT"})


def test_the_plan_says_what_and_why() -> None:
    rows = {row["what"]: row for row in prt.plan(room(), texels=64, rays=64).to_json()}
    assert rows["effects"]["decision"] == "diffuse, subsurface"
    assert "'ball' is filled" in rows["effects"]["why"]
    assert rows["subsurface"]["decision"] == "64 walks per point and channel"
    grey = prt.plan(room(replace(MEDIUM, scattering=(9.0,) * 3, absorption=(1.0,) * 3)), texels=64, rays=64)
    assert {row["what"]: row["decision"] for row in grey.to_json()}["subsurface"] == "64 walks per point and channel"
    with_media, without = (prt.plan(scene, texels=64, rays=64).cost for scene in (room(), room(None)))
    assert with_media.gather_rays > without.gather_rays
    assert with_media.disk_bytes > without.disk_bytes


def test_predicted_rays_bound_what_walks_take(tmp_path: Path) -> None:
    transport = traced(room(), tmp_path)
    assert transport.walks is not None
    walks = sum(np.sum(counts) for counts in transport.walks.fates["ball"].values())
    predicted = subsurface.predicted_events(room(), BALL)
    assert predicted > 3
    assert prt.plan(room(), texels=24, rays=32).cost.gather_rays > walks


def test_a_scene_survives_the_store(tmp_path: Path) -> None:
    import zarr

    group = zarr.open_group(tmp_path / "scene.zarr", mode="a")
    write_scene(group, room())
    again = read_scene(group)
    assert again.materials[BALL].subsurface == MEDIUM
    assert again.hash == room().hash


def test_a_scene_file_names_a_medium(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    head = 'mesh = "ball.ply"\n[materials.{name}.subsurface]\n'
    plain = prt.load_scene(tmp_path / "ball.ply")
    head = head.format(name=plain.materials[0].name)
    (tmp_path / "a.toml").write_text(head + "albedo = [0.9, 0.8, 0.7]\nmean_free_path = [0.1, 0.1, 0.1]\nior = 1.5\n")
    scene = prt.load_scene(tmp_path / "a.toml")
    medium = scene.materials[0].subsurface
    assert medium is not None
    np.testing.assert_allclose(medium.albedo, (0.9, 0.8, 0.7))
    assert scene.materials[0].albedo == BLACK
    for body, message in (
        ("albedo = [0.9, 0.8, 0.7]\n", "needs scattering and absorption, or albedo and mean_free_path"),
        ("scatering = [1, 1, 1]\n", "did you mean 'materials.*scattering'"),
        ("scattering = [1, 1, 1]\nabsorption = [0, 0, 0]\nior = 9.0\n", "ior 9.0"),
        ('scattering = [1, 1, 1]\nabsorption = [0, 0, 0]\nior = "a"\n', "must be a number"),
    ):
        (tmp_path / "b.toml").write_text(head + body)
        with pytest.raises(SceneError, match=message):
            prt.load_scene(tmp_path / "b.toml")


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
