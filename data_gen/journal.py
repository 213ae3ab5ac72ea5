"""Where data goes, and writes that survive an interruption: nothing takes its final name before it is whole.

A store is filled under a `.partial` name, chunk by chunk, with a journal of what is done; a small file is written at once.
"""

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zarr

from prt_bench.errors import DatasetError


class Journal:
    """One JSON line per finished chunk beside the store. A torn last line is a chunk that was not finished."""

    def __init__(self, partial: Path) -> None:
        self._file = partial / "journal.jsonl"
        self.done: dict[int, dict[str, Any]] = {}
        if self._file.is_file():
            for line in self._file.read_text(encoding="utf-8").splitlines():
                try:
                    entry = json.loads(line)
                except ValueError:
                    break
                self.done[entry.pop("chunk")] = entry
            self._rewrite()

    def add(self, chunk: int, **entry: Any) -> None:
        """Record that a chunk is on disk."""
        self.done[chunk] = entry
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"chunk": chunk, **entry}) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def _rewrite(self) -> None:
        text = "".join(json.dumps({"chunk": chunk, **entry}) + "\n" for chunk, entry in self.done.items())
        self._file.write_text(text, encoding="utf-8")


@contextmanager
def resumable(path: Path, needed_bytes: int) -> Iterator[tuple[Path, Journal]]:
    """A partial folder and its journal; on a clean exit the folder becomes `path`.

    Raises `DatasetError` before the store is begun when the disk cannot hold `needed_bytes`, and when it fills up on the
    way; what was finished stays under the partial name and the next run goes on from there.
    """
    partial = _partial(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(path.parent).free
    if free < needed_bytes:
        raise DatasetError(
            f"the disk of {path.parent} has {free / 1e9:.2f} GB free, but the bake needs {needed_bytes / 1e9:.2f} GB;"
            " free some space or lower texels or lightings"
        )
    with _told_of_a_full_disk(path.parent):
        partial.mkdir(exist_ok=True)
        journal = Journal(partial)
        yield partial, journal
    (partial / "journal.jsonl").unlink(missing_ok=True)
    partial.rename(path)


def write_whole(path: Path, content: bytes) -> None:
    """Write a small file, which appears under its name complete or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with _told_of_a_full_disk(path.parent):
        try:
            partial.write_bytes(content)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def begun(path: Path) -> bool:
    """Whether an interrupted run left a part of a store."""
    return _partial(path).is_dir()


def _partial(path: Path) -> Path:
    return path.with_name(path.name + ".partial")


@contextmanager
def _told_of_a_full_disk(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise DatasetError(f"the disk of {folder} is full; free some space and run again to resume") from error
        raise


def content_key(about: dict[str, Any]) -> str:
    """A short name for everything a store depends on."""
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:12]


def create_array(group: zarr.Group, name: str, shape: tuple, chunks: tuple, dtype: type) -> Any:
    """An array to fill chunk by chunk, or the one an interrupted run left."""
    if name in group:
        return group[name]
    return group.create_array(name, shape=shape, chunks=chunks, dtype=dtype, compressors=None)
