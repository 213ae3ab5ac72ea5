"""Scene files: TOML that names a mesh and says how to look at it and what it is made of.

mesh = "teapot.obj"            # beside this file, or an absolute path
name = "teapot"                # optional, like everything below
scale = 0.01                   # metres per unit of the mesh
up = "z"                       # the mesh's vertical axis
[camera]
position = [0.0, 1.0, 4.0]
target = [0.0, 0.5, 0.0]
fov_y = 40.0
[materials.lid]
albedo = [0.6, 0.1, 0.1]       # linear RGB
two_sided = true
[materials.lid.glossy]         # a lobe beside the diffuse reflection; albedo + specular ≤ 1
specular = [0.2, 0.2, 0.2]
exponent = 20.0
[materials.body.subsurface]    # a medium inside a closed surface: coefficients per metre, red, green, blue
scattering = [900.0, 700.0, 400.0]
absorption = [1.0, 3.0, 12.0]  # or, instead of both, albedo = [...] and mean_free_path = [...] in metres
anisotropy = 0.3
ior = 1.4
[hair.fur]                     # strands that grow on a material's faces; lengths in metres
on = "body"
strands = 10000
length = 0.05
radius = 5e-5
colour = [0.5, 0.3, 0.15]      # or absorption = [...] per radius
longitudinal = 0.3             # roughness from 0 to 1 along the fibre, and azimuthal around it; also ior, tilt,
fall = 0.5                     # segments, spread, curl, vary (see `data_gen.strands.Growth`) and seed
"""

import tomllib
from collections.abc import Mapping
from dataclasses import fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from data_gen.loader import MeshOptions, read_mesh
from data_gen.strands import Growth, grow
from prt_bench.errors import SceneError
from prt_bench.hair import Hair, absorption_of
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Glossy, Material, Scene

_KEYS = ("mesh", "hair", *(field.name for field in fields(MeshOptions)))
_CAMERA_KEYS = tuple(field.name for field in fields(Camera))
_MATERIAL_KEYS = ("albedo", "two_sided", "glossy", "subsurface")
_MEDIUM_KEYS = ("scattering", "absorption", "albedo", "mean_free_path", "anisotropy", "ior")
_GLOSSY_KEYS = ("specular", "exponent")
_GROWTH_KEYS = tuple(field.name for field in fields(Growth))
_FIBRE_KEYS = ("longitudinal", "azimuthal", "ior", "tilt")
_HAIR_KEYS = ("on", "strands", "seed", "colour", "absorption", *_FIBRE_KEYS, *_GROWTH_KEYS)
_UP = ("x", "y", "z")


def read_scene_file(path: Path) -> Scene:
    """Read a scene file and its mesh. Raises `SceneError` for an unknown key or impossible value, naming it."""
    if not path.is_file():
        raise SceneError(f"scene file {path} does not exist")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"scene file {path} is not valid TOML: {error}") from error
    _check_keys(data, _KEYS, path, "")
    if not isinstance(data.get("mesh"), str):
        raise SceneError(f'scene file {path} names no mesh; add mesh = "FILE"')
    if not isinstance(data.get("name", ""), str):
        raise SceneError(f"scene file {path}: name is {data['name']!r}, but must be a text in quotes")
    options = MeshOptions(
        name=data.get("name", path.stem),
        scale=_scale(data, path),
        up=_up(data, path),
        camera=_camera(_table(data, "camera", path), path) if "camera" in data else None,
        materials={
            name: _material(_table(_table(data, "materials", path), name, path), name, path)
            for name in _table(data, "materials", path)
        },
    )
    scene = read_mesh(path.parent / data["mesh"], options)
    for name in _table(data, "hair", path):
        scene = _with_hair(scene, _table(_table(data, "hair", path), name, path), name, path)
    return scene


def _with_hair(scene: Scene, table: Mapping[str, Any], name: str, path: Path) -> Scene:
    where = f"hair.{name}."
    _check_keys(table, _HAIR_KEYS, path, where)
    names = [material.name for material in scene.materials]
    for key in ("on", "strands", "length", "radius"):
        if key not in table:
            raise SceneError(
                f"scene file {path}: {where.removesuffix('.')} needs on, strands, length and radius, not only some"
            )
    if table["on"] not in names:
        raise SceneError(f"scene file {path}: {where}on is {table['on']!r}, but the materials are {', '.join(names)}")
    if ("colour" in table) == ("absorption" in table):
        raise SceneError(f"scene file {path}: {where.removesuffix('.')} needs either a colour or an absorption")
    for key in set(table) - {"on", "colour", "absorption"}:
        whole = key in ("strands", "seed", "segments")
        if not (isinstance(table[key], int) if whole else _is_number(table[key])) or isinstance(table[key], bool):
            raise SceneError(
                f"scene file {path}: {where}{key} is {table[key]!r}, but must be a {'whole ' * whole}number"
            )
    try:
        fibre = {key: float(table[key]) for key in _FIBRE_KEYS if key in table}
        if "colour" in table:
            absorption = absorption_of(_triple(table["colour"], f"{where}colour", path), fibre.get("azimuthal", 0.3))
        else:
            absorption = _triple(table["absorption"], f"{where}absorption", path)
        hair = Material(name, hair=Hair.of_roughness(absorption, **fibre))
        growth = Growth(**{key: table[key] for key in _GROWTH_KEYS if key in table})
        seeded = replace(scene, materials=(*scene.materials, hair))
        return grow(seeded, names.index(table["on"]), len(names), table["strands"], growth, table.get("seed", 0))
    except SceneError as error:
        raise SceneError(f"scene file {path}, {where.removesuffix('.')}: {error}") from error


