"""What a level's light does beside irradiance on its faces, on the GPU: for normal images, and for bodies in the air.

As `prt_bench.modular.level_secondary` has it in JAX. A level whose materials have no normal image, or a frame without bodies,
compiles and runs nothing of this.
"""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import moderngl
import numpy as np
from jaxtyping import Array, Float, Int

from prt_bench.modular.level import Level, LevelTransfer
from prt_bench.modular.level_secondary import (
    probe_numbers,
    probe_volume,
    secondary_of,
    turned_harmonics,
    turned_places,
)
from prt_bench.modular.rotations import ROTATIONS
from prt_bench.modular.secondary import HARMONICS
from prt_bench.runtime import shaders
from prt_bench.runtime.bodies import ProbeBuffer
from prt_bench.runtime.lights import UploadedLights

if TYPE_CHECKING:
    from prt_bench.runtime.level import LevelRuntime

_WORKGROUP = 64


class SecondaryPass:
    """q numbers at p places of every block from b and r, of which `bind` binds the buffers, into `found`."""

    def __init__(
        self,
        context: moderngl.Context,
        own: Float[Array, "K p q B"],
        arriving: Float[Array, "p q R"],
        order: Int[np.ndarray, "24 p"],
        turned: Float[np.ndarray, "24 q q"],
        blocks: int,
        found: moderngl.Buffer,
        numbers: Int[np.ndarray, "N p"] | None = None,
    ) -> None:
        _, places, count, basis = own.shape
        self._context, self._groups = context, (-(-places // _WORKGROUP), blocks)
        by_coefficient = np.moveaxis(np.asarray(own), 3, 1), np.moveaxis(np.asarray(arriving), 2, 0)
        contents = {3: by_coefficient[0], 4: by_coefficient[1], 7: order, 10: turned, 11: numbers}
        self._buffers = {
            slot: context.buffer(np.ascontiguousarray(values, "<i4" if slot in (7, 11) else "<f4").tobytes())
            for slot, values in contents.items()
            if values is not None
        } | {8: found}
        sizes = {"SAMPLES": places, "NUMBERS": count, "BASIS": basis, "ARRIVING": arriving.shape[2]}
        probes = {} if numbers is None else {"PROBES": 1}
        self._program = shaders.compute(context, "level_secondary.comp", {**sizes, "WORKGROUP": _WORKGROUP, **probes})

    @property
    def bytes(self) -> int:
        """GPU memory of matrices, tables and of what is found."""
        return sum(buffer.size for buffer in self._buffers.values())

    def run(self) -> None:
        """Fill `found`; blocks, b and r are bound."""
        for slot, buffer in self._buffers.items():
            buffer.bind_to_storage_buffer(slot)
        self._program.run(*self._groups)
        self._context.memory_barrier()


class Slopes:
    """How light at the samples changes with the normal, [N n, 3] vectors; `buffer` holds them."""

    def __init__(self, context: moderngl.Context, transfer: LevelTransfer) -> None:
        secondary, solid = secondary_of(transfer), transfer.solid
        self.buffer = context.buffer(reserve=48 * solid.size)
        self._pass = SecondaryPass(
            context, secondary.tilt, secondary.tilt_arriving, np.asarray(transfer.turns), ROTATIONS, len(solid), self.buffer
        )  # fmt: skip

    @property
    def bytes(self) -> int:
        """GPU memory."""
        return self._pass.bytes

    def run(self) -> None:
        """Find them; blocks, b and r are bound."""
        self._pass.run()


class LevelProbes(ProbeBuffer):
    """The irradiance volume of a level, filled from the light of each frame: what lights bodies that move through it.

    Raises `SpecError` for a dictionary without the operators.
    """

    def __init__(self, runtime: "LevelRuntime", level: Level, transfer: LevelTransfer, edge: float) -> None:
        self._runtime, secondary = runtime, secondary_of(transfer)
        count, across = len(level.cells), secondary.places
        empty = np.zeros((count, across**3, HARMONICS, 3), np.float32)
        super().__init__(runtime.context, probe_volume(level, jnp.asarray(empty), edge))
        self._pass = SecondaryPass(
            runtime.context, secondary.probes, secondary.probes_arriving, turned_places(across), turned_harmonics(),
            count, self.buffer, probe_numbers(level, across),
        )  # fmt: skip

    @property
    def bytes(self) -> int:
        """GPU memory of the coefficients and of what makes them."""
        return self._pass.bytes

    def prepare(self, lights: UploadedLights, measured: bool = False) -> None:
        """Coefficients of the light that the last bounce left."""
        self._runtime.bind_coefficients()
        self._pass.run()
