"""The doctor reports what is missing as rows, and never fails itself."""

import sys

import pytest

from prt_bench import doctor
from prt_bench.cli import main
from prt_bench.errors import RuntimeUnavailable
from prt_bench.runtime import context

PACKAGES = {
    "embreex": "embreex.rtcore_scene",
    "xatlas": "xatlas",
    "trimesh": "trimesh",
    "OpenEXR": "OpenEXR",
    "flip-evaluator": "flip_evaluator",
    "DracoPy": "DracoPy",
    "mitsuba": "mitsuba",
}


def finding(part: str) -> doctor.Finding:
    found = [row for row in doctor.report() if row.part.startswith(part)]
    assert len(found) == 1 or part == "OpenGL", f"{part}: {found}"
    return found[0]


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise RuntimeUnavailable("no OpenGL here")

    monkeypatch.setattr(context, "headless", refuse)


def test_every_part_says_what_needs_it():
    rows = doctor.report()
    assert len({row.part for row in rows}) == len(rows)
    assert all(row.needed_for for row in rows)


def test_what_can_be_missing_comes_with_a_remedy(no_gl: None):
    assert all(row.remedy for row in doctor.report() if row.found is None)


@pytest.mark.parametrize(("part", "module"), PACKAGES.items())
def test_a_package_that_cannot_be_imported_is_missing(part: str, module: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, module, None)  # importing it raises ImportError
    row = finding(part)
    assert row.found is None
    assert "pip install" in row.remedy


def test_no_tk_is_a_row_with_the_package_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "tkinter", None)
    row = finding("Tk")
    assert row.found is None
    assert row.remedy == "apt-get install python3-tk"


def test_no_opengl_is_a_row_with_the_packages_to_install(no_gl: None):
    row = finding("OpenGL")
    assert row.found is None
    assert "apt-get install libegl1 libgl1 libgl1-mesa-dri" in row.remedy


@pytest.mark.gl
def test_the_renderer_is_named_as_the_driver_names_it():
    try:
        name = context.renderer(context.headless())
    except RuntimeUnavailable as error:
        pytest.skip(str(error))
    rows = {row.part: row.found for row in doctor.report()}
    opengl = next(found for part, found in rows.items() if part.startswith("OpenGL 4."))
    assert opengl is not None
    assert name in opengl
    assert ("software" in opengl) == context.is_software(name)


def test_a_system_that_does_not_tell_its_memory_is_no_failure(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delattr("os.sysconf")
    assert finding("memory").found == "unknown"


def test_the_command_prints_every_part_and_succeeds(no_gl: None, capsys: pytest.CaptureFixture[str]):
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    assert all(row.part.split()[0] in printed for row in doctor.report())
    assert "missing: apt-get install" in " ".join(printed.split())
