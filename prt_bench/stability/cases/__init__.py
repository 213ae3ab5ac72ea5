"""Discovery of cases: every `Case` of every module of this package. Adding a case is adding a function to one of them."""

import pkgutil
from functools import cache
from importlib import import_module

from prt_bench.stability.cell import Case


@cache
def cases() -> tuple[Case, ...]:
    """All cases, ordered by catalogue key."""
    modules = [import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
    found = [value for module in modules for value in vars(module).values() if isinstance(value, Case)]
    return tuple(sorted(found, key=lambda case: (case.key, case.title)))
