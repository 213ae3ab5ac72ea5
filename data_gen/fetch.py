"""Meshes that are too large to vendor: where they come from, and fetching them for `prt-bench assets`.

They are CC0 and come out of a Debian package by the machine's own package manager. A file is known by the SHA-256 of the
mesh, whatever version of the package it came in. Vendored files are in `data_gen.assets`.
"""

import hashlib
import os
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

from data_gen.journal import write_whole
from prt_bench.errors import SceneError
from prt_bench.store import data_folder

PACKAGE = "libcgal-demo"
LICENCE = "CC0 1.0"


@dataclass(frozen=True)
class FetchedMesh:
    """A mesh file in `PACKAGE`: its name there, how many triangles it has, its SHA-256 and what it shows."""

    file: str
    triangles: int
    sha256: str
    about: str

    @property
    def path(self) -> Path:
        """Where it lies once fetched: the folder `assets` among the user's data."""
        return data_folder() / "assets" / self.file

    @property
    def intact(self) -> bool:
        """Whether it is there, byte for byte."""
        return self.path.is_file() and _digest(self.path.read_bytes()) == self.sha256


MESHES = {
    "bunny": FetchedMesh(
        "bunny00.off",
        75_408,
        "ab651cb04955c161efaeb079035a1e5e1f0e0d1f816a2df67beaea68f393ff2b",
        "the Stanford bunny, remeshed and closed",
    ),
    "elephant": FetchedMesh(
        "refined_elephant.off",
        88_928,
        "a170eed4ef33ef412a72b824d791f69ea59ee5f5a7c12dc1ae9077b6eb030650",
        "a standing elephant, closed",
    ),
}
"""Fetched meshes by name."""


def read_fetched(name: str) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Vertices and faces of a fetched mesh. Raises `SceneError` when it is not there or not what it should be."""
    mesh = MESHES[name]
    if not mesh.intact:
        state = "damaged" if mesh.path.is_file() else "not here"
        raise SceneError(f"mesh {mesh.path} is {state}; 'prt-bench assets {name}' fetches it")
    read = trimesh.load_mesh(mesh.path, process=False)
    return np.array(read.vertices, float), np.array(read.faces)


def fetch(names: Sequence[str] = ()) -> dict[str, bool]:
    """Fetch meshes by name (none: all), and say of each whether that was needed; those that are there intact are left.

    Raises `SceneError` when a mesh is unknown, cannot be fetched, or arrives with another checksum; nothing but whole and
    checked files is ever written.
    """
    for name in names:
        if name not in MESHES:
            nearest = get_close_matches(name, MESHES, 1, 0.0)[0]
            raise SceneError(f"there is no asset '{name}'; did you mean '{nearest}' (of {', '.join(MESHES)})?")
    needed = {name: not MESHES[name].intact for name in names or MESHES}
    missing = [MESHES[name] for name, need in needed.items() if need]
    if missing:
        with tempfile.TemporaryDirectory() as folder:
            tree = _unpacked_package(Path(folder), missing)
            contents = [(mesh, _member(tree, mesh)) for mesh in missing]
        for mesh, content in contents:
            if _digest(content) != mesh.sha256:
                raise SceneError(
                    f"{mesh.file} of this machine's {PACKAGE} has SHA-256 {_digest(content)}, not {mesh.sha256}, so it is"
                    f" another mesh; {_by_hand([mesh], 'version 5.5.1 of ')}"
                )
            write_whole(mesh.path, content)
    return needed


def _unpacked_package(folder: Path, wanted: Sequence[FetchedMesh]) -> Path:
    """Download the package without installing it, and unpack it below `folder`."""
    for tool in ("apt-get", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise SceneError(f"{tool} is not on this machine, so nothing was fetched; {_by_hand(wanted)}")
    download = ["apt-get", "--quiet", "download", PACKAGE]
    done = _run(download, folder)
    if done.returncode and os.geteuid() == 0:  # a fresh machine has no package lists yet
        _run(["apt-get", "--quiet", "update"], folder)
        done = _run(download, folder)
    packages = list(folder.glob("*.deb"))
    if done.returncode or not packages:
        raise SceneError(
            f"apt-get could not download {PACKAGE} ({_last_line(done)}); see to the network or run 'apt-get update' as"
            f" root, or {_by_hand(wanted)}"
        )
    tree = folder / "tree"
    unpacked = _run(["dpkg-deb", "--extract", str(packages[0]), str(tree)], folder)
    if unpacked.returncode:
        raise SceneError(
            f"{packages[0].name} could not be unpacked ({_last_line(unpacked)}); run prt-bench assets again"
        )
    return tree


def _member(tree: Path, mesh: FetchedMesh) -> bytes:
    """A mesh file out of the archives of data that the package holds."""
    for archive in sorted(tree.rglob("data.tar*")):
        try:
            with tarfile.open(archive) as members:
                for member in members:
                    if Path(member.name).name == mesh.file and (found := members.extractfile(member)):
                        return found.read()
        except (tarfile.TarError, EOFError, OSError) as error:
            raise SceneError(f"{archive.name} of {PACKAGE} is damaged ({error}); run prt-bench assets again") from error
    raise SceneError(f"this machine's {PACKAGE} holds no {mesh.file}; {_by_hand([mesh], 'version 5.5.1 of ')}")


def _by_hand(wanted: Sequence[FetchedMesh], which: str = "") -> str:
    """What to do where the package manager does not help."""
    files = " and ".join(f"data/meshes/{mesh.file}" for mesh in wanted)
    return (
        f"take {which}Debian's package {PACKAGE} (packages.debian.org), and out of its"
        f" usr/share/doc/libcgal-dev/data.tar.gz put {files} into {wanted[0].path.parent}"
    )


def _run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stderr or done.stdout).strip().splitlines()
    return lines[-1] if lines else f"exit status {done.returncode}"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
