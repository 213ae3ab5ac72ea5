"""The main job and the command line: what a run leaves, what it takes up again, and what it refuses."""

import errno
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import jax.numpy as jnp
import pytest

from prt_bench import frames, records
from prt_bench import run as run_module
from prt_bench.assets import RuntimeAsset
from prt_bench.cli import main
from prt_bench.dataset import LightingDataset
from prt_bench.errors import AssetError, FitError, RuntimeUnavailable, SpecError
from prt_bench.methods.base import Method
from prt_bench.models import LinearModel
from prt_bench.runtime import context
from prt_bench.runtime import runtime as runtime_module
from prt_bench.spec import RunSpec

SPEC = """
name = "tiny"
scenes = ["cornell"]
[bake]
ood = ["spot"]
lightings = 4
texels = 24
rays = 16
measurements = 16
supersampling = 2
[time]
size = [64, 48]
shadow_resolution = 256
rounds = 1
warmup = 0
[[methods]]
name = "svd-ridge"
basis = [2, 3]
[[methods]]
name = "reference"
"""
LEFT = ("records.jsonl", "report.html", *(f"leaderboard.{kind}" for kind in ("md", "csv", "json", "tex")))


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(SPEC, encoding="utf-8")
    return path


def run_without_gl(spec: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> list[records.Record]:
    def missing(*_: object, **__: object) -> None:
        raise RuntimeUnavailable("no OpenGL here")

    monkeypatch.setattr(frames, "Runtime", missing)
    assert main(["run", str(spec), "--out", str(out)]) == 0
    return records.read(out / "records.jsonl")


def test_a_run_without_opengl_has_jax_timings_and_says_so(
    spec: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    spec.write_text(f"skips = 2\n{SPEC}", encoding="utf-8")
    rows = run_without_gl(spec, out, monkeypatch)
    assert {(row.split, row.label) for row in rows} == {
        (split, label) for split in ("test", "ood-spot") for label in ("svd-ridge b2", "svd-ridge b3", "reference")
    }
    assert all((out / name).is_file() for name in LEFT)
    assert "report.html" in capsys.readouterr().out
    for row in rows:
        if row.method == "reference":
            assert row.status == "oracle"
            assert row.errors.relative_rmse == pytest.approx(row.errors.noise_floor, rel=1e-5)
        else:
            assert row.status == "no-gl"
            assert row.reason == "no OpenGL here"
            assert [timing.api for timing in row.timings] == ["jax"]
            assert row.errors.relative_rmse**2 == pytest.approx(
                row.errors.projection**2 + row.errors.coefficient**2, rel=1e-4
            )

    for row in rows:
        left_out = {skip["name"]: skip for skip in row.dataset["skips"]}
        assert set(left_out) == {"subsurface", "bounces"}
        assert all(skip["error"] <= skip["tolerance"] for skip in left_out.values())
        assert row.dataset["actual"].keys() > row.dataset["predicted"].keys()
    assert "What was left out" in (out / "report.html").read_text(encoding="utf-8")
    before = (out / "records.jsonl").read_bytes()
    assert main(["run", str(spec), "--out", str(out)]) == 0
    assert (out / "records.jsonl").read_bytes() == before  # nothing is measured twice


@dataclass(frozen=True)
class Broken(Method):
    name: ClassVar[str] = "broken"
    summary: ClassVar[str] = "fails"
    citation: ClassVar[str] = "none"

    how: str = "refuses"

    def fit(self, ds: LightingDataset, key: object = None) -> LinearModel:
        if self.how == "refuses":
            raise FitError("this data cannot be fitted")
        if self.how == "trips":
            raise KeyError("a slip of a plug-in")
        if self.how == "dawdles":
            time.sleep(60)
        return LinearModel(jnp.full((len(ds.points), 1), jnp.nan), jnp.zeros((1, 1, ds.measured.shape[1] + 1)))


@pytest.mark.parametrize(
    ("how", "status", "reason"),
    [
        ("refuses", "failed", "this data cannot be fitted"),
        ("trips", "failed", "a slip of a plug-in"),
        ("gives nonsense", "failed", "weights 'basis' are not finite"),
        ("dawdles", "timeout", "more than 2 s"),
    ],
)
def test_a_failing_method_is_a_row_with_its_reason(
    how: str,
    status: str,
    reason: str,
    spec: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = run_module.method
    if how == "dawdles":
        spec.write_text("timeout = 2\n" + SPEC.replace("basis = [2, 3]", "basis = 2"), encoding="utf-8")
    broken = Broken(how)
    monkeypatch.setattr(run_module, "method", lambda name, **s: broken if s.get("basis") == 2 else found(name, **s))
    rows = run_without_gl(spec, tmp_path / "out", monkeypatch)
    failed = [row for row in rows if row.method == "broken"]
    assert {row.split for row in failed} == {"test", "ood-spot"}
    assert {row.status for row in failed} == {status}
    assert reason in (failed[0].reason or "")
    assert {row.method for row in rows} >= {"reference"}
    assert ("Traceback" in capsys.readouterr().err) == (how == "trips"), "a slip is shown where it happened"


@pytest.mark.gl
def test_an_asset_that_the_runtime_cannot_hold_is_timed_in_jax_alone(
    spec: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = runtime_module.Runtime.load

    def load_small_ones(self: runtime_module.Runtime, asset: RuntimeAsset) -> object:
        if asset.arrays["basis"].shape[1] > 2:
            raise AssetError("3 basis functions are too many")
        return load(self, asset)

    try:
        context.headless()
    except RuntimeUnavailable as error:
        pytest.skip(str(error))
    monkeypatch.setattr(runtime_module.Runtime, "load", load_small_ones)
    assert main(["run", str(spec), "--out", str(tmp_path / "out")]) == 0
    rows = {row.label: row for row in records.read(tmp_path / "out" / "records.jsonl") if row.split == "test"}
    assert [timing.api for timing in rows["svd-ridge b2"].timings][-2:] == ["gl", "jax"]
    assert rows["svd-ridge b2"].status == "ok"
    assert rows["svd-ridge b3"].status == "no-gl"
    assert rows["svd-ridge b3"].reason == "3 basis functions are too many"
    assert [timing.api for timing in rows["svd-ridge b3"].timings] == ["jax"]
    assert rows["svd-ridge b3"].errors.flip is not None


def test_a_folder_with_something_else_is_left_alone(
    spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years of work", encoding="utf-8")
    assert main(["run", str(spec), "--out", str(tmp_path / "out")]) == 2
    assert "is not a prt-bench run" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("lightings = 4", "lightngs = 4"), "[bake] has the unknown key 'lightngs'; did you mean 'lightings'?"),
        (("lightings = 4", 'lightings = "many"'), "key 'lightings' is 'many', but must be an integer"),
        (('scenes = ["cornell"]', ""), "lacks the key 'scenes'"),
        (('scenes = ["cornell"]', "scenes = []"), "names no scenes"),
        (('scenes = ["cornell"]', 'scenes = "cornell"'), "key 'scenes' is 'cornell', but must be a list"),
        (("rounds = 1", "rounds = 0"), "[time]: rounds is 0, but must be at least 1"),
        (("size = [64, 48]", "size = [64, 0]"), "[time]: size is (64, 0), but must be at least 16"),
        (('name = "tiny"', 'name = "tiny"\ntimeout = 0'), "timeout is 0 s"),
        (('name = "tiny"', 'name = "tiny"\nseed = -1'), "seed is -1"),
        (("lightings = 4", "lightings = 0"), "lightings is 0"),
        (('ood = ["spot"]', 'ood = ["spott"]'), "unknown scenario 'spott'; did you mean 'spot'"),
        (('scenes = ["cornell"]', 'scenes = ["cornell", "cornell"]'), "two scenes are called 'cornell'"),
        (("basis = [2, 3]", "basis = [2, 2]"), "two methods are called 'svd-ridge b2'"),
        (("[bake]", "[bake]\nscenarios = []"), "names no scenarios"),
        (("basis = [2, 3]", "bases = 3"), "has no setting 'bases'"),
        (('name = "svd-ridge"', 'name = "svd-rigde"'), "svd-ridge"),
        (('name = "svd-ridge"', 'storage = "float8"\nname = "svd-ridge"'), "storage 'float8'"),
        (('scenes = ["cornell"]', 'scenes = ["cornel"]'), "did you mean 'cornell'"),
        (("[bake]", "[bake"), "is not valid TOML"),
    ],
)
def test_a_bad_specification_is_one_sentence_and_status_2(
    spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], words: str
) -> None:
    spec.write_text(SPEC.replace(*change), encoding="utf-8")
    assert main(["run", str(spec), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_lists_of_settings_span_a_grid(spec: Path) -> None:
    assert [(row.name, row.settings) for row in RunSpec.read(spec).methods] == [
        ("svd-ridge", {"basis": 2}),
        ("svd-ridge", {"basis": 3}),
        ("reference", {}),
    ]


def test_another_specification_does_not_take_up_a_run(spec: Path, tmp_path: Path) -> None:
    run_module._claim(tmp_path / "out", RunSpec.read(spec))
    spec.write_text(SPEC.replace("rays = 16", "rays = 32"), encoding="utf-8")
    run_module._claim(tmp_path / "out", RunSpec.read(spec))  # nothing was measured yet
    (tmp_path / "out" / "records.jsonl").touch()
    run_module._claim(tmp_path / "out", RunSpec.read(spec))
    spec.write_text(SPEC, encoding="utf-8")
    with pytest.raises(SpecError, match="another specification"):
        run_module._claim(tmp_path / "out", RunSpec.read(spec))


@pytest.mark.parametrize("reason", [errno.ENOSPC, errno.EACCES, errno.EROFS])
def test_a_place_that_takes_no_data_is_one_sentence(
    spec: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], reason: int
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(reason, os.strerror(reason), str(tmp_path / "out"))

    monkeypatch.setattr(run_module, "_claim", refuse)
    assert main(["run", str(spec), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"prt-bench: {tmp_path / 'out'}: {os.strerror(reason)}; ")
    assert message.count("\n") == 1


def test_a_folder_below_a_file_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert (
        main(["bake", "two-plates", "--texels", "16", "--lightings", "1", "--out", str(tmp_path / "file" / "x")]) == 2
    )
    assert "choose a place inside a folder" in capsys.readouterr().err


def test_a_slip_of_our_own_keeps_its_traceback(spec: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "_claim", lambda *_: Path("/no/such/file").read_text())
    with pytest.raises(FileNotFoundError):
        main(["run", str(spec)])
