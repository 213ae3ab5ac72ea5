"""Who may import whom, and what every file owes its reader. Each rule is also shown to catch a file that breaks it."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("prt_bench", "data_gen")
CODE = (*PACKAGES, "experiments", "tests", "notebooks")
TOP = ("prt_bench", "prt_bench.cli", "prt_bench.doctor", "prt_bench.frames", "prt_bench.run", "prt_bench.stability")
"""The layer that ties the others together; nothing below imports it, but for the package `prt_bench` itself."""
READ_BY_BAKE = (
    "scene",
    "lights",
    "emitters",
    "medium",
    "hair",
    "strands",
    "environment",
    "hemisphere",
    "visibility",
    "implicit",
    "modular",
    "spherical",
    "points",
    "irradiance_volume",
    "glossy_indirect",
    "depth",
    "transport",
    "walks",
    "dataset",
    "clip",
    "store",
    "progress",
    "errors",
)
READ_BY_REPORT = ("records", "errors")
MOST_LINES = 400
TAKEN_APART = ("clustered_pca", "modular")
"""Notebooks that show how a method works from within."""


@cache
def files(*folders: str) -> dict[str, str]:
    """Sources of all Python files by path relative to the root."""
    found = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in found}


def module_name(path: str) -> str:
    """`prt_bench/report/__init__.py` → `prt_bench.report`."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


MODULES = {module_name(path) for path in files(*PACKAGES)}


def imports(source: str, inside_functions: bool = True) -> Iterator[str]:
    """Every module that a source imports, by statement or by a name handed to `import_module` and the like."""
    stack: list[ast.AST] = [ast.parse(source)]
    while stack:
        node = stack.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in MODULES else str(node.module) for name in names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in MODULES - set(PACKAGES):
            yield node.value
        if inside_functions or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            stack.extend(child for child in ast.iter_child_nodes(node) if not _types_only(child))


def _types_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def within(name: str, *packages: str) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def forbidden_import(module: str, name: str) -> str | None:
    """Why `module` may not import `name`, or None."""
    ours = within(name, *PACKAGES)
    if within(name, "tests", "experiments", "notebooks"):
        return "packages do not import what stands on them"
    if module in TOP or within(module, *TOP[1:]) or not ours or within(name, module):
        return None
    if within(name, *TOP[1:]):
        return "only the top layer imports the top layer"
    if within(module, "data_gen"):
        readable = within(name, "data_gen", *(f"prt_bench.{part}" for part in READ_BY_BAKE))
        return None if readable else f"data_gen reads {', '.join(READ_BY_BAKE)} alone"
    if within(module, "prt_bench.report"):
        readable = within(name, "prt_bench.report", *(f"prt_bench.{part}" for part in READ_BY_REPORT))
        return None if readable else "the report reads records alone"
    if within(module, "prt_bench.runtime"):
        kept_off = within(
            name, "data_gen", "prt_bench.report", "prt_bench.methods", "prt_bench.models", "prt_bench.evaluate"
        )
        return "the runtime meets methods in assets alone" if kept_off else None
    if within(name, "data_gen", "prt_bench.runtime", "prt_bench.report"):
        return "the core fits without ray tracing, OpenGL and reports"
    return None


def has_docstring(source: str) -> bool:
    return bool((ast.get_docstring(ast.parse(source)) or "").strip())


LEFT_FOR_LATER = re.compile(r"\b(TODO|FIXME|XXX|HACK)\b")


def unfinished(source: str) -> list[str]:
    """Notes to oneself, and functions that do nothing yet; a fallback of `singledispatch` may refuse the unknown."""
    found = LEFT_FOR_LATER.findall(source)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = [statement for statement in node.body if not _is_docstring(statement)]
            text = "; ".join(ast.unparse(statement) for statement in body)
            fallback = any(ast.unparse(decorator) == "singledispatch" for decorator in node.decorator_list)
            if text in ("pass", "...") or (text.startswith("raise NotImplementedError") and not fallback):
                found.append(node.name)
    return found


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


VAGUE = re.compile(r"(^|_)(utils?|helpers?|common|misc)(_|$)")


