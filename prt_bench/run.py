"""The main job: bake, fit, export, evaluate, time and report everything a specification names.

One (scene, scenario) pair is the unit of work: its rows are measured together, interleaved, and written together, so a run
that was interrupted goes on with the first pair that has no rows.
"""

import hashlib
import itertools
import json
import signal
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import FrameType

import jax

from data_gen.bake import bake
from data_gen.plan import plan
from data_gen.scenes import load_scene
from data_gen.skips import skips
from prt_bench import records
from prt_bench.assets import RuntimeAsset
from prt_bench.dataset import LightingDataset
from prt_bench.errors import AssetError, PrtBenchError, RuntimeUnavailable, SpecError
from prt_bench.evaluate import describe, evaluate
from prt_bench.frames import FrameComparison, time_assets
from prt_bench.methods import method
from prt_bench.methods.base import Method
from prt_bench.models import Model
from prt_bench.progress import say, track
from prt_bench.records import Record
from prt_bench.report import write_leaderboard, write_report
from prt_bench.runtime.indirect import LoadedAsset
from prt_bench.spec import MethodSpec, RunSpec

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


def run(spec_path: Path, out: Path | None = None) -> Path:
    """Run a specification into the folder `out` (default: runs/<name>) and return that folder.

    Leaves datasets, assets, pictures, `records.jsonl`, `leaderboard.{md,csv,json,tex}` and `report.html`. Raises
    `SpecError` for a bad specification or a folder that holds something else.
    """
    spec = RunSpec.read(spec_path)
    methods = [(row, method(row.name, **row.settings)) for row in spec.methods]
    scenes = [load_scene(source) for source in spec.scenes]
    _require_distinct("scenes", [scene.name for scene in scenes], "give one another name in a scene file")
    _require_distinct("methods", [_label(*row) for row in methods], "rows need different settings")
    folder = out or Path("runs") / spec.name
    settings = {key: value for key, value in asdict(spec.bake).items() if key != "scenarios"}
    given = {key: value for key, value in settings.items() if value != "auto"}  # the rest is measured when it is baked
    for scene, scenario in itertools.product(scenes, spec.bake.scenarios):
        plan(scene, scenario, **given)  # refuses what cannot be baked, before anything is written
    _claim(folder, spec)
    done = {(r.scene, r.scenario) for r in records.read(folder / "records.jsonl")} if _has_records(folder) else set()
    for scene in scenes:
        for scenario in spec.bake.scenarios:
            if (scene.name, scenario) in done:
                say(f"{scene.name} ({scenario}) is measured already")
                continue
            ds = bake(scene, scenario, seed=spec.seed, out=folder / "data", **settings)
            rows = [_fit(ds, row, chosen, spec, folder) for row, chosen in track(methods, f"fit {scene.name}")]
            measured = list(_measure(ds, rows, spec, folder))
            if spec.skips:
                left_out = [asdict(skip) for skip in skips(ds, spec.skips)]
                measured = [replace(record, dataset={**record.dataset, "skips": left_out}) for record in measured]
            records.append(folder / "records.jsonl", *measured)
    write_leaderboard(folder)
    write_report(folder)
    return folder


def _require_distinct(kind: str, names: Sequence[str], remedy: str) -> None:
    """Names are what tells rows, assets and pictures apart."""
    twice = next((name for index, name in enumerate(names) if name in names[:index]), None)
    if twice is not None:
        raise SpecError(f"two {kind} are called '{twice}'; {remedy}")


def _label(row: MethodSpec, chosen: Method) -> str:
    return chosen.label if row.storage == "float32" else f"{chosen.label} {row.storage}"


