"""What is not there costs nothing; what is, is planned, stored and read again."""

import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import prt_bench as prt
from data_gen import trace as trace_module
from data_gen.effects import subsurface
from data_gen.gather import PROBES
from data_gen.trace import transport_key
from prt_bench.errors import SceneError
from prt_bench.store import read_scene, write_scene
from tests.data_gen.ball import BALL, BLACK, MEDIUM, SMALL, room, traced


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
        for name in ("follow_all", "bodies", "write_walks", "WalkTracer", "check_closed", "predicted_events"):
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


def test_walks_are_predicted_from_some_of_them(tmp_path: Path) -> None:
    """As many ray queries as the bake counts, and fewer where the body only absorbs."""
    ds = prt.bake(room(), **SMALL, out=tmp_path)
    lit, walks = ds.metadata, ds.transport.walks
    assert walks is not None
    rates = subsurface.measured_rates(room(), 1)
    assert rates.channels == 3
    around = lit["actual"]["gather_rays"] - len(ds.points) * (SMALL["rays"] + PROBES)
    per_start = around / (len(walks.receivers.rows) * SMALL["rays"])
    assert rates.queries / rates.share == pytest.approx(per_start, rel=0.1)
    assert lit["predicted"]["gather_rays"] == pytest.approx(lit["actual"]["gather_rays"], rel=0.4)
    black = subsurface.measured_rates(room(replace(MEDIUM, scattering=(0.0,) * 3)), 1)
    assert black.queries < 0.7 * rates.queries


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
