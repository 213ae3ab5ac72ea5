"""The built wheel is whole: with the checkout out of reach it finds its shaders and data, and bakes."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

BAKE = """
import sys
from pathlib import Path

checkout, installed = map(Path, sys.argv[1:])
sys.path[:] = [str(installed), *(path for path in sys.path if path and Path(path).resolve() != checkout)]

import data_gen.assets
import prt_bench as prt
from prt_bench.environment import EnvironmentMap
from prt_bench.runtime import shaders

for place in (prt.__file__, data_gen.__file__, shaders.folder()):
    assert Path(place).is_relative_to(installed), place
assert "void main" in shaders.source("draw.frag")
assert len(prt.load_scene("suzanne").mesh.faces) > 10_000
maps = data_gen.assets.environment_maps()
assert len(maps) == 8
assert EnvironmentMap.coerce(maps["courtyard"]).radiance.max() > 0

ds = prt.bake(prt.load_scene("cornell"), scenario="point", lightings=2, texels=32, rays=16, measurements=16, out="data")
assert ds.indirect.max() > 0
print("baked", ds.hash)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder), cwd=ROOT)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("installed")
    run(
        sys.executable,
        "-m",
        "pip",
        "install",
        "--no-deps",
        "--no-index",
        "--quiet",
        "--target",
        str(folder),
        str(wheel),
    )
    return folder


def run(*command: str, cwd: Path | None = None, **environment: str) -> str:
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_wheel_holds_every_file_of_the_packages_and_nothing_else(wheel: Path):
    wanted = {f"prt_bench/shaders/{path.name}" for path in (ROOT / "shaders").iterdir()}
    for package in ("prt_bench", "data_gen"):
        inside = (path for path in (ROOT / package).rglob("*") if path.is_file() and "__pycache__" not in path.parts)
        wanted |= {path.relative_to(ROOT).as_posix() for path in inside}
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert held == wanted


def test_the_installed_wheel_bakes_where_no_checkout_is(installed: Path, tmp_path: Path):
    printed = run(sys.executable, "-c", BAKE, str(ROOT), str(installed), cwd=tmp_path)
    assert "baked" in printed


def test_the_installed_command_runs(installed: Path, tmp_path: Path):
    printed = run(str(installed / "bin" / "prt-bench"), "scenes", cwd=tmp_path, PYTHONPATH=str(installed))
    assert "cornell" in printed


@pytest.mark.parametrize("name", ["requirements.txt", "requirements-dev.txt"])
def test_locks_are_pinned_hashed_and_name_no_index(name: str):
    text = (ROOT / name).read_text(encoding="utf-8")
    assert "://" not in text
    assert "--index" not in text
    packages = [entry for entry in text.replace("\\\n", "").splitlines() if entry and not entry.startswith("#")]
    assert all(re.match(r"[A-Za-z0-9._-]+==\S+ .*--hash=sha256:", entry) for entry in packages)


def test_locks_hold_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    for name, needs in (("requirements.txt", []), ("requirements-dev.txt", extras["dev"])):
        locked = set(re.findall(r"^([\w.-]+)==", (ROOT / name).read_text(encoding="utf-8").lower(), re.MULTILINE))
        wanted = {re.split(r"[<>=\[; ]", need)[0].lower() for need in [*project["dependencies"], *needs]}
        assert wanted <= locked
