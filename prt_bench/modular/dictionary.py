"""The dictionary: reduced transfer of cubes with missing faces, and of what passes between them, as one file.

Built once, for all scenes. Faces of a cube are there or missing in ten ways up to rotation. One has no face, and nothing to
keep: light only passes through it. In flat levels, where blocks have a floor and a ceiling, six of the others occur. Matrices
are computed in float64 and kept in float32.
"""

import json
from abc import abstractmethod
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
from prt_bench.modular.cube import FACES
from prt_bench.modular.lightfield import (
    Grid,
    contracted,
    emission,
    propagation,
    response,
    rolled,
    rolling,
    spanning,
    ways_of,
)
from prt_bench.modular.modes import Modes, factors, reduced
from prt_bench.modular.rotations import FACE, INVERSE, ROTATIONS, turns
from prt_bench.modular.secondary import Secondary
from prt_bench.progress import track
from prt_bench.store import data_folder

KINDS: tuple[tuple[int, ...], ...] = (
    (), (0,), (0, 1), (0, 5), (0, 5, 1), (0, 5, 1, 4), (0, 5, 2), (0, 5, 1, 2), (0, 5, 1, 4, 2),
)  # fmt: skip
"""Missing faces of each entry; flat levels have the first six."""
DOORS = [(kind, face) for kind, missing in enumerate(KINDS) for face in missing]
"""(entry, face) of all missing faces."""
_FLAT = 6
VERSION = 3
_LEAST_SIDE = 4
_SECONDARY = "secondary."  # before names of its arrays in the file


class Operators(eqx.Module):
    """What a run-time needs of a dictionary: for all entries K, functions B and R of what arrives; kept as one file.

    `basis` [K, n, B] and `read` [K, B, n] as in `modes.Modes`, `arriving` [n, R] from what arrives to light on the samples.
    `secondary` is for normal maps and for bodies in the air, where these were asked for.
    """

    basis: eqx.AbstractVar[Float[Array, "K n B"]]
    read: eqx.AbstractVar[Float[Array, "K B n"]]
    arriving: eqx.AbstractVar[Float[Array, "n R"]]
    secondary: eqx.AbstractVar[Secondary | None]

    @property
    @abstractmethod
    def side(self) -> int:
        """Samples along an edge of a face, or of another such part of a surface."""

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
        """Read what `save` wrote. Raises `FitError` where the file holds no such dictionary."""
        try:
            arrays = {name: jnp.asarray(array) for name, array in load_file(path).items()}
            beside = {name: arrays.pop(_SECONDARY + name) for name in _names(Secondary) if _SECONDARY + name in arrays}
            return cls(**arrays, secondary=Secondary(**beside) if beside else None)
        except Exception as reason:
            raise FitError(f"{path} holds no dictionary of blocks ({reason}); build it anew") from reason

    def _arrays(self) -> dict[str, Array]:
        own = {name: getattr(self, name) for name in _names(type(self)) if name != "secondary"}
        beside = self.secondary
        return own | ({_SECONDARY + name: getattr(beside, name) for name in _names(Secondary)} if beside else {})


class Dictionary(Operators):
    """Reduced operators of all entries K, for B functions within a block, k of lightfields, R of what arrives.

    `basis` [K, n, B], `read` [K, B, n] and `prior` [K, n, p] as in `modes.Modes`; `leave` [D, k, B] from coefficients of a
    block to the lightfield that leaves through each of `DOORS`, in the frame of that face. For light that enters through −x,
    `onwards` [w, k, k] to that which leaves straight on, to the left and, in a flat dictionary, to the right; `arrive` [R, k]
    and `arriving` [n, R] to irradiance on the samples, `arriving` orthonormal. In three dimensions `roll` [1, k, k] turns a
    lightfield by a quarter about its direction, and is orthogonal; in a flat dictionary it is [0, k, k].
    """

    basis: Float[Array, "K n B"]
    read: Float[Array, "K B n"]
    prior: Float[Array, "K n p"]
    leave: Float[Array, "D k B"]
    onwards: Float[Array, "w k k"]
    roll: Float[Array, "r k k"]
    arrive: Float[Array, "R k"]
    arriving: Float[Array, "n R"]
    secondary: Secondary | None = None

    @property
    def side(self) -> int:
        """Samples along an edge of a face."""
        return round((self.basis.shape[1] / 6) ** 0.5)

    @property
    def dimension(self) -> int:
        """3 where light may go up and down, else 2."""
        return 2 + len(self.roll)


