"""Records of a run that never took place: made-up figures of realistic size, to exercise tables, plots and queries."""

import math
from pathlib import Path

import numpy as np
import pytest

from prt_bench.records import Errors, Record, Stage, Timing, append
from prt_bench.report.pictures import write_picture

PROVENANCE = {
    "packages": {"prt-bench": "0.1.0", "jax": "0.10.2", "numpy": "2.4.6", "moderngl": "5.13.0"},
    "commit": "0123456789ab", "python": "3.11.2", "system": "Linux x86_64", "cpu": "Example CPU", "cores": 2,
    "date": "2026-01-02T03:04:05+00:00",
}  # fmt: skip
RENDERER = "llvmpipe (LLVM 15.0.6, 256 bits)"
PLAN = [
    {
        "what": "bounces",
        "decision": "9",
        "why": "the Neumann tail after 9 bounces is at most 1.0e-03 of the direct light",
    },
    {"what": "channels", "decision": "3", "why": "albedos differ between channels by up to 0.58"},
    {"what": "subsurface", "decision": "skipped", "why": "no material has a subsurface block"},
]


def stage(median: float) -> Stage:
    return Stage(median, 0.04 * median, 7)


def timings(
    basis: int, device: str = RENDERER, speed: float = 1.0, gl: bool = True, resolution: tuple[int, int] = (640, 480)
) -> tuple[Timing, ...]:
    measure, transfer, draw = 1.1 * speed, (0.05 + 0.004 * basis) * speed, (6.5 + 0.13 * basis) * speed
    stages = {"shadow": stage(2.0 * speed), "measure": stage(measure), "transfer": stage(transfer), "draw": stage(draw)}
    stages["frame"] = stage(2.0 * speed + measure + transfer + draw)
    found = [Timing("gl", device, True, "wall", resolution, stages, baseline=stage(8.5 * speed))] if gl else []
    jax = {"measure": stage(0.4), "transfer": stage(0.02 + 0.001 * basis), "reconstruct": stage(0.3 + 0.05 * basis)}
    return (*found, Timing("jax", "cpu", False, "wall", None, jax))


def a_record(label: str = "svd-ridge b16", error: float | None = 0.02, basis: int = 16, **changes) -> Record:
    method, _, setting = label.partition(" b")
    coefficient = None if error is None else 0.4 * error
    figures = {
        "scene": "cornell", "scenario": "spot", "split": "test", "method": method, "label": label, "role": "method",
        "status": "ok", "settings": {"basis": basis, "ridge": 1e-3} if setting else {},
        "errors": Errors() if error is None else Errors(
            rmse=0.31 * error, relative_rmse=error, total=0.2 * error, negative_share=0.01 * error,
            psnr=-20 * math.log10(error / 3) if error else None,
            energy_bias=-0.1 * error, noise_floor=0.012, projection=math.sqrt(error**2 - coefficient**2),
            coefficient=coefficient, storage=3e-4, runtime=6e-5, measurement=0.02, flip=0.4 * error, ssim=1 - error,
        ),
        "seconds": {"bake": 12.5, "fit": 0.02 * basis},
        "bytes": {"asset": 65536 * basis + 999, "basis": 65536 * basis, "transfer": 1024 * basis,
                  "runtime": 66560 * basis},
        "timings": timings(basis),
        "curves": {"singular_values": [1 / (1 + k) ** 1.5 for k in range(64)]} if method.endswith("ridge") else {},
        "dataset": {
            "hash": "9f2c" * 16, "texels": 128, "lightings": 128, "rays": 256, "measurements": 256, "seed": 0,
            "plan": PLAN, "effects": [],
        },
        "asset": {"sha256": "ab" * 32, "dtype": "float16"},
        "provenance": PROVENANCE,
    }  # fmt: skip
    return Record(**{**figures, **changes})


