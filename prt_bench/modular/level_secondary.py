"""Vector irradiance and irradiance volumes of a level, by the `Secondary` of its dictionary.

As `LevelTransfer` has light on faces: what each block's own b and what enters it give, each turned as it stands.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from prt_bench.errors import SpecError
from prt_bench.irradiance_volume import ORDER, ProbeVolume
from prt_bench.modular.level import STEPS, Level, LevelTransfer
from prt_bench.modular.rotations import ROTATIONS
from prt_bench.modular.secondary import Secondary
from prt_bench.spherical.rotation import block_diagonal, rotation_blocks


def slope(transfer: LevelTransfer, b: Float[Array, "N B C"], r: Float[Array, "I R C"]) -> Float[Array, "N n 3 C"]:
    """v at every block's samples, in the level's axes; 0 on missing faces. Raises `SpecError` without a `Secondary`."""
    secondary = secondary_of(transfer)
    turned = jnp.asarray(ROTATIONS, b.dtype)
    found = _placed(transfer, secondary.tilt, secondary.tilt_arriving, b, r, transfer.turns, turned)
    return found * transfer.solid[:, :, None, None]


def volume(transfer: LevelTransfer, b: Float[Array, "N B C"], r: Float[Array, "I R C"]) -> Float[Array, "N P 9 C"]:
    """Harmonics of irradiance at every block's places, in the level's axes. Raises `SpecError` without a `Secondary`."""
    secondary = secondary_of(transfer)
    order, turned = jnp.asarray(turned_places(secondary.places)), jnp.asarray(turned_harmonics(), b.dtype)
    return _placed(transfer, secondary.probes, secondary.probes_arriving, b, r, order, turned)


def secondary_of(transfer: LevelTransfer) -> Secondary:
    """The operators of the level's dictionary. Raises `SpecError` for one that was built without."""
    found = transfer.dictionary.secondary
    if found is None:
        raise SpecError(
            "this dictionary of blocks has no vector irradiance and no volumes; build it with secondary=True"
        )
    return found


def _placed(
    transfer: LevelTransfer, own: Float[Array, "K p q B"], arriving: Float[Array, "p q R"], b: Float[Array, "N B C"],
    r: Float[Array, "I R C"], order: Int[Array, "24 p"], turned: Float[Array, "24 q q"],
) -> Float[Array, "N p q C"]:  # fmt: skip
    """q numbers at p places of each block: places in the `order` of its rotation, and numbers `turned` by it."""

    def posed(values: Float[Array, "m p q C"], pose: Int[Array, " m"]) -> Float[Array, "m p q C"]:
        placed = jnp.take_along_axis(values, order[pose][:, :, None, None], axis=1)
        return jnp.einsum("mij,mpjc->mpic", turned[pose], placed, precision="highest")

    sent = posed(jnp.einsum("npqb,nbc->npqc", own[transfer.kind], b, precision="highest"), transfer.pose)
    entered = posed(jnp.einsum("pqr,irc->ipqc", arriving, r, precision="highest"), transfer.along)
    return sent + jax.ops.segment_sum(entered, transfer.enters, len(transfer.kind))


@cache
def turned_places(across: int) -> Int[np.ndarray, "24 P"]:
    """p with x[p[r]] what `across`³ places of a block show after rotation r, where x [P] is what they showed before."""
    centred = np.indices((across,) * 3).reshape(3, -1).T * 2 - across + 1
    source = (np.swapaxes(ROTATIONS, 1, 2) @ centred.T + across - 1) // 2
    return np.array([across**2, across, 1]) @ source


@cache
def turned_harmonics() -> Float[np.ndarray, "24 9 9"]:
    """What each rotation makes of harmonics."""
    return np.asarray(block_diagonal(rotation_blocks(ROTATIONS.astype(float), ORDER)))


def probe_volume(level: Level, coefficients: Float[Array, "N P 9 C"], edge: float) -> ProbeVolume:
    """The harmonics of a level's blocks as one volume for a lighting, blocks of `edge` metres with their cell as centre.

    Where no block is, probes count as buried; through walls none is seen.
    """
    cells = np.array(level.cells)
    low, across = cells.min(axis=0), round(coefficients.shape[1] ** (1 / 3))
    shape = tuple((across * (np.ptp(cells, axis=0) + 1)).tolist())
    number = probe_numbers(level, across)
    filled = jnp.zeros((int(np.prod(shape)), *coefficients.shape[2:]), coefficients.dtype).at[number].set(coefficients)
    buried = np.ones(len(filled), bool)
    buried[number] = False
    doors = np.zeros(len(filled), int)
    doors[number] = open_rooms(level)[:, None]
    corner = edge * (low - 0.5)
    return ProbeVolume(
        jnp.asarray(corner), jnp.asarray(corner + edge * np.array(shape) / across), jnp.asarray(buried), filled[None],
        shape, jnp.asarray(doors, jnp.int32), across,
    )  # fmt: skip


def probe_numbers(level: Level, across: int) -> Int[np.ndarray, "N P"]:
    """Where the places of every block are in the volume of the whole level."""
    cells = np.array(level.cells)
    cells = cells - cells.min(axis=0)
    place = across * cells[:, None] + np.indices((across,) * 3).reshape(3, -1).T
    _, high, deep = across * (cells.max(axis=0) + 1)
    return place @ np.array([high * deep, deep, 1])


def open_rooms(level: Level) -> Int[np.ndarray, " N"]:
    """For each block bits of the 27 around it, itself included, that lie behind no wall: some way there, a step along each
    axis at most, passes open faces alone."""
    doors = level.open
    found = np.zeros(len(doors), int)
    for block in range(len(doors)):
        front = {(1, 1, 1): block}
        for _ in range(3):
            reached = dict(front)
            for place, at in front.items():
                for face, other in doors[at].items():
                    step = np.add(place, STEPS[face])
                    if place[face // 2] == 1:
                        reached[tuple(step.tolist())] = other
            front = reached
        found[block] = sum(1 << (9 * x + 3 * y + z) for x, y, z in front)
    return found
