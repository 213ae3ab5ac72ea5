"""What training starts from: the best closed form, and light by which to learn what it leaves.

It depends on the dataset and the number of functions alone, so one start serves networks of any shape and any seed.
"""

from typing import NamedTuple

from prt_bench.dataset import LightingDataset
from prt_bench.learned.light import Light, held_light, refuse_derivatives, training_examples
from prt_bench.methods.reduced_rank import ReducedRank
from prt_bench.models import LinearModel


class Start(NamedTuple):
    """`linear` in closed form; `examples` and what is `held` out with coefficients on its basis, all in float64."""

    linear: LinearModel
    examples: Light
    held: Light


def start_from(ds: LightingDataset, basis: int, name: str) -> Start:
    """Fit `reduced-rank` of that many functions, which has the least error of all closed forms (`linear_family.py`).

    `name` is who asks, for the error that light which is traced raises.
    """
    refuse_derivatives(name, ds)
    linear = ReducedRank(basis).fit(ds)
    return Start(linear, training_examples(ds, linear.basis), held_light(ds, linear.basis))
