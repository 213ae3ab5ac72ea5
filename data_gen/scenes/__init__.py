"""The built-in scenes, one file each, found by looking into this folder.

A scene file has a docstring whose first line says what the scene is for, and `build() -> Scene`. Adding a scene is
adding a file. Scenes in users' own files are read by `data_gen.loader` and `data_gen.scene_file`.
"""

import importlib
import pkgutil
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType

from data_gen.geometry import repair
from data_gen.loader import read_mesh
from data_gen.scene_file import read_scene_file
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
    path = Path(source)
    if not path.suffix and not path.exists():
        nearest = get_close_matches(str(source), scenes(), 1, 0.0)[0]
        raise SceneError(
            f"there is no scene '{source}'; did you mean '{nearest}' (of {', '.join(scenes())}), or a path to a mesh?"
        )
    return read_scene_file(path) if path.suffix.lower() == ".toml" else read_mesh(path)


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"{__name__}.{name.replace('-', '_')}")
