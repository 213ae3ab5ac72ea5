"""Benchmark records: one JSON object per (scene, scenario, split, method, setting, device), appended to `records.jsonl`.

Every table, plot, leaderboard and notebook is derived from records alone. A run that failed or timed out leaves a record
too, with its reason.
"""

import json
import os
import platform
import subprocess
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from prt_bench.errors import DatasetError

SCHEMA = 1


@dataclass(frozen=True)
class Errors:
    """Error figures on one split of held-out lightings. None where a figure was not measured.

    Relative figures, but for `runtime`, are root mean squares over lightings of ‖error‖ / ‖reference‖, so every lighting
    weighs the same; relative_rmse² = projection² + coefficient² for an orthonormal basis. Black lightings are left out. The
    error of a method that replaces direct light too includes what it gets wrong there, over the indirect light like any other.

    rmse [W/m²], relative_rmse, psnr [dB] (peak: largest reference value of each lighting), negative_share (of predicted
    values), energy_bias (relative error of the mean irradiance, signed), total (the same error over direct and indirect light
    together), noise_floor (split halves of the rays), projection
    (best the basis can do), coefficient (what transfer adds to it), storage (asset against the float64 model), runtime (GL
    against JAX, same measured vector, the worst of a few lightings), measurement (GL shadow-mapped direct light against
    ray-traced), flip and ssim (of a frame under the first lighting against the frame lit by the reference lightmap).
    """

    rmse: float | None = None
    relative_rmse: float | None = None
    psnr: float | None = None
    negative_share: float | None = None
    energy_bias: float | None = None
    total: float | None = None
    noise_floor: float | None = None
    projection: float | None = None
    coefficient: float | None = None
    storage: float | None = None
    runtime: float | None = None
    measurement: float | None = None
    flip: float | None = None
    ssim: float | None = None
    black_lightings: int = 0


@dataclass(frozen=True)
class Stage:
    """Milliseconds of one stage: median and interquartile range over interleaved rounds."""

    median: float
    iqr: float
    rounds: int


@dataclass(frozen=True)
class Timing:
    """Timings of one device: `stages` are shadow, measure, transfer, draw, frame (GL) or measure, transfer, reconstruct (JAX).

    `frame` is a whole frame as a user would see it; `baseline` is the same frame without indirect light, where a method leaves
    direct light to the runtime. `clock` is "wall" or "timer-query". Rows of different `device`s are never ranked together.
    """

    api: str  # "gl" or "jax"
    device: str
    software: bool
    clock: str
    resolution: tuple[int, int] | None
    stages: dict[str, Stage]
    baseline: Stage | None = None


@dataclass(frozen=True)
class Record:
    """One row. `role` is "method", "floor" or "ceiling"; `status` is "ok", "oracle" (cannot run in real time), "no-gl",
    "failed" or "timeout", with a `reason` unless ok."""

    scene: str
    scenario: str
    split: str  # "test" or "ood-<scenario>"
    method: str
    label: str  # method and the settings that tell its rows apart, e.g. "svd-ridge b16"
    settings: dict[str, Any]
    role: str
    status: str
    reason: str | None = None
    errors: Errors = field(default_factory=Errors)
    seconds: dict[str, float] = field(default_factory=dict)  # "bake", "fit"
    bytes: dict[str, int] = field(default_factory=dict)  # "asset", "basis", "transfer", "runtime"
    timings: tuple[Timing, ...] = ()
    curves: dict[str, list[float]] = field(default_factory=dict)  # "singular_values"; "training_…"
    dataset: dict[str, Any] = field(
        default_factory=dict
    )  # hash, texels, rays, plan, effects, predicted, actual, skips, …
    asset: dict[str, Any] = field(default_factory=dict)  # sha256, dtype
    pictures: dict[str, str] = field(default_factory=dict)  # name -> path relative to the run folder
    provenance: dict[str, Any] = field(default_factory=dict)
    schema: int = SCHEMA


def append(path: Path, *records: Record) -> None:
    """Append records, one line each, in one write, flushed to disk."""
    lines = "".join(json.dumps(asdict(record), allow_nan=False) + "\n" for record in records)
    with path.open("a", encoding="utf-8") as file:
        file.write(lines)
        file.flush()
        os.fsync(file.fileno())


def read(path: Path) -> list[Record]:
    """All records of a file. Raises `DatasetError` when the file is missing or a line is not a record of this schema."""
    if not path.is_file():
        raise DatasetError(f"there are no records at {path}; 'prt-bench run' makes them")
    records = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            records.append(from_json(json.loads(line)))
        except (ValueError, TypeError, KeyError) as error:
            raise DatasetError(f"{path}, line {number} is not a record of schema {SCHEMA} ({error})") from error
    return records


def from_json(data: dict[str, Any]) -> Record:
    """The inverse of `dataclasses.asdict` on a `Record`."""
    if data.get("schema") != SCHEMA:
        raise ValueError(f"schema {data.get('schema')}")
    timings = tuple(
        Timing(
            **{
                **timing,
                "resolution": tuple(timing["resolution"]) if timing["resolution"] else None,
                "stages": {name: Stage(**stage) for name, stage in timing["stages"].items()},
                "baseline": Stage(**timing["baseline"]) if timing["baseline"] else None,
            }
        )
        for timing in data["timings"]
    )
    return Record(**{**data, "errors": Errors(**data["errors"]), "timings": timings})


@lru_cache(maxsize=1)
def provenance() -> dict[str, Any]:
    """Versions, commit and hardware of this process, for every record it writes."""
    packages = ("prt-bench", "jax", "jaxlib", "numpy", "scipy", "embreex", "trimesh", "xatlas", "moderngl", "zarr")
    return {
        "packages": {name: found for name in packages if (found := _version(name))},
        "commit": _commit(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": _cpu_name(),
        "cores": os.cpu_count(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    """The checkout's commit, marked when the tree differs from it; None outside a checkout."""
    here = Path(__file__).resolve().parent
    try:
        run = subprocess.run(
            ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
            capture_output=True, text=True, timeout=10, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return run.stdout.strip()


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )
