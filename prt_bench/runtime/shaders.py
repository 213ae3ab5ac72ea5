"""GLSL sources: finding the shader folder, resolving `#include`, and compiling effects in or out by `#define`."""

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import moderngl

from prt_bench.errors import RuntimeUnavailable
from prt_bench.runtime import layers
from prt_bench.runtime.generate import CODE

VERSION = "#version 430 core"
_INCLUDE = re.compile(r'^#include "([\w./]+)"$', re.MULTILINE)
_GENERATED = "generated/"
_PASTED = ("distance", "fibres")  # what callers write; nothing where they do not, and what would use it is compiled out

Defines = Mapping[str, int | str]
Pasted = Mapping[str, str]
"""Code that a caller has written itself, by the name under which "generated/NAME" pastes it."""


@lru_cache(maxsize=1)
def folder() -> Path:
    """The folder of GLSL files: inside the package when installed from a wheel, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "shaders", package.parent / "shaders"):
        if (candidate / "draw.frag").is_file():
            return candidate
    raise RuntimeUnavailable(f"the shaders are missing beside {package}; install prt-bench again")


def source(name: str, defines: Defines | None = None, pasted: Pasted | None = None) -> str:
    """One shader stage: version, defines, then the file with each include pasted once, where it is first named.

    An include of "generated/NAME" pastes code that `generate` writes for the order that ORDER defines, or `layers` for the
    shape that NETWORK defines, and nothing where neither is defined: what would use it is compiled out. The caller has what is
    `pasted`, for the names in `_PASTED`.
    """
    seen: set[str] = set()

    def paste(file: str) -> str:
        if file in seen:
            return ""
        seen.add(file)
        if file.startswith(_GENERATED):
            name = file.removeprefix(_GENERATED)
            if name in _PASTED:
                return (pasted or {}).get(name, "")
            if name in layers.CODE:
                shape = (defines or {}).get("NETWORK")
                return "" if shape is None else layers.CODE[name](str(shape))
            order = (defines or {}).get("ORDER")
            return "" if order is None else CODE[name](int(order))
        return _INCLUDE.sub(lambda match: paste(match[1]), (folder() / file).read_text(encoding="utf-8"))

    head = [VERSION, *(f"#define {key} {value}" for key, value in (defines or {}).items())]
    return "\n".join(head) + "\n" + paste(name)


def program(
    context: moderngl.Context, vertex: str, fragment: str | None, defines: Defines, pasted: Pasted | None = None
) -> moderngl.Program:
    """A vertex and fragment program (depth only without a fragment stage)."""
    return context.program(
        vertex_shader=source(vertex, defines),
        fragment_shader=source(fragment, defines, pasted) if fragment else None,
    )


def uniform(program: moderngl.Program | moderngl.ComputeShader, name: str) -> moderngl.Uniform:
    """A uniform of a program, to be written."""
    member = program[name]
    if not isinstance(member, moderngl.Uniform):
        raise TypeError(f"'{name}' is not a uniform")
    return member


def compute(
    context: moderngl.Context, name: str, defines: Defines, pasted: Pasted | None = None
) -> moderngl.ComputeShader:
    """A compute program."""
    return context.compute_shader(source(name, defines, pasted))
