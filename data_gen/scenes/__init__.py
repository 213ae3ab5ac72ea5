"""The built-in scenes, one file each, found by looking into this folder.

A scene file has a docstring whose first line says what the scene is for, and `build() -> Scene`; a scene that moves has
`build(time=0.0)`, with the same faces at all times. Adding a scene is adding a file. Scenes in users' own files are read by
`data_gen.loader` and `data_gen.scene_file`.
"""

import importlib
import pkgutil
from difflib import get_close_matches
from inspect import signature
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


def load_scene(source: str | Path, time: float | None = None) -> Scene:
    """A built-in scene by name, or a user's scene by path (.glb .gltf .obj .ply .stl, or a .toml scene file).

    `time` chooses a pose of a built-in scene that moves. Raises `SceneError` when there is no such scene, the file cannot be
    used, or a time is given for a scene that does not move.
    """
    if isinstance(source, str) and source in scenes():
        build = _module(source).build
        if time is not None and "time" not in signature(build).parameters:
            raise SceneError(f"scene '{source}' does not move; leave out time={time:g}")
        scene = build() if time is None else build(time)
        repair(scene.mesh, f"scene '{source}'")
        return scene
    if time is not None:
        raise SceneError(f"{source} is not a built-in scene, and no other can be asked for the time {time:g}")
    path = Path(source)
    if not path.suffix and not path.exists():
        nearest = get_close_matches(str(source), scenes(), 1, 0.0)[0]
        raise SceneError(
            f"there is no scene '{source}'; did you mean '{nearest}' (of {', '.join(scenes())}), or a path to a mesh?"
        )
    return read_scene_file(path) if path.suffix.lower() == ".toml" else read_mesh(path)


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"{__name__}.{name.replace('-', '_')}")
