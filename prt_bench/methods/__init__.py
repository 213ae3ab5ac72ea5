"""Discovery of methods: every module of this package, and the entry-point group `prt_bench.methods` of other packages.

Adding a method is adding a file here; nothing lists them by hand.
"""

import inspect
import pkgutil
from dataclasses import fields
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from prt_bench import spec  # by module: a method file of this package is called `nearest` too
from prt_bench.errors import SpecError
from prt_bench.methods.base import Method


@cache
def _discover() -> dict[str, type[Method]]:
    modules = [import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
    found = [member for module in modules for _, member in inspect.getmembers(module, inspect.isclass)]
    found += [entry.load() for entry in entry_points(group="prt_bench.methods")]
    concrete = {member for member in found if issubclass(member, Method) and not inspect.isabstract(member)}
    named: dict[str, type[Method]] = {}
    for member in sorted(concrete, key=lambda member: (member.name, member.__module__)):
        if member.name in named:
            raise SpecError(
                f"two methods are called '{member.name}': {named[member.name].__module__}, {member.__module__}"
            )
        named[member.name] = member
    return named


def methods() -> dict[str, type[Method]]:
    """All methods by name, alphabetically."""
    return dict(_discover())


def method(name: str, **settings: Any) -> Method:
    """A method with its settings. Raises `SpecError` for an unknown name or setting, a wrong type or a value out of range."""
    known = _discover()
    if name not in known:
        raise SpecError(f"there is no method '{name}'{spec.nearest(name, list(known))}")
    chosen = known[name]
    types = get_type_hints(chosen)
    allowed = [setting.name for setting in fields(chosen)]
    for setting, value in settings.items():
        if setting not in allowed:
            raise SpecError(f"method '{name}' has no setting '{setting}'{spec.nearest(setting, allowed)}")
        if not _fits(value, types[setting]):
            raise SpecError(f"{name}: setting '{setting}' must be {_spell(types[setting])}, not {value!r}")
    return chosen(**settings)


def _fits(value: Any, wanted: Any) -> bool:
    if get_origin(wanted) is Literal:
        return value in get_args(wanted)
    if get_origin(wanted) in (Union, UnionType):
        return any(_fits(value, choice) for choice in get_args(wanted))
    if wanted in (int, float):
        return isinstance(value, (int, wanted)) and not isinstance(value, bool)
    return isinstance(value, wanted)


def _spell(wanted: Any) -> str:
    if get_origin(wanted) is Literal:
        return " or ".join(repr(choice) for choice in get_args(wanted))
    if get_origin(wanted) in (Union, UnionType):
        return " or ".join(_spell(choice) for choice in get_args(wanted))
    return {int: "an integer", float: "a number", bool: "true or false", str: "text"}.get(wanted, str(wanted))
