"""Vendored CC0 files: a mesh and eight environment maps. Sources and licences are in `SOURCES.md`."""

from pathlib import Path

_HERE = Path(__file__).parent

SUZANNE = _HERE / "suzanne.ply"


def environment_maps() -> dict[str, Path]:
    """Paths of the equirectangular EXR maps by name, in alphabetical order."""
    return {path.stem: path for path in sorted((_HERE / "environments").glob("*.exr"))}
