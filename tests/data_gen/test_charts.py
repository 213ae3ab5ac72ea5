"""The process of xatlas: what it answers, and what becomes of it when it stops for good, crashes, or is interrupted."""

import sys

import numpy as np
import pytest
import trimesh
import xatlas

from data_gen import charts
from data_gen.atlas import unwrap
from data_gen.charts import ChartsFailed, Process, generate
from data_gen.scenes import cornell
from prt_bench.errors import SceneError

BALL = trimesh.creation.icosphere(subdivisions=2)
MESH = np.asarray(BALL.vertices), np.asarray(BALL.faces)


def test_it_is_xatlas():
    found = generate([MESH, MESH], padding=1)
    atlas, packing = xatlas.Atlas(), xatlas.PackOptions()
    packing.padding = 1
    for _ in range(2):
        atlas.add_mesh(MESH[0].astype(np.float32), MESH[1].astype(np.uint32))
    atlas.generate(xatlas.ChartOptions(), packing)
    assert found.size == (atlas.width, atlas.height)
    assert found.texels_per_unit == atlas.texels_per_unit
    for index, sheet in enumerate(found.sheets):
        _, faces, uv = atlas.get_mesh(index)
        np.testing.assert_array_equal(sheet.faces, faces)
        np.testing.assert_array_equal(sheet.uv, uv)
        np.testing.assert_array_equal(sheet.chart, atlas.get_mesh_vertex_assignment(index)[1])


def test_a_process_that_stops_is_replaced_by_another(monkeypatch, tmp_path):
    """The first one reads its question and then waits for ever, as xatlas does; the second is that of xatlas."""
    first = tmp_path / "first"
    program = f"""
import pathlib, sys, time, runpy
if not pathlib.Path({str(first)!r}).exists():
    pathlib.Path({str(first)!r}).touch()
    sys.stdin.buffer.read(8)
    time.sleep(1000)
runpy.run_path({charts.__file__!r}, run_name="__main__")
"""
    monkeypatch.setattr(charts, "_IDLE", 0.5)
    monkeypatch.setattr(charts, "_POLL", 0.1)
    monkeypatch.setattr(charts, "_process", Process([sys.executable, "-c", program]))
    found = generate([MESH], padding=1)
    assert first.exists()
    charts._process.end()
    monkeypatch.undo()
    np.testing.assert_array_equal(found.sheets[0].uv, generate([MESH], padding=1).sheets[0].uv)


def test_one_that_always_stops_or_crashes_is_told_of(monkeypatch):
    monkeypatch.setattr(charts, "_IDLE", 0.2)
    monkeypatch.setattr(charts, "_POLL", 0.1)
    monkeypatch.setattr(charts, "_process", Process([sys.executable, "-c", "import time; time.sleep(1000)"]))
    with pytest.raises(ChartsFailed, match="3 times"):
        generate([MESH])
    monkeypatch.setattr(charts, "_process", Process([sys.executable, "-c", "import os; os._exit(7)"]))
    with pytest.raises(ChartsFailed, match="status 7"):
        generate([MESH])


def test_a_scene_says_that_it_was_not_unwrapped(monkeypatch):
    monkeypatch.setattr(charts, "_process", Process([sys.executable, "-c", "import os; os._exit(7)"]))
    with pytest.raises(SceneError, match="'cornell' was not unwrapped: xatlas ended by itself"):
        unwrap(cornell.build(), 64)
