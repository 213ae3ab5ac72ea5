"""The built-in scenes, one file each, found by looking into this folder.

A scene file has a docstring whose first line says what the scene is for, and `build() -> Scene`. Adding a scene is
adding a file. Scenes in users' own files are read by `data_gen.loader`.
"""

import importlib
import pkgutil
from pathlib import Path
from types import ModuleType

from data_gen.geometry import repair
from prt_bench.errors import SceneError
from prt_bench.scene import Scene


def scenes() -> list[str]:
    """Names of the built-in scenes."""
    return sorted(module.name.replace("_", "-") for module in pkgutil.iter_modules(__path__))


def summary(name: str) -> str:
    """First line of a built-in scene's description."""
    return (_module(name).__doc__ or "").strip().split("\n")[0]


def load_scene(source: str | Path) -> Scene:
    """A built-in scene by name, or a user's scene by path (.glb .gltf .obj .ply .stl, or a .toml scene file).

    Raises `SceneError` when there is no such scene or the file cannot be used.
    """
    if isinstance(source, str) and source in scenes():
        scene = _module(source).build()
        repair(scene.mesh, f"scene '{source}'")
        return scene
    raise SceneError(f"there is no scene '{source}'; built in are {', '.join(scenes())}")


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"{__name__}.{name.replace('-', '_')}")
