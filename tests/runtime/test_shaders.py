"""Effects are compiled out, includes are pasted once, and the device is named and judged."""

import moderngl
import pytest

from prt_bench.errors import RuntimeUnavailable, SpecError
from prt_bench.lights import Lighting, PointLight
from prt_bench.runtime import context, is_software, shaders, time_assets
from prt_bench.timing import interleaved, time_stages

from .conftest import linear_model, nearest_model, quad_dataset

pytestmark = pytest.mark.gl

LAMP = Lighting([PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0))])
COMMON = {"SHADED": 1, "DEPTH_OFFSET": "0.0", "SURFACE_END": "1.0", "RAY_OFFSET": "0.0", "ATLAS_SIZE": "64.0"}


def active(gl: moderngl.Context, **defines: int) -> set[str]:
    """Names of what the linked draw program reads."""
    return set(shaders.program(gl, "draw.vert", "draw.frag", {**COMMON, **defines}))


def test_what_a_frame_does_not_use_is_compiled_out(gl):
    indirect = {"INDIRECT": 1, "RECONSTRUCT_BASIS": 1, "LAYERS": 4, "COEFFICIENTS": 16}
    assert {"basis", "shadow_atlas"} <= active(gl, DIRECT=1, SHADOWS=1, **indirect)
    baseline = active(gl, DIRECT=1, SHADOWS=1)
    assert "shadow_atlas" in baseline
    assert not {"basis", "Coefficients", "in_lightmap_uv"} & baseline
    assert "shadow_atlas" not in active(gl, DIRECT=1, **indirect)
    assert not {"Emitters", "Views", "in_normal"} & active(gl, **indirect)


def test_includes_are_pasted_once():
    text = shaders.source("draw.frag", {"DIRECT": 1})
    assert text.startswith("#version 430 core\n#define DIRECT 1\n")
    assert "#include" not in text
    assert text.count("struct Emitter {") == text.count("struct View {") == 1


def test_renderers_are_told_apart():
    assert is_software("llvmpipe (LLVM 15.0.6, 256 bits)")
    assert not is_software("NVIDIA H100 80GB HBM3/PCIe/SSE2")


def test_no_opengl_is_one_sentence_with_a_remedy(monkeypatch):
    def fails(**_: object) -> None:
        raise Exception("libEGL.so not loaded")

    monkeypatch.setattr(context.moderngl, "create_context", fails)
    with pytest.raises(RuntimeUnavailable, match="apt-get install libegl1"):
        context.headless.__wrapped__()


def test_errors_of_the_driver_do_not_pass_unnoticed(gl):
    gl.enable_direct(0xFFFF)
    with pytest.raises(RuntimeError, match="GL_INVALID_ENUM during a test"):
        context.check(gl, "a test")
    context.check(gl, "a test")


def test_rounds_are_interleaved_and_warm_up_is_not_counted():
    calls = []

    def clock(work: str) -> float:
        calls.append(work)
        return float(len(calls))

    stages = interleaved({"a": "a", "b": "b"}, clock, rounds=3, warmup=1)
    assert calls == ["a", "b", "b", "a", "a", "b", "b", "a"]
    assert (stages["a"].median, stages["a"].iqr, stages["a"].rounds) == (5.0, 2.0, 3)
    with pytest.raises(SpecError, match="at least one round"):
        interleaved({"a": "a"}, clock, rounds=0, warmup=1)


def test_timings_name_their_stages(runtime, cornell, export, tmp_path):
    from dataclasses import replace

    from prt_bench.assets import write_asset

    assets = {
        "linear": write_asset(linear_model(cornell, 4), tmp_path / "linear"),
        "nearest": write_asset(nearest_model(cornell, 8), tmp_path / "nearest"),
    }
    found = time_assets({name: runtime.load(asset) for name, asset in assets.items()}, LAMP, rounds=2, warmup=1)
    assert list(found) == ["linear", "nearest"]
    for timings in found.values():
        assert [timing.clock for timing in timings] == (["wall"] if runtime.software else ["wall", "timer-query"])
        (timing, *_) = timings
        assert list(timing.stages) == ["shadow", "measure", "transfer", "draw", "frame"]
        assert timing.baseline is not None
        assert all(stage.median > 0 and stage.rounds == 2 for stage in (*timing.stages.values(), timing.baseline))
        assert (timing.device, timing.resolution) == (runtime.device, runtime.size)
    assert found["linear"][0].baseline == found["nearest"][0].baseline

    lit = replace(quad_dataset(cornell.scene), all_lightings=(LAMP,), rows=(0, 1))
    in_jax = time_stages(assets, lit, rounds=2, warmup=1)
    assert all(list(timing.stages) == ["measure", "transfer", "reconstruct"] for timing in in_jax.values())
