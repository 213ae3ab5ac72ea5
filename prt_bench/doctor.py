"""What this machine offers prt-bench, and what is missing for what: `prt-bench doctor`.

Looks, measures nothing, and reports a missing part as a row instead of failing.
"""

import ctypes.util
import os
import platform
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from prt_bench.errors import RuntimeUnavailable
from prt_bench.store import data_folder

_REINSTALL = "python -m pip install --force-reinstall prt-bench"
_GL_LIMITS = {
    "GL_MAX_TEXTURE_SIZE": "texture side",
    "GL_MAX_ARRAY_TEXTURE_LAYERS": "texture layers",
    "GL_MAX_SHADER_STORAGE_BLOCK_SIZE": "storage buffer bytes",
    "GL_MAX_COMPUTE_WORK_GROUP_INVOCATIONS": "workgroup size",
}


@dataclass(frozen=True)
class Finding:
    """One part of the machine. `found` says what there is, None that it is missing; `remedy` is what to type then."""

    part: str
    found: str | None
    needed_for: str
    remedy: str = ""


def report() -> list[Finding]:
    """Everything worth knowing before a run, in the order in which a run meets it."""
    return [
        Finding("machine", f"{platform.platform()}, Python {platform.python_version()}", "everything"),
        Finding("cores", str(os.cpu_count()), "tracing, and drawing on a software renderer"),
        Finding("memory", _memory(), "lightmaps of 1024² need 8 GB"),
        Finding("disk", _disk(), "datasets, under $PRT_BENCH_DATA or the user's cache"),
        Finding("JAX", _jax(), "transport, fits, and the timings of api 'jax'"),
        _package("embreex", "embreex.rtcore_scene", "tracing rays"),
        _package("xatlas", "xatlas", "unwrapping meshes"),
        _package("trimesh", "trimesh", "reading meshes"),
        _package("OpenEXR", "OpenEXR", "environment maps and EXR frames"),
        _package("flip-evaluator", "flip_evaluator", "the FLIP of rendered frames"),
        *_opengl(),
        Finding("Tk", _tk(), "the window of prt-bench view", "apt-get install python3-tk"),
        _package("DracoPy", "DracoPy", "Draco-compressed glTF", "python -m pip install 'prt-bench[draco]'"),
        _package("mitsuba", "mitsuba", "the tests that compare with mitsuba", "python -m pip install 'prt-bench[dev]'"),
        Finding("LLVM", _llvm(), "mitsuba's llvm_ad_rgb, in the tests", "apt-get install libllvm19"),
    ]


def print_report() -> None:
    """Print `report` as a table; what is missing comes with the line that installs it."""
    table = Table(box=None, header_style="dim", padding=(0, 1))
    for head in ("", "Part", "Found", "Needed for"):
        table.add_column(head, overflow="fold")
    for row in report():
        mark = Text("✓", "green") if row.found else Text("✗", "red")
        table.add_row(mark, row.part, Text(row.found or f"missing: {row.remedy}"), Text(row.needed_for, "dim"))
    Console().print(table)


def _package(name: str, module: str, needed_for: str, remedy: str = _REINSTALL) -> Finding:
    """A Python package, imported to see that its shared libraries load too."""
    try:
        import_module(module)
        return Finding(name, version(name), needed_for)
    except (ImportError, OSError, PackageNotFoundError):
        return Finding(name, None, needed_for, remedy)


def _opengl() -> list[Finding]:
    needed_for = "frames, their timings and FLIP; without it only JAX is timed"
    try:
        from prt_bench.runtime.context import headless, is_software, renderer

        context = headless()
    except (ImportError, RuntimeUnavailable):
        return [
            Finding(
                "OpenGL 4.3", None, needed_for, "apt-get install libegl1 libgl1 libgl1-mesa-dri, or the GPU's driver"
            )
        ]
    name = renderer(context)
    kind = "software, timed by the wall clock" if is_software(name) else "GPU, timed by timer queries"
    limits = ", ".join(f"{text} {context.info[key]}" for key, text in _GL_LIMITS.items() if key in context.info)
    return [
        Finding(f"OpenGL {'.'.join(str(context.version_code // 10))}", f"{name} ({kind})", needed_for),
        Finding("OpenGL limits", limits, "lightmap size, number of basis functions and measurement points"),
    ]


def _jax() -> str:
    import jax

    devices = ", ".join(device.device_kind for device in jax.devices())
    return f"{jax.__version__} on {devices}; 64-bit floats {'on' if jax.config.jax_enable_x64 else 'off'}"  # pyright: ignore


def _tk() -> str | None:
    try:
        return str(import_module("tkinter").TkVersion)
    except ImportError:
        return None


def _memory() -> str:
    return _or_unknown(lambda: f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 1e9:.1f} GB")


def _disk() -> str:
    def free() -> str:

        folder: Path = data_folder()
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        return f"{shutil.disk_usage(existing).free / 1e9:.1f} GB free at {folder}"

    return _or_unknown(free)


def _llvm() -> str | None:
    """Mitsuba wants LLVM 17 or later: older ones abort on AVX-512."""
    names = (ctypes.util.find_library(f"LLVM-{major}") for major in range(30, 16, -1))
    return next((name for name in names if name), None)


def _or_unknown(look: Callable[[], str]) -> str:
    try:
        return look()
    except (AttributeError, ValueError, OSError, ImportError):  # this system does not tell
        return "unknown"