def _scale(data: Mapping[str, Any], path: Path) -> float | None:
    if "scale" not in data:
        return None
    if not _is_number(data["scale"]) or not 0 < data["scale"] < float("inf"):
        raise SceneError(f"scene file {path}: scale is {data['scale']!r}, but must be a number above zero")
    return float(data["scale"])


def _up(data: Mapping[str, Any], path: Path) -> str:
    up = data.get("up", "y")
    if up not in _UP:
        raise SceneError(f"scene file {path}: up is {up!r}, but must be one of {', '.join(_UP)}")
    return up


def _camera(table: Mapping[str, Any], path: Path) -> Camera:
    _check_keys(table, _CAMERA_KEYS, path, "camera.")
    for key in ("position", "target"):
        if key not in table:
            raise SceneError(f"scene file {path}: the camera needs a {key} = [x, y, z]")
    values: dict[str, Any] = {key: _triple(table[key], f"camera.{key}", path) for key in table if key != "fov_y"}
    if "fov_y" in table:
        if not _is_number(table["fov_y"]) or not 0 < table["fov_y"] < 180:
            raise SceneError(f"scene file {path}: camera.fov_y is {table['fov_y']!r}, but must lie between 0 and 180")
        values["fov_y"] = float(table["fov_y"])
    return Camera(**values)


def _material(table: Mapping[str, Any], name: str, path: Path) -> dict[str, Any]:
    where = f"materials.{name}."
    _check_keys(table, _MATERIAL_KEYS, path, where)
    values: dict[str, Any] = {}
    if "albedo" in table:
        values["albedo"] = _triple(table["albedo"], f"{where}albedo", path)
        if not all(0 <= value <= 1 for value in values["albedo"]):
            raise SceneError(f"scene file {path}: {where}albedo is {table['albedo']}, but an albedo lies from 0 to 1")
    if "two_sided" in table:
        if not isinstance(table["two_sided"], bool):
            raise SceneError(
                f"scene file {path}: {where}two_sided is {table['two_sided']!r}, but must be true or false"
            )
        values["two_sided"] = table["two_sided"]
    if "glossy" in table:
        values["glossy"] = _glossy(_table(table, "glossy", path), f"{where}glossy.", path)
    if "subsurface" in table:
        values["subsurface"] = _medium(_table(table, "subsurface", path), f"{where}subsurface.", path)
        values.setdefault("albedo", (0.0, 0.0, 0.0))  # the medium gives the colour
    return values


def _medium(table: Mapping[str, Any], where: str, path: Path) -> Subsurface:
    _check_keys(table, _MEDIUM_KEYS, path, where)
    pairs = [pair for pair in (("scattering", "absorption"), ("albedo", "mean_free_path")) if set(pair) & set(table)]
    if len(pairs) != 1 or not set(pairs[0]) <= set(table):
        raise SceneError(
            f"scene file {path}: {where.removesuffix('.')} needs scattering and absorption, or albedo and mean_free_path"
        )
    values: dict[str, Any] = {key: _triple(table[key], f"{where}{key}", path) for key in pairs[0]}
    for key in {"anisotropy", "ior"} & set(table):
        if not _is_number(table[key]):
            raise SceneError(f"scene file {path}: {where}{key} is {table[key]!r}, but must be a number")
        values[key] = float(table[key])
    try:
        return (Subsurface if "scattering" in values else Subsurface.of_albedo)(**values)
    except SceneError as error:
        raise SceneError(f"scene file {path}, {where.removesuffix('.')}: {error}") from error


def _glossy(table: Mapping[str, Any], where: str, path: Path) -> Glossy:
    _check_keys(table, _GLOSSY_KEYS, path, where)
    values: dict[str, Any] = {}
    if "specular" in table:
        values["specular"] = _triple(table["specular"], f"{where}specular", path)
    if "exponent" in table:
        if not _is_number(table["exponent"]):
            raise SceneError(f"scene file {path}: {where}exponent is {table['exponent']!r}, but must be a number")
        values["exponent"] = float(table["exponent"])
    try:
        return Glossy(**values)
    except SceneError as error:
        raise SceneError(f"scene file {path}, {where.removesuffix('.')}: {error}") from error


def _check_keys(table: Mapping[str, Any], known: tuple[str, ...], path: Path, where: str) -> None:
    for key in table:
        if key not in known:
            nearest = get_close_matches(key, known, 1, 0.0)[0]
            raise SceneError(f"scene file {path} has an unknown key '{where}{key}'; did you mean '{where}{nearest}'?")


def _table(data: Mapping[str, Any], key: str, path: Path) -> Mapping[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise SceneError(f"scene file {path}: '{key}' must be a table, not {table!r}")
    return table


def _triple(value: Any, where: str, path: Path) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3 or not all(_is_number(v) for v in value):
        raise SceneError(f"scene file {path}: {where} is {value!r}, but must be three numbers")
    return float(value[0]), float(value[1]), float(value[2])


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