def build(
    side: int = 16,
    functions: int = 32,
    prior: int = 64,
    lights: int = 63,
    grid: Grid | None = None,
    lightfields: int = 128,
    arriving: int = 32,
    dimension: int = 2,
    secondary: bool = False,
) -> Dictionary:
    """Compute the dictionary; `side`² samples a face, `functions` within a block, `lightfields` between them.

    `dimension` is 2 for flat levels, 3 for light that goes up and down too; `secondary` adds what normal maps and bodies in the
    air need. Raises `SpecError` for other dimensions, and for
    sizes that are too small. Not differentiable.
    """
    if dimension not in (2, 3):
        raise SpecError(f"dimension of a dictionary of blocks is {dimension}, but must be 2 or 3")
    grid = grid or Grid()
    sizes = {"side": side, "functions": functions, "lights": lights, "lightfields": lightfields, "arriving": arriving}
    for name, value in {**sizes, "prior": prior}.items():
        least = {"side": _LEAST_SIDE, "prior": functions}.get(name, 1)
        if value < least:
            raise SpecError(f"{name} of a dictionary of blocks is {value}, but must be at least {least}")
    kinds = KINDS if dimension == 3 else KINDS[:_FLAT]
    entries = [reduced(side, missing, functions, prior, lights) for missing in track(kinds, "blocks")]
    roll = rolling(grid) if dimension == 3 else None
    ways = [propagation(way, grid) for way in ways_of(dimension)]
    fields, weighted = _leaving(entries, side, grid)
    span = spanning(np.concatenate(weighted, axis=1), ways, lightfields, roll)
    leave = [filled(span.T @ field, functions) for field in fields]
    onwards = [contracted(span.T @ (way @ span)) for way in track(ways, "interfaces")]
    rolls = np.zeros((0, *onwards[0].shape)) if roll is None else rolled(span, roll)[None]
    u, s, vt = factors(response(side, grid) @ span)
    rows = min(arriving, len(s))
    implicit = [filled(modes.implicit, functions) for modes in entries]
    beside = Secondary.of(implicit, span @ (vt[:rows].T / s[:rows]), side, grid) if secondary else None
    kept = {
        "basis": np.stack([filled(modes.basis, functions) for modes in entries]),
        "read": np.stack([filled(modes.read.T, functions).T for modes in entries]),
        "prior": np.stack([filled(modes.prior, prior) for modes in entries]),
        "leave": np.stack(leave), "onwards": np.stack(onwards), "roll": rolls,
        "arrive": s[:rows, None] * vt[:rows], "arriving": u[:, :rows],
    }  # fmt: skip
    return Dictionary(**{name: jnp.asarray(array, jnp.float32) for name, array in kept.items()}, secondary=beside)


def _leaving(entries: list[Modes], side: int, grid: Grid) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What leaves through each of `DOORS` by the functions of its entry, and that as strong as the prior has them."""
    leaves, turned, fields, weighted = emission(side, grid), turns(side), [], []
    for kind, face in DOORS:
        if kind < len(entries):
            implicit, decay = entries[kind].implicit, entries[kind].decay
            fields.append(leaves @ implicit[turned[INVERSE[face]]])  # the face comes to lie at +x
            weighted.append(fields[-1] * decay[: implicit.shape[1]])
    return fields, weighted


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


def _names(kind: type[eqx.Module]) -> list[str]:
    """Names of a module's fields."""
    return list(kind.__dataclass_fields__)


def filled(columns: Float[np.ndarray, "n b"], count: int) -> Float[np.ndarray, "n B"]:
    """The columns, and zeros where a small cube has fewer functions than were asked for."""
    return np.pad(columns, ((0, 0), (0, count - columns.shape[1])))


def entry_of(missing: Iterable[int]) -> tuple[int, int]:
    """The entry that has these faces missing, and the rotation after which it has them.

    Of a block without any face the entry says nothing, and is the first. Raises `SpecError` for what is no face.
    """
    wanted = frozenset(missing)
    if wanted == frozenset(range(FACES)):
        return 0, 0
    for kind, faces in enumerate(KINDS):
        for pose in range(len(ROTATIONS)):
            if frozenset(FACE[pose, list(faces)].tolist()) == wanted:
                return kind, pose
    raise SpecError(f"faces of a block are 0 to {FACES - 1}, not {sorted(wanted)}")
