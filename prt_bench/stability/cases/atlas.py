"""The lightmap of meshes whose own texture coordinates cannot serve: no two faces share a texel, and the log says why."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from data_gen.atlas import unwrap
from prt_bench.points import Lightmap
from prt_bench.scene import Mesh, Scene
from prt_bench.stability.cell import Measured, Member, case
from prt_bench.stability.rigs import room
from prt_bench.stability.routes import F64, Route

_SIDE = 64


def _with(uv: np.ndarray | None) -> Scene:
    scene = room().transport.scene
    return replace(scene, mesh=Mesh(scene.mesh.vertices, scene.mesh.faces, scene.mesh.material, uv))


def _islands(gap: float) -> np.ndarray:
    """The six walls in two rows of three, each a square, `gap` texels apart; negative ones overlap."""
    corners = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
    size = 0.25
    step = size + gap / _SIDE
    faces = room().transport.scene.mesh.faces
    origin = np.array([[step * (wall % 3), step * (wall // 3)] for wall in range(6)])
    return (origin[:, None] + size * corners).reshape(-1, 2)[faces]


def _meshes(route: Route) -> Iterator[Member]:
    sound = _islands(2.0)
    flat = sound.copy()
    flat[3] = flat[3, :1]
    yield Member("coordinates that can serve", (_with(sound), None))
    yield Member("no texture coordinates", (_with(None), "no texture coordinates"))
    yield Member("islands one on another", (_with(_islands(-0.25 * _SIDE)), "overlap"))
    yield Member("islands that share a row of texels", (_with(_islands(-1.0)), "overlap"))
    yield Member("coordinates beyond the square", (_with(sound + 0.5), "leave"))
    yield Member("a face without area", (_with(flat), "no area"))
    yield Member("a coordinate that is NaN", (_with(np.where(sound == sound.max(), np.nan, sound)), "leave"))


@case("G5", "texture coordinates that cannot serve", subjects=lambda: {"unwrap": unwrap}, family=_meshes, routes=(F64,))
def unusable_coordinates(made: Any, member: tuple[Scene, str | None], route: Route) -> Iterator[Measured]:
    """G5: overlapping islands receive each other's light. Every texel centre lies in one face at most, by signs of areas; all
    faces get texels in proportion to their area; and what was wrong is in the log."""
    scene, flaw = member
    with _log() as said:
        lightmap = made(scene, _SIDE)
    inside = _holding(lightmap)
    yield Measured(float(np.sum(inside.sum(axis=0) > 1)), 0.0)
    share = inside.sum(axis=1) / inside.sum()
    yield Measured(float(np.abs(share / (scene.mesh.areas / scene.mesh.areas.sum()) - 1.0).max()), 0.25)
    told = "keeps its own" if flaw is None else flaw
    yield Measured(float(not any(told in line for line in said)), 0.0)


def _holding(lightmap: Lightmap) -> np.ndarray:
    """Which faces [F, texels] hold which texel centres."""
    row, column = np.divmod(np.arange(lightmap.resolution**2), lightmap.resolution)
    centre = (np.stack([column, row], axis=1) + 0.5) / lightmap.resolution
    ends = lightmap.corner_uv
    turn = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        edge, offset = (ends[:, b] - ends[:, a])[:, None], centre[None] - ends[:, a][:, None]
        turn.append(edge[..., 0] * offset[..., 1] - edge[..., 1] * offset[..., 0])
    return np.all(np.stack(turn) > 1e-9, axis=0) | np.all(np.stack(turn) < -1e-9, axis=0)


@contextmanager
def _log() -> Iterator[list[str]]:
    """What the atlas says."""
    said: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())
    log = logging.getLogger("data_gen.atlas")
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield said
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
