"""A method that lives in another package is checked, run and ranked like one of ours."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent / "third_party" / "ambient"

SPEC = """
name = "mine"
scenes = ["cornell"]
seed = 0

[bake]
scenarios = ["point"]
lightings = 8
texels = 32
rays = 32
measurements = 16

[time]
size = [64, 48]
rounds = 3

[[methods]]
name = "nearest"

[[methods]]
name = "ambient"
floor = 0.25
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the package was installed into, away from this environment."""
    folder = tmp_path_factory.mktemp("elsewhere")
    done = command(
        sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--no-build-isolation", "--quiet", "--target",
        str(folder), str(PACKAGE),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def command(*words: str, path: Path | None = None, cwd: Path | None = None) -> subprocess.CompletedProcess:
    more = {"PYTHONPATH": str(path)} if path else {}
    return subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=cwd, env={**os.environ, **more}, timeout=600
    )


def bench(installed: Path | None, *words: str, cwd: Path | None = None) -> subprocess.CompletedProcess:
    return command(sys.executable, "-m", "prt_bench.cli", *words, path=installed, cwd=cwd)


def test_it_passes_the_contract(installed: Path):
    done = bench(installed, "check-method", "ambient")
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_is_unknown_where_it_is_not_installed():
    done = bench(None, "check-method", "ambient")
    assert done.returncode != 0
    assert "ambient" in done.stderr
    assert "Traceback" not in done.stderr


def test_it_is_benchmarked_and_found_on_the_leaderboard(installed: Path, tmp_path: Path):
    spec = tmp_path / "mine.toml"
    spec.write_text(SPEC, encoding="utf-8")
    done = bench(installed, "run", str(spec), "--out", str(tmp_path / "run"), cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    with (tmp_path / "run" / "leaderboard.csv").open(encoding="utf-8") as file:
        (mine,) = (row for row in csv.DictReader(file) if row["label"] == "ambient floor=0.25")
    assert 0.05 < float(mine["errors.relative_rmse"]) < 2.0


def test_the_page_shows_the_file_that_is_tested():
    page = (Path(__file__).parents[1] / "ADDING_A_METHOD.md").read_text(encoding="utf-8")
    code = (PACKAGE / "prt_ambient.py").read_text(encoding="utf-8")
    assert code.partition("\n\n")[2].strip() in page
    assert 'ambient = "prt_ambient:Ambient"' in page
