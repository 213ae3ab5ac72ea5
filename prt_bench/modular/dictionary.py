"""The dictionary: reduced transfer of the six cubes of flat levels, and of what passes between them, as one file.

Built once, for all scenes. Blocks have a floor and a ceiling; their four sides are there or missing, in six ways up to
quarter turns. Matrices are computed in float64 and kept in float32.
"""

import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from safetensors.numpy import load_file, save_file

from prt_bench.errors import FitError, SpecError
from prt_bench.modular.cube import quarter_turn
from prt_bench.modular.lightfield import WAYS, Grid, contracted, emission, propagation, response, spanning
from prt_bench.modular.modes import factors, reduced
from prt_bench.progress import track
from prt_bench.store import data_folder

SIDES = 4
"""Sides of a block: +x, −z, −x, +z. A quarter turn takes each to the next."""
FACE_OF_SIDE = (0, 5, 1, 4)
KINDS: tuple[tuple[int, ...], ...] = ((), (0,), (0, 2), (0, 1), (0, 1, 2), (0, 1, 2, 3))
"""Missing sides of each entry."""
VERSION = 2
_LEAST_SIDE = 4


class Dictionary(eqx.Module):
    """Reduced operators of all entries K, for B functions within a block, k of lightfields, R of what arrives.

    `basis` [K, n, B], `read` [K, B, n] and `prior` [K, n, p] as in `modes.Modes`; `leave` [K, 4, k, B] from coefficients of a
    block to the lightfield that leaves a missing side, 0 at sides that are there; `onwards` [3, k, k], `arrive` [R, k] and
    `arriving` [n, R] as in `lightfield.Interface`, for light that enters through −x.
    """

    basis: Float[Array, "K n B"]
    read: Float[Array, "K B n"]
    prior: Float[Array, "K n p"]
    leave: Float[Array, "K 4 k B"]
    onwards: Float[Array, "3 k k"]
    arrive: Float[Array, "R k"]
    arriving: Float[Array, "n R"]

    @property
    def side(self) -> int:
        """Samples along an edge of a face."""
        return round((self.basis.shape[1] / 6) ** 0.5)

    @property
    def bytes(self) -> int:
        """Of all arrays."""
        return sum(array.nbytes for array in self._arrays().values())

    def save(self, path: Path) -> Path:
        """Write the dictionary as safetensors; a file that is there is replaced in one step."""
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".partial")
        arrays = {name: np.asarray(array) for name, array in self._arrays().items()}
        save_file(arrays, partial, {"dictionary": json.dumps({"version": VERSION})})
        return partial.replace(path)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote. Raises `FitError` where the file holds no dictionary."""
        try:
            return cls(**{name: jnp.asarray(array) for name, array in load_file(path).items()})
        except Exception as reason:
            raise FitError(f"{path} holds no dictionary of blocks ({reason}); build it anew") from reason

    def _arrays(self) -> dict[str, Array]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def build(
    side: int = 16,
    functions: int = 32,
    prior: int = 64,
    lights: int = 63,
    grid: Grid | None = None,
    lightfields: int = 128,
    arriving: int = 32,
) -> Dictionary:
    """Compute the dictionary; `side`² samples a face, `functions` within a block, `lightfields` between them.

    Raises `SpecError` for sizes that are too small. Not differentiable.
    """
    grid = grid or Grid()
    sizes = {"side": side, "functions": functions, "lights": lights, "lightfields": lightfields, "arriving": arriving}
    for name, value in {**sizes, "prior": prior}.items():
        least = {"side": _LEAST_SIDE, "prior": functions}.get(name, 1)
        if value < least:
            raise SpecError(f"{name} of a dictionary of blocks is {value}, but must be at least {least}")
    leaves, turn = emission(side, grid), quarter_turn(side)
    entries, fields, weighted, owners = [], [], [], []
    for kind, missing in enumerate(track(KINDS, "blocks")):
        modes = reduced(side, [FACE_OF_SIDE[each] for each in missing], functions, prior, lights)
        entries.append(modes)
        for each in missing:
            fields.append(leaves @ _turned(modes.implicit, turn, -each))
            weighted.append(fields[-1] * modes.decay[: fields[-1].shape[1]])  # as strong as the prior has them
            owners.append((kind, each))
    ways = [propagation(way, grid) for way in WAYS]
    span = spanning(np.concatenate(weighted, axis=1), ways, lightfields)
    leave = np.zeros((len(KINDS), SIDES, span.shape[1], functions))
    for (kind, each), field in zip(owners, fields, strict=True):
        leave[kind, each, :, : field.shape[1]] = span.T @ field
    onwards = np.stack([contracted(span.T @ (way @ span)) for way in track(ways, "interfaces")])
    u, s, vt = factors(response(side, grid) @ span)
    rows = min(arriving, len(s))
    return Dictionary(
        *(
            jnp.asarray(array, jnp.float32)
            for array in (
                np.stack([_filled(modes.basis, functions) for modes in entries]),
                np.stack([_filled(modes.read.T, functions).T for modes in entries]),
                np.stack([_filled(modes.prior, prior) for modes in entries]),
                leave, onwards, s[:rows, None] * vt[:rows], u[:, :rows],
            )
        )
    )  # fmt: skip


@cache
def standard(**sizes: int) -> Dictionary:
    """The dictionary of these sizes, as `build` takes them: from the user's cache folder, or computed and put there."""
    name = "-".join(f"{key}{value}" for key, value in sorted(sizes.items()))
    path = data_folder() / f"blocks-v{VERSION}-{name}.safetensors"
    if path.exists():
        return Dictionary.load(path)
    dictionary = build(**sizes)
    dictionary.save(path)
    return dictionary


def _filled(columns: Float[np.ndarray, "n b"], count: int) -> Float[np.ndarray, "n B"]:
    """The columns, and zeros where a small cube has fewer functions than were asked for."""
    return np.pad(columns, ((0, 0), (0, count - columns.shape[1])))


def _turned(light: np.ndarray, turn: np.ndarray, quarters: int) -> np.ndarray:
    """Light of a block [n, …] after quarter turns."""
    for _ in range(quarters % SIDES):
        light = light[turn]
    return light


def entry_of(missing: Iterable[int]) -> tuple[int, int]:
    """The entry that has these sides missing after so many quarter turns."""
    wanted = frozenset(missing)
    for kind, sides in enumerate(KINDS):
        for quarters in range(SIDES):
            if frozenset((each + quarters) % SIDES for each in sides) == wanted:
                return kind, quarters
    raise SpecError(f"sides of a block are 0 to {SIDES - 1}, not {sorted(wanted)}")
