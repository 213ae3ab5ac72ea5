"""Scenes, points and lightmaps as zarr groups. Values only: what a dataset is lives in `dataset.py`."""

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from prt_bench.errors import DatasetError
from prt_bench.hair import Hair
from prt_bench.medium import Subsurface
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Camera, Glossy, Material, Mesh, Scene
from prt_bench.strands import Strands

FORMAT = 2
"""Part of every store's name, so that what an earlier version wrote is left alone and baked anew."""
_POINT_FIELDS = ("position", "normal", "albedo", "face", "barycentric")
_STRANDS = ("nodes", "starts", "radius", "material")


def data_folder() -> Path:
    """Where data goes unless told otherwise: $PRT_BENCH_DATA, or prt-bench in the user's cache folder."""
    chosen = os.environ.get("PRT_BENCH_DATA")
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return Path(chosen) if chosen else cache / "prt-bench"


def open_group(path: Path, kind: str) -> Any:  # a zarr.Group, whose members have no useful types
    """Open a finished store of `kind` for reading. Raises `DatasetError` when it is missing, foreign or newer."""
    if not path.is_dir():
        raise DatasetError(f"there is no {kind} at {path}; 'prt-bench bake' makes one")
    try:
        group = zarr.open_group(path, mode="r")
    except (FileNotFoundError, ValueError, KeyError) as error:
        raise DatasetError(f"{path} is not a {kind} of prt-bench; name a folder that 'prt-bench bake' made") from error
    if group.attrs.get("kind") != kind:
        found = group.attrs.get("kind", "something else")
        raise DatasetError(f"{path} holds {found}, not a {kind}; name a folder that 'prt-bench bake' made")
    if group.attrs.get("format") != FORMAT:
        raise DatasetError(
            f"{path} has format {group.attrs.get('format')}, but this version reads {FORMAT}; bake it again"
        )
    return group


def write_points(group: zarr.Group, name: str, points: SurfacePoints) -> None:
    """Store surface points as a subgroup."""
    child = group.require_group(name)
    for field in _POINT_FIELDS:
        write_array(child, field, getattr(points, field))
    if points.clearance is not None:
        write_array(child, "clearance", points.clearance)


def read_points(group: zarr.Group, name: str) -> SurfacePoints:
    """The inverse of `write_points`."""
    clearance = _array(group, f"{name}/clearance") if f"{name}/clearance" in group else None
    return SurfacePoints(*(_array(group, f"{name}/{field}") for field in _POINT_FIELDS), clearance=clearance)


def write_lightmap(group: zarr.Group, name: str, lightmap: Lightmap) -> None:
    """Store a lightmap's layout as a subgroup."""
    child = group.require_group(name)
    child.attrs.update({"resolution": lightmap.resolution, "mips": lightmap.mips})
    for field in ("texel", "corner_uv", "chart"):
        write_array(child, field, getattr(lightmap, field))


def read_lightmap(group: zarr.Group, name: str) -> Lightmap:
    """The inverse of `write_lightmap`."""
    attributes = group[name].attrs
    arrays = (_array(group, f"{name}/{field}") for field in ("texel", "corner_uv", "chart"))
    return Lightmap(int(attributes["resolution"]), *arrays, mips=int(attributes.get("mips", 0)))


def write_scene(group: zarr.Group, scene: Scene) -> None:
    """Store a scene as the subgroup `scene`."""
    child = group.require_group("scene")
    mesh = scene.mesh
    for name, array in (("vertices", mesh.vertices), ("faces", mesh.faces), ("material", mesh.material)):
        write_array(child, name, array)
    if mesh.uv is not None:
        write_array(child, "uv", mesh.uv)
    for index, material in enumerate(scene.materials):
        roughness = material.glossy and material.glossy.roughness_image
        for kind, image in (("image", material.image), ("roughness", roughness), ("normal", material.normal_image)):
            if image is not None:
                write_array(child, f"{kind}-{index}", image)
    if scene.strands is not None:
        for name in _STRANDS:
            write_array(child.require_group("strands"), name, getattr(scene.strands, name))
    child.attrs["description"] = json.dumps(
        {
            "name": scene.name,
            "notes": scene.notes,
            "camera": vars(scene.camera),
            "materials": [_about(material) for material in scene.materials],
        }
    )


def read_scene(group: Any) -> Scene:
    """The inverse of `write_scene`."""
    about: dict[str, Any] = json.loads(str(group["scene"].attrs["description"]))
    names = set(group["scene"].array_keys())

    def kept(name: str) -> np.ndarray | None:
        return _array(group, f"scene/{name}") if name in names else None

    mesh = Mesh(*(_array(group, f"scene/{name}") for name in ("vertices", "faces", "material")), uv=kept("uv"))
    materials = []
    for index, entry in enumerate(about["materials"]):
        lobe, medium, hair = entry.get("glossy"), entry.get("subsurface"), entry.get("hair")
        materials.append(
            Material(
                entry["name"],
                tuple(entry["albedo"]),
                kept(f"image-{index}"),
                entry["two_sided"],
                lobe and Glossy(tuple(lobe["specular"]), lobe["exponent"], kept(f"roughness-{index}")),
                kept(f"normal-{index}"),
                medium and Subsurface(**{key: tuple(v) if isinstance(v, list) else v for key, v in medium.items()}),
                hair and Hair(**{key: tuple(v) if isinstance(v, list) else v for key, v in hair.items()}),
            )
        )
    strands = None
    if "strands" in group["scene"]:
        strands = Strands(*(_array(group, f"scene/strands/{name}") for name in _STRANDS))
    camera = camera_from_json(about["camera"])
    return Scene(about["name"], mesh, tuple(materials), camera, tuple(about["notes"]), strands)


def _about(material: Material) -> dict[str, Any]:
    """A material without its images, for JSON."""
    about = {"name": material.name, "albedo": material.albedo, "two_sided": material.two_sided}
    if material.subsurface is not None:
        about["subsurface"] = vars(material.subsurface)
    if material.hair is not None:
        about["hair"] = {field.name: getattr(material.hair, field.name) for field in fields(Hair)}
    if material.glossy is None:
        return about
    return {**about, "glossy": {"specular": material.glossy.specular, "exponent": material.glossy.exponent}}


def camera_from_json(about: dict[str, Any]) -> Camera:
    """The inverse of `vars` on a `Camera`, after JSON has made lists of its tuples."""
    return Camera(**{key: tuple(value) if isinstance(value, list) else value for key, value in about.items()})


def write_array(group: zarr.Group, key: str, array: np.ndarray, **attributes: str) -> None:
    """Store one array uncompressed as a single chunk, replacing what an interrupted run may have left."""
    array = np.ascontiguousarray(array)
    made = group.create_array(key, data=array, chunks=array.shape, compressors=None, overwrite=True)
    made.attrs.update(attributes)


def member(group: Any, path: str) -> Any:
    """An array or subgroup. Raises `DatasetError` when the store has lost it."""
    if path not in group:
        raise DatasetError(f"{group.store.root} has lost its {path}; delete it and bake it again")
    return group[path]


def _array(group: zarr.Group, path: str) -> np.ndarray:
    return np.asarray(member(group, path)[...])
