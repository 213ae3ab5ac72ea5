"""The main job: bake, fit, export, evaluate, time and report everything a specification names.

One (scene, scenario) pair is the unit of work: its rows are measured together, interleaved, and written together, so a run
that was interrupted goes on with the first pair that has no rows.
"""

import hashlib
import json
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import jax
import numpy as np

from data_gen.bake import bake
from data_gen.scenes import load_scene
from prt_bench import records
from prt_bench.assets import RuntimeAsset
from prt_bench.dataset import LightingDataset
from prt_bench.errors import PrtBenchError, RuntimeUnavailable, SpecError
from prt_bench.evaluate import evaluate
from prt_bench.frames import FrameRows
from prt_bench.methods import method
from prt_bench.methods.base import Method
from prt_bench.models import Model
from prt_bench.progress import say, track
from prt_bench.records import Record
from prt_bench.report import write_leaderboard, write_report
from prt_bench.spec import MethodSpec, RunSpec

T = TypeVar("T")
_MARK = "run.json"


@dataclass
class Fitted:
    """One row in the making: a method, its fitted model and asset, or the reason why there is none."""

    spec: MethodSpec
    method: Method
    label: str
    model: Model | None = None
    asset: RuntimeAsset | None = None
    seconds: float = 0.0
    status: str = "ok"
    reason: str | None = None
    timings: tuple[records.Timing, ...] = field(default=())

    @property
    def real_time(self) -> bool:
        """Whether the runtime can run it."""
        return self.asset is not None


def run(spec_path: Path, out: Path | None = None) -> Path:
    """Run a specification into the folder `out` (default: runs/<name>) and return that folder.

    Leaves datasets, assets, pictures, `records.jsonl`, `leaderboard.{md,csv,json,tex}` and `report.html`. Raises
    `SpecError` for a bad specification or a folder that holds something else.
    """
    spec = RunSpec.read(spec_path)
    methods = [(row, method(row.name, **row.settings)) for row in spec.methods]
    scenes = [load_scene(source) for source in spec.scenes]
    folder = out or Path("runs") / spec.name
    _claim(folder, spec)
    done = {(r.scene, r.scenario) for r in records.read(folder / "records.jsonl")} if _has_records(folder) else set()
    for scene in scenes:
        for scenario in spec.bake.scenarios:
            if (scene.name, scenario) in done:
                say(f"{scene.name} ({scenario}) is measured already")
                continue
            settings = {key: value for key, value in asdict(spec.bake).items() if key != "scenarios"}
            ds = bake(scene, scenario, seed=spec.seed, out=folder / "data", **settings)
            rows = [_fit(ds, row, chosen, spec, folder) for row, chosen in track(methods, f"fit {scene.name}")]
            for record in _measure(ds, rows, spec, folder):
                records.append(folder / "records.jsonl", record)
    write_leaderboard(folder)
    write_report(folder)
    return folder


def _claim(folder: Path, spec: RunSpec) -> None:
    """Make the folder, or take up a run of the same specification in it."""
    digest = hashlib.sha256(json.dumps(asdict(spec), sort_keys=True, default=dict).encode()).hexdigest()
    mark = folder / _MARK
    if mark.is_file():
        if json.loads(mark.read_text(encoding="utf-8")).get("spec") != digest:
            raise SpecError(f"{folder} holds a run of another specification; choose another --out or delete it")
        return
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SpecError(f"{folder} holds something that is not a prt-bench run; choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    mark.write_text(json.dumps({"spec": digest, "name": spec.name}) + "\n", encoding="utf-8")


def _has_records(folder: Path) -> bool:
    return (folder / "records.jsonl").is_file()


def _fit(ds: LightingDataset, row: MethodSpec, chosen: Method, spec: RunSpec, folder: Path) -> Fitted:
    """Fit and export one method; what goes wrong becomes the row's status."""
    label = chosen.label if row.storage == "float32" else f"{chosen.label} {row.storage}"
    fitted = Fitted(row, chosen, label)
    started = time.perf_counter()
    try:
        with _time_limit(spec.timeout):
            fitted.model = jax.block_until_ready(chosen.fit(ds.split("train"), jax.random.key(spec.seed)))
    except TimeoutError:
        fitted.status, fitted.reason = "timeout", f"the fit took more than {spec.timeout:g} s"
    except (PrtBenchError, ArithmeticError, MemoryError, ValueError) as error:
        fitted.status, fitted.reason = "failed", f"{type(error).__name__}: {error}"
    fitted.seconds = time.perf_counter() - started
    if fitted.model is not None and fitted.model.kernels:
        name = f"{ds.scene.name}-{ds.metadata['scenario']}-{label}".replace(" ", "-")
        fitted.asset = fitted.model.export(folder / "assets" / name, row.storage)
    elif fitted.model is not None:
        fitted.status, fitted.reason = "oracle", "it needs the answer to predict it, so it cannot run in real time"
    return fitted


def _measure(ds: LightingDataset, rows: Sequence[Fitted], spec: RunSpec, folder: Path) -> Iterator[Record]:
    """Accuracy, frames and timings of all rows on every held-out split."""
    try:
        frames = FrameRows(ds, spec.time, folder)
    except RuntimeUnavailable as error:
        say(f"no OpenGL: {error}")
        frames = None
        for row in rows:
            if row.real_time:
                row.status, row.reason = "no-gl", str(error)
    timings = FrameRows.time(frames, ds, {row.label: row.asset for row in rows if row.asset is not None}, spec.time)
    for split in [name for name in ds.splits if name != "train"]:
        held_out = ds.split(split)
        for row in track(rows, f"evaluate {ds.scene.name} ({split})"):
            record = _row(row, ds, split, spec)
            if row.model is not None:
                measured = evaluate(row.model, held_out, asset=row.asset)
                record = replace(record, errors=measured.errors, curves=measured.curves, bytes=measured.bytes)
                record = replace(record, timings=timings.get(row.label, ()))
                if frames is not None:
                    record = frames.add(record, row.model, row.asset, held_out)
            yield record


def _row(row: Fitted, ds: LightingDataset, split: str, spec: RunSpec) -> Record:
    about = ds.metadata
    names = ("hash", "texels", "rays", "bounces", "lightings", "measurements", "channels", "effects", "plan", "predicted")
    return Record(
        scene=ds.scene.name,
        scenario=about["scenario"],
        split=split,
        method=row.method.name,
        label=row.label,
        settings={**{k: v for k, v in asdict(row.method).items()}, "storage": row.spec.storage},
        role=row.method.role,
        status=row.status,
        reason=row.reason,
        seconds={"bake": sum(about["seconds"].values()), "fit": row.seconds},
        dataset={**{name: about[name] for name in names}, "points": len(ds.points)},
        asset={"sha256": row.asset.sha256, "dtype": row.asset.dtype} if row.asset else {},
        provenance={**records.provenance(), "seed": spec.seed},
    )


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` in the main thread after `seconds`."""

    def stop(_: int, __: FrameType | None) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