def make_run() -> list[Record]:
    found = []
    for scene, difficulty in (("cornell", 1.0), ("suzanne", 1.7)):
        for split, loss in (("test", 1.0), ("ood-environment", 3.4)):
            where = {"scene": scene, "split": split}
            scale = difficulty * loss
            for basis in (4, 8, 16, 32, 64):
                error = scale * 0.012 + scale * 0.45 / basis
                found.append(a_record(f"svd-ridge b{basis}", error, basis, **where))
                found.append(a_record(f"operator-ridge b{basis}", 0.7 * error + 0.002, basis + 3, **where))
            found.append(a_record("constant", 0.93 * difficulty**0.1, 0, role="floor", **where))
            found.append(a_record("mean", 0.61 * difficulty**0.3, 1, role="floor", **where))
            found.append(a_record("nearest", min(0.41 * scale, 0.9), 128, **where))
            found.append(
                a_record(
                    "projection",
                    0.011 * scale,
                    64,
                    role="ceiling",
                    status="oracle",
                    reason="needs the reference at run time",
                    timings=timings(64, gl=False),
                    **where,
                )
            )
            found.append(
                a_record(
                    "reference",
                    0.0,
                    0,
                    role="ceiling",
                    status="oracle",
                    timings=(),
                    seconds={},
                    reason="is the reference itself",
                    bytes={},
                    **where,
                )
            )
            found.append(
                a_record(
                    "mlp-large",
                    None,
                    timings=(),
                    bytes={},
                    seconds={"bake": 12.5},
                    asset={},
                    curves={},
                    status="timeout",
                    reason="the fit took over 60 s",
                    **where,
                )
            )
    return found


def picture(scene: str, error: float, seed: int, height: int) -> np.ndarray:
    """A shaded sphere before two coloured walls, off by a smooth pattern of relative size `error`."""
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-4 / 3, 4 / 3, height * 4 // 3), indexing="ij")
    z = np.sqrt(np.maximum(0.36 - x**2 - y**2, 0))
    ball = z > 0
    wall = np.stack([np.where(x < 0, 0.6, 0.1), np.full_like(x, 0.25), np.where(x < 0, 0.1, 0.6)], -1)
    light = np.exp(-2 * ((x - 0.4) ** 2 + (y + 0.6) ** 2))[..., None]
    shade = np.maximum(0.5 * x - 0.7 * y + 0.6 * z, 0)[..., None] / 0.6
    image = np.where(ball[..., None], shade * [0.8, 0.75, 0.7], 3 * light * wall + 0.02)
    tilt = np.sin(7 * x + seed) * np.cos(5 * y - seed)
    return (image * (2 if scene == "suzanne" else 1) * (1 + error * tilt[..., None])).astype(np.float32)


@pytest.fixture
def make_record():
    """The maker of one record; keyword arguments replace its fields."""
    return a_record


@pytest.fixture
def make_timings():
    """The maker of a record's timings, for other devices, speeds and resolutions."""
    return timings


@pytest.fixture
def records() -> list[Record]:
    return make_run()


@pytest.fixture(scope="package")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("report") / "run", height=48)


def write_run(folder: Path, height: int = 240) -> Path:
    """A run folder with records and pictures, as a run leaves it."""
    folder.mkdir(parents=True)
    for number, record in enumerate(make_run()):
        error = record.errors.relative_rmse
        base = f"pictures/{record.scene}-{record.scenario}-{record.split}"
        views = {
            "reference": ("-reference", 0.0, 1.0), "indirect_reference": ("-reference-indirect", 0.0, 0.3),
            "prediction": (f"-{record.label}", error, 1.0), "indirect": (f"-{record.label}-indirect", error, 0.3),
        } if error is not None else {}  # fmt: skip
        paths = {key: f"{base}{ending}.exr" for key, (ending, _, _) in views.items()}
        for key, (_, size, scale) in views.items():
            write_picture(folder / paths[key], scale * picture(record.scene, size, number, height))
        append(folder / "records.jsonl", Record(**{**vars(record), "pictures": paths}))
    return folder
