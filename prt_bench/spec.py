"""Run specifications: TOML tables turned into frozen dataclasses, with errors that name the file, the key and a remedy."""

import difflib
import itertools
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Self, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from prt_bench.assets import DTYPES
from prt_bench.errors import SpecError

T = TypeVar("T")


@dataclass(frozen=True)
class BakeSpec:
    """What to bake for every scene and scenario; the meaning of each key is that of `data_gen.bake.bake`."""

    scenarios: tuple[str, ...] = ("point",)
    ood: tuple[str, ...] = ()
    lightings: int = 128
    texels: int = 128
    rays: int | str = 256
    measurements: int = 256
    supersampling: int = 8
    tolerance: float = 1e-4
    gather_texels: int | str | None = None
    streamed: int = 0
    measure_on: str = "surface"
    vertices: bool = False
    node_rays: int = 0
    node_tolerance: float = 0.02
    mips: int = 0
    texture_set: bool = False
    noise: float = 0.02
    gather_tolerance: float = 0.05
    force: tuple[str, ...] = ()


@dataclass(frozen=True)
class TimeSpec:
    """How frames are timed: size in pixels, side of the shadow atlas in texels, interleaved rounds, untimed warm-up rounds."""

    size: tuple[int, int] = (640, 480)
    shadow_resolution: int = 2048
    rounds: int = 7
    warmup: int = 2

    def __post_init__(self) -> None:
        least = {"size": 16, "shadow_resolution": 16, "rounds": 1, "warmup": 0}
        for name, bound in least.items():
            if np.min(getattr(self, name)) < bound:
                raise SpecError(f"{name} is {getattr(self, name)}, but must be at least {bound}")


@dataclass(frozen=True)
class MethodSpec:
    """One row of the benchmark: a method by name, its settings, and the dtype its basis is stored in."""

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    storage: str = "float32"


@dataclass(frozen=True)
class RunSpec:
    """A benchmark run. `timeout` bounds the seconds one fit may take; a fit over it becomes a row that says so.

    The clock is looked at between calls into compiled code, which are let finish. `skips` is the number of lightings on which
    the report shows what the planner left out, against the full simulation; 0 leaves that out.
    """

    name: str
    scenes: tuple[str, ...]
    methods: tuple[MethodSpec, ...]
    seed: int = 0
    timeout: float = 600.0
    skips: int = 0
    bake: BakeSpec = field(default_factory=BakeSpec)
    time: TimeSpec = field(default_factory=TimeSpec)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise SpecError(f"seed is {self.seed}, but must not be negative")
        if self.skips < 0:
            raise SpecError(f"skips is {self.skips} lightings, but must not be negative")
        if not self.timeout > 0:
            raise SpecError(f"timeout is {self.timeout:g} s, but must be above zero")

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a TOML file. Raises `SpecError` for anything in it that cannot be used."""
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, IsADirectoryError) as error:
            raise SpecError(f"there is no run specification at {path}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise SpecError(f"{path} is not valid TOML: {error}") from error
        rows = table.pop("methods", None)
        if not isinstance(rows, list) or not rows:
            raise SpecError(f"{path} names no methods; add at least one [[methods]] table with a name")
        methods = tuple(spec for row in rows for spec in _expand(row, path))
        nested = {name: build(kind, table.pop(name, {}), f"{path} [{name}]") for name, kind in _TABLES.items()}
        spec = build(cls, {**table, "methods": methods, **nested}, str(path), extra=("methods", *_TABLES))
        if not spec.scenes:
            raise SpecError(f'{path} names no scenes; add scenes = ["cornell"]')
        if not spec.bake.scenarios:
            raise SpecError(f'{path} [bake] names no scenarios; add scenarios = ["point"], or leave the key out')
        return spec


_TABLES = {"bake": BakeSpec, "time": TimeSpec}


def build(kind: type[T], table: Mapping[str, Any], where: str, extra: tuple[str, ...] = ()) -> T:
    """Make a dataclass from a table, checking keys and types; `extra` keys are taken as they are."""
    if not isinstance(table, Mapping):
        raise SpecError(f"{where} must be a table")
    known = [f.name for f in fields(kind)]  # pyright: ignore[reportArgumentType]
    hints = get_type_hints(kind)
    values = {}
    for key, value in table.items():
        if key not in known:
            raise SpecError(f"{where} has the unknown key '{key}'{nearest(key, known)}")
        values[key] = value if key in extra else convert(value, hints[key], f"{where}, key '{key}'")
    try:
        return kind(**values)
    except TypeError as error:
        missing = [name for name in known if f"'{name}'" in str(error)]
        raise SpecError(f"{where} lacks the key '{missing[0] if missing else '?'}'") from error
    except SpecError as error:
        raise SpecError(f"{where}: {error}") from error


_WORDS = {int: "an integer", float: "a number", bool: "true or false", str: "text in quotes", tuple: "a list"}


def convert(value: Any, hint: Any, where: str) -> Any:
    """A TOML or command-line value as the type a field declares."""
    options = get_args(hint) if get_origin(hint) is UnionType else (hint,)
    for option in options:
        if get_origin(option) is tuple:
            inner = get_args(option)
            if isinstance(value, (list, tuple)) and (inner[-1] is Ellipsis or len(inner) == len(value)):
                return tuple(convert(item, inner[0], where) for item in value)
        elif option is float and isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
        elif isinstance(option, type) and isinstance(value, option) and (option is bool or not isinstance(value, bool)):
            return value
    wanted = " or ".join(_WORDS[get_origin(option) or option] for option in options if option is not NoneType)
    raise SpecError(f"{where} is {value!r}, but must be {wanted}")


def nearest(word: str, known: list[str]) -> str:
    """A clause that names the nearest valid word, or all of them when none is near."""
    match = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean '{match[0]}'?" if match else f"; valid are {', '.join(known)}"


def _expand(row: Mapping[str, Any], path: Path) -> list[MethodSpec]:
    """One [[methods]] table; settings given as lists span a grid."""
    if not isinstance(row, Mapping) or not isinstance(row.get("name"), str):
        raise SpecError(f"{path} has a [[methods]] table without a name")
    settings = {key: value for key, value in row.items() if key != "name"}
    names = list(settings)
    choices = [value if isinstance(value, list) else [value] for value in settings.values()]
    specs = []
    for combination in itertools.product(*choices):
        chosen = dict(zip(names, combination, strict=True))
        storage = chosen.pop("storage", "float32")
        if storage not in DTYPES:
            raise SpecError(
                f"{path}: method '{row['name']}' asks for storage '{storage}'{nearest(storage, list(DTYPES))}"
            )
        specs.append(MethodSpec(row["name"], chosen, storage))
    return specs