@pytest.mark.parametrize("path", files(*PACKAGES))
def test_imports_follow_the_layers(path: str):
    module = module_name(path)
    found = {name: forbidden_import(module, name) for name in imports(files(*PACKAGES)[path])}
    assert not {name: reason for name, reason in found.items() if reason}


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("prt_bench.evaluate", "import data_gen.bake"),
        ("prt_bench.evaluate", "def f():\n    from prt_bench.report import leaderboard"),
        ("prt_bench.assets", "from prt_bench.runtime.context import headless"),
        ("prt_bench.assets", "from prt_bench import runtime"),
        ("prt_bench.methods.mean", "import_module('data_gen.tracer')"),
        ("prt_bench.methods.mean", "from prt_bench.runtime import context"),
        ("prt_bench.runtime.transfer", "from prt_bench.methods.base import Method"),
        ("prt_bench.report.html", "from prt_bench.dataset import LightingDataset"),
        ("data_gen.plan", "from prt_bench.methods import methods"),
        ("data_gen.plan", "from prt_bench.cli import main"),
        ("prt_bench.linalg", "from prt_bench.stability.cases import cases"),
        ("prt_bench.cli", "from tests.oracles import mitsuba_oracle"),
    ],
)
def test_the_layers_catch(module: str, line: str):
    assert any(forbidden_import(module, name) for name in imports(line))


def test_modules_do_not_import_each_other_in_a_circle():
    graph = {
        module_name(path): {name for name in imports(source, inside_functions=False) if name in MODULES - set(PACKAGES)}
        for path, source in files(*PACKAGES).items()
        if module_name(path) not in PACKAGES
    }
    while leaves := {module for module, needs in graph.items() if not needs & graph.keys() - {module}}:
        graph = {module: needs for module, needs in graph.items() if module not in leaves}
    assert not graph


@pytest.mark.parametrize("name", ["reference", "glossy_reference", "medium_reference", "reference_image"])
def test_the_reference_tracer_shares_no_operator_code(name: str):
    operator = (
        "prt_bench.transport",
        "data_gen.gather",
        "prt_bench.hemisphere",
        "data_gen.direct",
        "data_gen.light",
        "data_gen.bake",
        "data_gen.effects",
        "data_gen.medium_walk",
    )
    assert not [name for name in imports(files("data_gen")[f"data_gen/{name}.py"]) if within(name, *operator)]


def test_notebooks_use_the_public_surface_alone():
    """But for those that take one method apart, whose pieces are what they show."""
    public = {"prt_bench", "prt_bench.chain", "prt_bench.lights", "prt_bench.transport"}
    for path, source in files("notebooks").items():
        used = {name for name in imports(source) if within(name, *PACKAGES)}
        assert used <= public or Path(path).stem in TAKEN_APART, (path, used - public)


def test_what_is_imported_is_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    normal = {
        re.split(r"[<>=\[; ]", need)[0].lower()
        for need in [*project["dependencies"], *project["optional-dependencies"]["draco"]]
    }
    known = {name: {each.lower() for each in homes} for name, homes in packages_distributions().items()}
    roots = {name.split(".")[0] for source in files(*PACKAGES).values() for name in imports(source)}
    third_party = {name: known[name] for name in roots - set(PACKAGES) if name in known}
    assert {"jax", "numpy", "moderngl"} <= third_party.keys()
    assert not {name: homes for name, homes in third_party.items() if not homes & (normal | {"mitsuba"})}


@pytest.mark.parametrize("path", files(*CODE))
def test_files_say_what_they_are_and_stay_small(path: str):
    source = files(*CODE)[path]
    assert has_docstring(source) or path.startswith("notebooks/"), "a module begins with what lives there"
    assert source.count("\n") <= MOST_LINES
    assert not VAGUE.search(Path(path).stem), "a name says what is inside"


@pytest.mark.parametrize("path", [path for path in files(*CODE) if path != "tests/test_architecture.py"])
def test_nothing_is_left_unfinished(path: str):
    assert not unfinished(files(*CODE)[path])


@pytest.mark.parametrize("path", sorted((ROOT / "shaders").iterdir()), ids=lambda path: path.name)
def test_shaders_begin_with_what_they_do(path: Path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith("//")
    assert not LEFT_FOR_LATER.findall(text)
    assert text.count("\n") <= MOST_LINES


@pytest.mark.parametrize(
    ("rule", "source"),
    [
        (unfinished, "def f():\n    raise NotImplementedError"),
        (unfinished, "def f():\n    '''What it will do.'''\n    ..."),
        (unfinished, "x = 1  # TODO: more"),
        (VAGUE.search, "mesh_utils"),
        (VAGUE.search, "helpers"),
        (lambda source: not has_docstring(source), "x = 1"),
    ],
)
def test_the_rules_catch(rule: Callable[[str], object], source: str):
    assert rule(source)


def test_the_linter_is_silent():
    """Among its rules: no name is undefined."""
    done = subprocess.run(
        [sys.executable, "-m", "ruff", "check", str(ROOT)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
