"""Measurement pass: direct irradiance at the dense points, averaged into the measured vector."""

import moderngl
import numpy as np
from jaxtyping import Float, Int

from prt_bench.points import SurfacePoints
from prt_bench.runtime import shaders
from prt_bench.runtime.lights import UploadedLights

_WORKGROUP = 64


class MeasurePass:
    """Fills the `measured` buffer [M, 4] that every asset's transfer pass reads."""

    def __init__(
        self,
        context: moderngl.Context,
        points: SurfacePoints,
        groups: Int[np.ndarray, "M s"],
        defines: shaders.Defines,
    ) -> None:
        self._context = context
        self.count, supersamples = groups.shape
        self._rows = max(_WORKGROUP // supersamples, 1)
        dense = np.zeros((groups.size, 2, 4), "<f4")
        dense[:, 0, :3] = points.position[groups.ravel()]
        dense[:, 1, :3] = points.normal[groups.ravel()]
        self._points = context.buffer(dense.tobytes())
        self.measured = context.buffer(reserve=16 * self.count)
        sizes = {"SUPERSAMPLES": supersamples, "POINTS_PER_WORKGROUP": self._rows, "MEASUREMENTS": self.count}
        self._program = shaders.compute(context, "measure.comp", {**defines, **sizes})

    def run(self, lights: UploadedLights) -> None:
        """Measure `lights`, whose shadow maps are drawn and bound."""
        lights.bind()
        self._points.bind_to_storage_buffer(2)
        self.measured.bind_to_storage_buffer(3)
        self._program.run(1, -(-self.count // self._rows))
        self._context.memory_barrier()

    def read(self) -> Float[np.ndarray, "M 3"]:
        """The measured vector, W/m²."""
        return np.frombuffer(self.measured.read(), "<f4").reshape(-1, 4)[:, :3].copy()

    def write(self, x: Float[np.ndarray, "M 3"]) -> None:
        """Replace the measured vector."""
        self.measured.write(np.column_stack([x, np.zeros(self.count)]).astype("<f4").tobytes())
