"""Fetched meshes, with a package manager made for the test: what arrives, what is refused, and what is said then."""

import hashlib
import os
import tarfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from data_gen import fetch as module
from data_gen.fetch import MESHES, PACKAGE, fetch, read_fetched
from prt_bench.cli import main
from prt_bench.errors import SceneError

TRIANGLE = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
APT_GET = """#!/bin/sh
echo "$2" >> {log}
[ "$2" = update ] && touch {folder}/lists
[ "$2" = download ] || exit 0
[ -e {folder}/lists ] || {{ echo "E: Unable to locate package" >&2; exit 100; }}
cp {folder}/package.deb . && exit {status}
"""
DPKG_DEB = '#!/bin/sh\nmkdir -p "$3" && tar -xf "$2" -C "$3"\n'


class PackageManager:
    """Shell scripts `apt-get` and `dpkg-deb` that serve one package from `folder` and log what they were asked."""

    def __init__(self, folder: Path):
        self.folder, self.log = folder, folder / "log"
        self.provide({"data/meshes/triangle.off": TRIANGLE})
        self.install()

    def install(self, status: int = 0, lists: bool = True) -> None:
        (self.folder / "lists").unlink(missing_ok=True)
        if lists:
            (self.folder / "lists").touch()
        bin_folder = self.folder / "bin"
        bin_folder.mkdir(exist_ok=True)
        for name, text in (
            ("apt-get", APT_GET.format(log=self.log, folder=self.folder, status=status)),
            ("dpkg-deb", DPKG_DEB),
        ):
            (bin_folder / name).write_text(text)
            (bin_folder / name).chmod(0o755)

    def provide(self, files: dict[str, bytes], cut: int | None = None) -> None:
        inner = _archive(files, "w:gz")
        path = "usr/share/doc/libcgal-dev/data.tar.gz"
        (self.folder / "package.deb").write_bytes(_archive({path: inner[:cut]}, "w"))

    @property
    def asked(self) -> list[str]:
        return self.log.read_text().split() if self.log.exists() else []


def _archive(files: dict[str, bytes], mode: str) -> bytes:
    buffer = BytesIO()
    with tarfile.open(fileobj=buffer, mode=mode) as archive:  # pyright: ignore[reportCallIssue, reportArgumentType]
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, BytesIO(content))
    return buffer.getvalue()


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PackageManager:
    (tmp_path / "machine").mkdir()
    made = PackageManager(tmp_path / "machine")
    monkeypatch.setenv("PATH", f"{made.folder / 'bin'}:/usr/bin:/bin")
    monkeypatch.setenv("PRT_BENCH_DATA", str(tmp_path / "data"))
    triangle = replace(MESHES["bunny"], file="triangle.off", sha256=hashlib.sha256(TRIANGLE).hexdigest())
    monkeypatch.setattr(module, "MESHES", {"triangle": triangle})
    return made


def files_of(tmp_path: Path) -> list[Path]:
    return [path for path in (tmp_path / "data").rglob("*") if path.is_file()]


def test_a_mesh_arrives_once(manager: PackageManager, tmp_path: Path):
    assert fetch() == {"triangle": True}
    assert fetch(["triangle"]) == {"triangle": False}
    assert manager.asked == ["download"]
    assert files_of(tmp_path) == [tmp_path / "data" / "assets" / "triangle.off"]
    vertices, faces = read_fetched("triangle")
    assert np.array_equal(vertices[faces[0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_a_damaged_file_is_refused_and_fetched_again(manager: PackageManager, tmp_path: Path):
    path = tmp_path / "data" / "assets" / "triangle.off"
    with pytest.raises(SceneError, match="not here; 'prt-bench assets triangle' fetches it"):
        read_fetched("triangle")
    fetch()
    path.write_bytes(TRIANGLE.replace(b"1 0 0", b"2 0 0"))
    with pytest.raises(SceneError, match="damaged; 'prt-bench assets triangle' fetches it"):
        read_fetched("triangle")
    assert fetch() == {"triangle": True}
    assert path.read_bytes() == TRIANGLE


def test_another_checksum_is_refused(manager: PackageManager, tmp_path: Path):
    manager.provide({"data/meshes/triangle.off": TRIANGLE + b"\n"})
    with pytest.raises(SceneError, match=r"so it is another mesh; take version 5\.5\.1 of"):
        fetch()
    assert files_of(tmp_path) == []


@pytest.mark.parametrize(
    ("files", "cut", "sentence"),
    [
        ({"data/meshes/square.off": TRIANGLE}, None, "holds no triangle.off; take version 5.5.1 of"),
        ({"data/meshes/triangle.off": TRIANGLE * 99}, 60, "is damaged .* run prt-bench assets again"),
    ],
)
def test_a_package_without_the_mesh_is_refused(manager: PackageManager, tmp_path: Path, files, cut, sentence):
    manager.provide(files, cut)
    with pytest.raises(SceneError, match=sentence):
        fetch()
    assert files_of(tmp_path) == []


def test_an_interrupted_download_leaves_nothing(
    manager: PackageManager, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    manager.install(status=100)
    with pytest.raises(SceneError, match=f"could not download {PACKAGE} .* see to the network"):
        fetch()
    assert files_of(tmp_path) == []
    manager.install()
    assert fetch() == {"triangle": True}


def test_package_lists_are_brought_up_to_date_by_root_alone(manager: PackageManager, monkeypatch: pytest.MonkeyPatch):
    manager.install(lists=False)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(SceneError, match=r"E: Unable to locate package.* 'apt-get update'"):
        fetch()
    assert manager.asked == ["download"]
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert fetch() == {"triangle": True}
    assert manager.asked == ["download", "download", "update", "download"]


def test_without_a_package_manager_it_says_what_to_put_where(
    manager: PackageManager, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["assets"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for part in ("apt-get is not on this machine", PACKAGE, "data/meshes/triangle.off", str(tmp_path / "data/assets")):
        assert part in said


def test_an_unknown_asset_names_the_nearest(manager: PackageManager):
    with pytest.raises(SceneError, match="no asset 'triangel'; did you mean 'triangle'"):
        fetch(["triangel"])
    assert manager.asked == []


def test_the_command_names_file_source_and_licence(manager: PackageManager, capsys: pytest.CaptureFixture[str]):
    assert main(["assets", "triangle"]) == 0
    first = capsys.readouterr().out
    assert all(part in first for part in ("fetched", "triangle.off", PACKAGE, "CC0 1.0"))
    assert main(["assets"]) == 0
    assert "here already" in capsys.readouterr().out