def _claim(folder: Path, spec: RunSpec) -> None:
    """Make the folder, or take up a run in it: of the same specification, or of one that measured nothing yet."""
    digest = hashlib.sha256(json.dumps(asdict(spec), sort_keys=True, default=dict).encode()).hexdigest()
    mark = folder / _MARK
    if mark.is_file():
        other = json.loads(mark.read_text(encoding="utf-8")).get("spec") != digest
        if other and _has_records(folder):
            raise SpecError(f"{folder} holds a run of another specification; choose another --out or delete it")
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SpecError(f"{folder} holds something that is not a prt-bench run; choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    mark.write_text(json.dumps({"spec": digest, "name": spec.name}) + "\n", encoding="utf-8")


def _has_records(folder: Path) -> bool:
    return (folder / "records.jsonl").is_file()


def _fit(ds: LightingDataset, row: MethodSpec, chosen: Method, spec: RunSpec, folder: Path) -> Fitted:
    """Fit and export one method; what goes wrong becomes the row's status."""
    label = _label(row, chosen)
    fitted = Fitted(row, chosen, label)
    started = time.perf_counter()
    try:
        with _time_limit(spec.timeout):
            model = jax.block_until_ready(chosen.fit(ds.split("train"), jax.random.key(spec.seed)))
        fitted.seconds = time.perf_counter() - started
        if model.kernels:
            name = f"{ds.scene.name}-{ds.metadata['scenario']}-{label}".replace(" ", "-")
            fitted.asset = model.export(folder / "assets" / name, row.storage)
        else:
            fitted.status, fitted.reason = "oracle", "it needs the answer to predict it, so it cannot run in real time"
        fitted.model = model
    except TimeoutError:
        fitted.status, fitted.reason = "timeout", f"the fit took more than {spec.timeout:g} s"
    except OSError:  # a full disk, say: no fault of the method
        raise
    except Exception as error:  # a plug-in may fail in any way; the other rows are worth having
        say(f"{label} failed:\n{error if isinstance(error, PrtBenchError) else traceback.format_exc()}")
        fitted.status, fitted.reason = "failed", f"{type(error).__name__}: {error}"
    fitted.seconds = fitted.seconds or time.perf_counter() - started
    return fitted


def _measure(ds: LightingDataset, rows: Sequence[Fitted], spec: RunSpec, folder: Path) -> Iterator[Record]:
    """Accuracy, frames and timings of all rows on every held-out split."""
    assets = {row.label: row.asset for row in rows if row.asset is not None}
    frames, loaded = _load(ds, rows, spec, folder)
    timings = time_assets(ds, assets, loaded, spec.time)
    for split in [name for name in ds.splits if name != "train"]:
        held_out = ds.split(split)
        for row in track(rows, f"evaluate {ds.scene.name} ({split})"):
            seconds = {"fit": row.seconds}
            if row.model is None:
                record = describe(held_out, row.method, row.label, seconds)
            else:
                record = evaluate(row.model, held_out, row.asset, row.method, row.label, seconds)
                record = replace(record, timings=timings.get(row.label, ()))
                if frames is not None:
                    record = frames.complete(record, row.model, loaded.get(row.label), held_out)
            settings = {**record.settings, "storage": row.spec.storage}
            provenance = {**record.provenance, "seed": spec.seed}
            yield replace(record, status=row.status, reason=row.reason, settings=settings, provenance=provenance)


def _load(
    ds: LightingDataset, rows: Sequence[Fitted], spec: RunSpec, folder: Path
) -> tuple[FrameComparison | None, dict[str, LoadedAsset]]:
    """The runtime, where there is one, and the assets that it could load; a row that it cannot run says why."""
    shipped = {row.label: (row, row.asset) for row in rows if row.asset is not None}
    try:
        frames = FrameComparison(ds, spec.time, folder)
    except RuntimeUnavailable as error:
        say(f"{error}; rows have JAX timings only")
        for row, _ in shipped.values():
            row.status, row.reason = "no-gl", str(error)
        return None, {}
    loaded = {}
    for label, (row, asset) in shipped.items():
        try:
            loaded[label] = frames.runtime.load(asset)
        except AssetError as error:  # more than this GPU holds
            row.status, row.reason = "no-gl", str(error)
    return frames, loaded


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` in the main thread after `seconds`, once Python runs again."""

    def stop(_: int, __: FrameType | None) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
