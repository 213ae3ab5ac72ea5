"""Charts by xatlas, in a process beside this one that is replaced when it stops for good.

The scheduler of xatlas can lose a wake-up of its own thread; then it waits for ever, with Python's lock held, and no signal
reaches it. Seldom as that is, a bake must not hang: what computes nothing for `_IDLE` seconds is ended and asked again. Nor
does a crash of it end the caller. This file is the program of that process too, and imports nothing of its packages.
"""

import os
import pickle
import struct
import subprocess
import sys
import time
from pathlib import Path
from select import select
from threading import Lock
from typing import Any, BinaryIO, NamedTuple

import numpy as np

_IDLE = 20.0  # seconds without a tick of processor time
_POLL = 0.5  # seconds between looks
_TRIES = 3
_HEAD = struct.Struct("<Q")


class ChartsFailed(RuntimeError):
    """xatlas gave no answer."""


class Sheet(NamedTuple):
    """A mesh in an atlas: `faces` [F, 3] of its new vertices, with the `uv` [v, 2], `sheet` [v] (−1 for none) and `chart` [v]
    of each."""

    faces: np.ndarray
    uv: np.ndarray
    sheet: np.ndarray
    chart: np.ndarray


class Charted(NamedTuple):
    """What xatlas made of some meshes: so many atlases of a size in texels, at a density."""

    sheets: list[Sheet]
    count: int
    size: tuple[int, int]
    texels_per_unit: float


def generate(meshes: list[tuple[np.ndarray, np.ndarray]], unwrapped: bool = False, **options: float | bool) -> Charted:
    """Cut meshes (vertices [v, 3], faces [F, 3]) into charts and pack them, with these options of xatlas' packing.

    Of meshes that are `unwrapped` vertices are [v, 2], and charts are packed alone. The same every time. Raises
    `ChartsFailed` where xatlas crashed, or stopped without an end several times.
    """
    request = pickle.dumps((meshes, unwrapped, options))
    for _ in range(_TRIES):
        found = _process.ask(request)
        if found is not None:
            return found
    raise ChartsFailed(f"xatlas stopped without an end {_TRIES} times")


class Process:
    """The process, started when it is first asked; `command` runs it."""

    def __init__(self, command: list[str]) -> None:
        self._command, self._lock = command, Lock()
        self._running: subprocess.Popen[bytes] | None = None

    def ask(self, request: bytes) -> Charted | None:
        """The answer, or None where the process stopped and was ended. Raises `ChartsFailed` where it crashed."""
        with self._lock:
            if self._running is None:
                self._running = subprocess.Popen(
                    self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
                )
            try:
                answer = self._answered(self._running, request)
            except BaseException:
                self.end()
                raise
            if answer is None:
                self.end()
            return answer

    def end(self) -> None:
        """End the process; the next question starts another."""
        if self._running is not None:
            self._running.kill()
            self._running.communicate()
            self._running = None

    def _answered(self, process: subprocess.Popen[bytes], request: bytes) -> Charted | None:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            _write(process.stdin, request)
            spent, since = -1.0, time.monotonic()
            while not select([process.stdout], [], [], _POLL)[0]:
                now = _processor_time(process.pid)
                if now != spent:
                    spent, since = now, time.monotonic()
                elif time.monotonic() - since > _IDLE:
                    return None
            sheets, *rest = pickle.loads(_read(process.stdout))
            return Charted([Sheet(*sheet) for sheet in sheets], *rest)
        except (BrokenPipeError, EOFError) as reason:
            raise ChartsFailed(f"xatlas ended by itself, with status {process.wait()}") from reason


def _processor_time(pid: int) -> float:
    """Ticks that a process has computed; where the system does not tell, time itself, so that nothing counts as idle."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return time.monotonic()
    return float(fields[11]) + float(fields[12])


def _write(stream: BinaryIO, content: bytes) -> None:
    stream.write(_HEAD.pack(len(content)) + content)
    stream.flush()


def _read(stream: BinaryIO) -> bytes:
    """One message. Raises `EOFError` at the end of the stream."""
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise EOFError
    return stream.read(_HEAD.unpack(head)[0])


_process = Process([sys.executable, str(Path(__file__).resolve())])


def _charted(meshes: list[tuple[np.ndarray, np.ndarray]], unwrapped: bool, options: dict[str, Any]) -> tuple:
    """What `generate` asks for, in the process of xatlas, without the classes of this file."""
    import xatlas

    atlas = xatlas.Atlas()
    for vertices, faces in meshes:
        (atlas.add_uv_mesh if unwrapped else atlas.add_mesh)(vertices.astype(np.float32), faces.astype(np.uint32))
    packing = xatlas.PackOptions()
    for name, value in options.items():
        setattr(packing, name, value)
    atlas.generate(xatlas.ChartOptions(), packing)
    sheets = []
    for index in range(len(meshes)):
        _, faces, uv = atlas.get_mesh(index)
        sheet, chart = (np.asarray(part).astype(np.int32) for part in atlas.get_mesh_vertex_assignment(index))
        sheets.append((np.array(faces), np.array(uv), sheet, chart))
    return sheets, atlas.atlas_count, (atlas.width, atlas.height), atlas.texels_per_unit


def _serve() -> None:
    """Answer questions until there is nobody to ask them. What xatlas prints goes to the standard error."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    while True:
        try:
            request = _read(sys.stdin.buffer)
        except EOFError:
            return
        _write(answers, pickle.dumps(_charted(*pickle.loads(request))))


if __name__ == "__main__":
    _serve()
