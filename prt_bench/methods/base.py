"""What a method is: settings, and a fit that turns a dataset into a model."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import jax

from prt_bench.dataset import LightingDataset
from prt_bench.models import Model


@dataclass(frozen=True)
class Method(ABC):
    """A transfer method. Subclasses are final frozen dataclasses whose fields are the settings, one file per method.

    `name` is what specs and tables call it, `summary` one line for lists, `citation` a BibTeX key or the equation it
    comes from, `role` "method", "floor" or "ceiling".
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    citation: ClassVar[str]
    role: ClassVar[str] = "method"

    @abstractmethod
    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> Model:
        """Fit to the lightings of `ds` (its training split) in float64. `key` seeds methods that draw random numbers."""

    @property
    def label(self) -> str:
        """The name with the settings that tell rows of one table apart."""
        return self.name
