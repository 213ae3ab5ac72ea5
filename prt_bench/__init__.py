"""prt-bench: what accurate indirect light costs in real time.

The public surface. Everything here is importable as `prt.NAME`; what needs ray tracing or OpenGL is imported on first use,
so that fitting and reading records need neither.

Importing this package switches on JAX's 64-bit mode: transfer models are fitted in float64 and shipped in float32 or less.
"""

from importlib import import_module
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

from prt_bench.animation import fit_keyframes  # noqa: E402
from prt_bench.assets import load_asset  # noqa: E402
from prt_bench.clip import Clip  # noqa: E402
from prt_bench.dataset import LightingDataset  # noqa: E402
from prt_bench.evaluate import evaluate  # noqa: E402
from prt_bench.lights import (  # noqa: E402
    DirectionalLight,
    EnvironmentLight,
    Lighting,
    PointLight,
    RectLight,
    SphereLight,
    SpotLight,
)
from prt_bench.methods import method, methods  # noqa: E402
from prt_bench.scene import Camera, Material, Mesh, Scene  # noqa: E402

__version__ = "0.1.0"

_ON_FIRST_USE = {
    "scenes": "data_gen.scenes",
    "load_scene": "data_gen.scenes",
    "plan": "data_gen.plan",
    "bake": "data_gen.bake",
    "light": "data_gen.bake",
    "bake_animation": "data_gen.animation",
    "keyframe_times": "data_gen.animation",
    "probes": "data_gen.effects.probes",
    "directional": "data_gen.effects.directional",
    "seen": "data_gen.direct",
    "skips": "data_gen.skips",
}

__all__ = [
    "Camera",
    "Clip",
    "DirectionalLight",
    "EnvironmentLight",
    "Lighting",
    "LightingDataset",
    "Material",
    "Mesh",
    "PointLight",
    "RectLight",
    "Scene",
    "SphereLight",
    "SpotLight",
    "bake",
    "bake_animation",
    "directional",
    "evaluate",
    "fit_keyframes",
    "keyframe_times",
    "light",
    "load_asset",
    "load_scene",
    "method",
    "methods",
    "plan",
    "probes",
    "scenes",
    "seen",
    "skips",
]


def __getattr__(name: str) -> Any:
    if name in _ON_FIRST_USE:
        return getattr(import_module(_ON_FIRST_USE[name]), name)
    raise AttributeError(f"module 'prt_bench' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_ON_FIRST_USE])
