"""What a method is: settings, and a fit that turns a dataset into a model."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar, Self

import jax

from prt_bench.dataset import LightingDataset
from prt_bench.errors import SpecError
from prt_bench.models import Model


@dataclass(frozen=True)
class Method(ABC):
    """A transfer method. Subclasses are final frozen dataclasses whose fields are the settings, one file per method.

    `name` is what specs and tables call it, `summary` one line for lists, `citation` a BibTeX key or the equation it
    comes from, `role` "method", "floor" or "ceiling", `learns` whether the fit looks at the training lightings at all,
    `differentiable` whether it can be differentiated in them: where it cannot, it refuses light that is traced.
    Ranges of settings are checked in `__post_init__` with `require`.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    citation: ClassVar[str]
    role: ClassVar[str] = "method"
    learns: ClassVar[bool] = True
    differentiable: ClassVar[bool] = True

    @abstractmethod
    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> Model:
        """Fit to the lightings of `ds` (its training split) in float64. `key` seeds methods that draw random numbers.

        Differentiable in the arrays of `ds` (pass an object whose `measured` and `indirect` are traced), or else such an
        object raises `FitError`.
        """

    @property
    def label(self) -> str:
        """The name with the settings that tell rows of one table apart: the basis size, and whatever is not default.

        Settings without a say in the result, `field(compare=False)`, are left out; paths are told by their last part.
        """
        told = [self.name]
        for setting in (each for each in fields(self) if each.compare):
            value = getattr(self, setting.name)
            if setting.name == "basis":
                told.append(f"b{value}")
            elif isinstance(value, jax.Array):
                continue  # traced, see `with_traced`
            elif value != setting.default and isinstance(value, str):
                told.append(Path(value).name)
            elif value != setting.default:
                told.append(f"{setting.name}={value:g}" if isinstance(value, float) else f"{setting.name}={value}")
        return " ".join(told)

    def with_traced(self, **values: jax.Array) -> Self:
        """This method with settings that JAX may be tracing, for derivatives of a fit in them.

        They are neither checked nor told in the label. A fit is differentiable in such a setting where its docstring says so.
        """
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        if unknown := set(values) - set(given):
            raise SpecError(f"{self.name} has no setting '{min(unknown)}'; it has {', '.join(given) or 'none'}")
        made = object.__new__(type(self))
        for name, value in {**given, **values}.items():
            object.__setattr__(made, name, value)
        return made

    def require(self, condition: bool, setting: str, wanted: str) -> None:
        """Raise `SpecError` unless `condition` holds: method.setting must be `wanted`."""
        if not condition:
            raise SpecError(f"{self.name}: setting '{setting}' must be {wanted}, not {getattr(self, setting)!r}")
