"""What a row is, which figures it has, and which rows no other row beats on two of them at once (the Pareto frontier).

Metrics are data: a name, a unit, a direction and a function of a row. Ranking and ties live in `ranking.py`.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from prt_bench.records import Record, Stage, Timing

RANKED_STATUS = frozenset({"ok", "no-gl"})


@dataclass(frozen=True, eq=False)
class Row:
    """One record as one machine ran it; a record timed by several renderers or clocks gives several rows."""

    record: Record
    gl: Timing | None
    jax: Timing | None

    @property
    def rankable(self) -> bool:
        """Whether the row competes: it ran, it could run in real time, and it is no ceiling. Others are shown only."""
        return self.record.status in RANKED_STATUS and self.record.role != "ceiling"

    @property
    def device(self) -> str:
        """Everything that must agree before two rows' costs may be compared, as one line to read."""
        host = self.record.provenance
        parts = [f"{host['cpu']} ({host.get('cores')} cores)"] if host.get("cpu") else []
        if self.gl is not None:
            size = "×".join(map(str, self.gl.resolution or ()))
            kind = "software rasteriser" if self.gl.software else ""
            clock = "" if self.gl.clock == "wall" else f"{self.gl.clock} clock"
            parts = [self.gl.device, size, kind, clock, *parts]
        elif self.jax is not None:
            parts = [f"no OpenGL; JAX on {self.jax.device}", *parts]
        return " · ".join(part for part in parts if part) or "not timed"


def rows(records: Iterable[Record]) -> list[Row]:
    """One row per record, OpenGL device and clock; a later record of the same row replaces an earlier one."""
    found: dict[tuple[str, ...], Row] = {}
    for record in records:
        by_api = {api: [timing for timing in record.timings if timing.api == api] for api in ("gl", "jax")}
        for gl in by_api["gl"] or [None]:
            row = Row(record, gl, by_api["jax"][0] if by_api["jax"] else None)
            found[record.scene, record.scenario, record.split, record.label, row.device] = row
    return list(found.values())


@dataclass(frozen=True)
class Metric:
    """A figure of a row. `spread` is the half-width of its interquartile range, where the figure is a timing."""

    name: str
    label: str
    unit: str
    kind: Literal["error", "cost"]
    get: Callable[[Row], float | None]
    higher_is_better: bool = False
    spread: Callable[[Row], float | None] = lambda row: None
    log: bool = True

    def of(self, row: Row) -> float | None:
        """The figure, or None where it was not measured or is not finite."""
        value = self.get(row)
        return None if value is None or not math.isfinite(value) else float(value)


def _error(name: str) -> Callable[[Row], float | None]:
    return lambda row: getattr(row.record.errors, name)


def _stage(timing: Timing | None, name: str) -> Stage | None:
    return None if timing is None else timing.stages.get(name)


def _gl_median(name: str) -> Callable[[Row], float | None]:
    def get(row: Row) -> float | None:
        stage = _stage(row.gl, name)
        return None if stage is None else stage.median

    return get


def _gl_spread(name: str) -> Callable[[Row], float | None]:
    def get(row: Row) -> float | None:
        stage = _stage(row.gl, name)
        return None if stage is None else stage.iqr / 2

    return get


def _indirect(row: Row) -> float | None:
    """What indirect light adds to a frame; under timing noise it may come out negative, and is not clipped."""
    frame = _stage(row.gl, "frame")
    return None if frame is None or row.gl is None or row.gl.baseline is None else frame.median - row.gl.baseline.median


def _indirect_spread(row: Row) -> float | None:
    frame = _stage(row.gl, "frame")
    return None if frame is None or row.gl is None or row.gl.baseline is None else math.hypot(
        frame.iqr, row.gl.baseline.iqr
    ) / 2  # fmt: skip


def _jax(row: Row) -> float | None:
    stages = [_stage(row.jax, name) for name in ("measure", "transfer", "reconstruct")]
    found = [stage.median for stage in stages if stage is not None]
    return sum(found) if found else None


def _bytes(name: str) -> Callable[[Row], float | None]:
    return lambda row: row.record.bytes.get(name)


def _seconds(*names: str) -> Callable[[Row], float | None]:
    def get(row: Row) -> float | None:
        found = [row.record.seconds.get(name) for name in names]
        return None if None in found else sum(value for value in found if value is not None)

    return get


METRICS: dict[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric("relative_rmse", "Relative RMSE", "", "error", _error("relative_rmse")),
        Metric("rmse", "RMSE", "W/m²", "error", _error("rmse")),
        Metric("total", "Relative RMSE of all light", "", "error", _error("total")),
        Metric("flip", "FLIP", "", "error", _error("flip")),
        Metric("psnr", "PSNR", "dB", "error", _error("psnr"), higher_is_better=True, log=False),
        Metric("ssim", "SSIM", "", "error", _error("ssim"), higher_is_better=True, log=False),
        Metric("frame_ms", "Frame", "ms", "cost", _gl_median("frame"), spread=_gl_spread("frame")),
        Metric("indirect_ms", "Indirect light", "ms", "cost", _indirect, spread=_indirect_spread),
        Metric("measure_ms", "Measure", "ms", "cost", _gl_median("measure"), spread=_gl_spread("measure")),
        Metric("transfer_ms", "Transfer", "ms", "cost", _gl_median("transfer"), spread=_gl_spread("transfer")),
        Metric("draw_ms", "Draw", "ms", "cost", _gl_median("draw"), spread=_gl_spread("draw")),
        Metric("jax_ms", "JAX", "ms", "cost", _jax),
        Metric("runtime_bytes", "Runtime memory", "bytes", "cost", _bytes("runtime")),
        Metric("asset_bytes", "Asset", "bytes", "cost", _bytes("asset")),
        Metric("bake_s", "Bake", "s", "cost", _seconds("bake")),
        Metric("fit_s", "Fit", "s", "cost", _seconds("fit")),
        Metric("prepare_s", "Bake and fit", "s", "cost", _seconds("bake", "fit")),
    )
}
ERROR_AXES = tuple(metric.name for metric in METRICS.values() if metric.kind == "error")
COST_AXES = ("frame_ms", "indirect_ms", "jax_ms", "runtime_bytes", "asset_bytes", "bake_s", "fit_s", "prepare_s")


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other point dominates, smaller being better, sorted by the first coordinate.

    A point dominates another when it is no worse in both coordinates and better in one; equal points stand together.
    """
    kept: list[int] = []
    for index in sorted(range(len(points)), key=lambda i: points[i]):
        if not kept or points[index][1] < points[kept[-1]][1] or points[index] == points[kept[-1]]:
            kept.append(index)
    return kept


def frontier(group: Sequence[Row], x: Metric, y: Metric) -> list[int]:
    """Indices of the rows on the frontier of two metrics, by rising `x`. Rows of several devices are refused.

    Rows that do not compete, or lack a figure, are never on it.
    """
    indices, points = [], []
    for index, row in enumerate(group):
        figures = x.of(row), y.of(row)
        if row.rankable and figures[0] is not None and figures[1] is not None:
            indices.append(index)
            points.append((-figures[0] if x.higher_is_better else figures[0],
                           -figures[1] if y.higher_is_better else figures[1]))  # fmt: skip
    devices = {group[index].device for index in indices}
    if len(devices) > 1:
        raise ValueError(f"rows of different devices have no common frontier: {', '.join(sorted(devices))}")
    return [indices[index] for index in pareto(points)]
