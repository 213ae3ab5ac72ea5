"""Light at meshless samples in compute shaders: compressed visibility, projection onto sources, transfer, and indirect light.

The same as `prt_bench.sampled.SampledLight` in 16 bits. How it gets from the samples to pixels is in `splats.py`.
"""

import moderngl
import numpy as np
from jaxtyping import Float, Int

from prt_bench.depth import SLACK, ClusteredVisibility, DirectionGrid
from prt_bench.errors import AssetError
from prt_bench.hemisphere import tangent_frames
from prt_bench.packing import STEPS, packed
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.transfer import CHANNELS
from prt_bench.sampled import ClusteredTransfer, SampledLight, check_near

_WORKGROUP = 64
_LIGHT_BYTES = 48


class SamplePasses:
    """Four passes from lights to `lights`, direct and indirect irradiance at every sample; none looks up shadow maps.

    Samples are sorted by cluster; `samples` and `lights` are laid out as in `samples.glsl`. Raises `AssetError` for a transfer
    with other channels than light has.
    """

    def __init__(self, context: moderngl.Context, model: SampledLight) -> None:
        self._context = context
        self.order = np.argsort(model.transfer.cluster, kind="stable")
        self.count = len(self.order)
        self.samples = context.buffer(_samples(model)[self.order].tobytes())
        self.lights = context.buffer(reserve=_LIGHT_BYTES * self.count)
        self.lights.clear()
        self._shadows = _DepthBuffers(context, model.visibility, self.order)
        self._direct = shaders.compute(context, "samples.comp", {"SAMPLES": self.count, **self._shadows.defines})
        self._transfer = _TransferBuffers(context, model.transfer, self.order)
        check(context, "loading samples")

    @property
    def bytes(self) -> int:
        """GPU memory of samples, their light, visibility and transfer."""
        return self.samples.size + self.lights.size + self._shadows.bytes + self._transfer.bytes

    def run(self, lights: UploadedLights) -> None:
        """All light at all samples. Raises `LightError` for light from infinitely far away."""
        self.direct(lights)
        self.indirect()

    def direct(self, lights: UploadedLights) -> None:
        """Direct light, with shadows and without."""
        check_near(lights.distant)
        lights.bind()
        self._bind()
        self._shadows.bind()
        self._direct.run(-(-self.count // _WORKGROUP))
        self._context.memory_barrier()

    def indirect(self) -> None:
        """What the direct light that was found last causes."""
        self._bind()
        self._transfer.run()

    def read(self) -> Float[np.ndarray, "3 S 3"]:
        """Direct, unshadowed direct, and indirect irradiance in W/m², in the model's order of samples."""
        stored = np.frombuffer(self.lights.read(), "<f4").reshape(self.count, 3, 4)[:, :, :3]
        out = np.empty((3, self.count, 3), np.float32)
        out[:, self.order] = np.moveaxis(stored, 1, 0)
        return out

    def _bind(self) -> None:
        self.samples.bind_to_storage_buffer(2)
        self.lights.bind_to_storage_buffer(9)


class _DepthBuffers:
    """What `depth.glsl` reads: coefficients and functions in 16 bits, mean and scales, directions, and the grid over them."""

    def __init__(self, context: moderngl.Context, model: ClusteredVisibility, order: Int[np.ndarray, " S"]) -> None:
        clusters, count, size = model.basis.shape
        coefficients, functions = model.packed()
        basis = np.moveaxis(functions.multiples().reshape(count, clusters, size), 1, 0)
        scale = coefficients.step * functions.step.reshape(clusters, size) * float(STEPS) ** 2
        rows = np.hstack([model.mean, _even(scale)])
        grid = DirectionGrid.of(model.directions)
        directions = np.pad(model.directions, ((0, 0), (0, 1)))
        parts = (
            _even(coefficients.multiples()[order]),
            _even(basis),
            rows.astype("<f4"),
            directions.astype("<f4"),
            np.concatenate([grid.starts, grid.candidates]).astype("<i4"),
        )
        self._buffers = [context.buffer(np.ascontiguousarray(part).tobytes()) for part in parts]
        self.defines: dict[str, int | str] = {
            "DIRECTIONS": count, "DEPTH_PAIRS": -(-size // 2), "GRID_SIDE": grid.side,
            "SLACK": f"{SLACK:.9e}", "NEAR": f"{model.near:.9e}",
        }  # fmt: skip

    @property
    def bytes(self) -> int:
        return sum(buffer.size for buffer in self._buffers)

    def bind(self) -> None:
        for binding, buffer in enumerate(self._buffers, 4):
            buffer.bind_to_storage_buffer(binding)


class _TransferBuffers:
    """Bases in 16 bits, whose scales are multiplied into the blocks between them, and the three passes that read them."""

    def __init__(self, context: moderngl.Context, model: ClusteredTransfer, order: Int[np.ndarray, " S"]) -> None:
        channels, rows, columns = model.blocks.shape
        if channels not in (1, CHANNELS):
            raise AssetError(f"a transfer between samples has {channels} channels; the runtime draws 1 or {CHANNELS}")
        self._context = context
        sources, receivers = packed(model.sources), packed(model.receivers)
        from_, to = (
            np.tile(part.step, size // part.shape[1]) * STEPS for part, size in ((sources, columns), (receivers, rows))
        )
        weights = np.pad(model.blocks * to[:, None] * from_, ((0, 0), (0, 0), (0, 1)))
        starts = np.searchsorted(model.cluster[order], np.arange(columns // sources.shape[1] + 1))
        self._sources, self._receivers, self._weights, self._starts = (
            context.buffer(np.ascontiguousarray(part).tobytes())
            for part in (
                _even(sources.multiples()[order]),
                _even(receivers.multiples()[order]),
                weights.astype("<f4"),
                starts.astype("<i4"),
            )
        )
        self._measured, self._coefficients = (context.buffer(reserve=16 * size) for size in (columns, rows))
        wide, tall = sources.shape[1], receivers.shape[1]
        self._project, self._linear, self._reconstruct = (
            shaders.compute(context, file, sizes)
            for file, sizes in (
                ("sources.comp", {"SOURCES": wide, "SOURCE_PAIRS": -(-wide // 2), "WORKGROUP": _WORKGROUP}),
                ("linear.comp", {
                    "MEASUREMENTS": columns, "BASIS": rows, "WORKGROUP": _WORKGROUP, "WEIGHT_CHANNELS": channels,
                }),
                ("receivers.comp", {"SAMPLES": len(order), "RECEIVERS": tall, "RECEIVER_PAIRS": -(-tall // 2)}),
            )
        )  # fmt: skip
        self._groups = columns, rows, -(-len(order) // _WORKGROUP)

    @property
    def bytes(self) -> int:
        parts = self._sources, self._receivers, self._weights, self._starts, self._measured, self._coefficients
        return sum(part.size for part in parts)

    def run(self) -> None:
        """Project, transfer and reconstruct; samples and their light are bound."""
        steps = (
            (self._project, {4: self._sources, 5: self._starts, 6: self._measured}),
            (self._linear, {3: self._measured, 4: self._weights, 5: self._coefficients}),
            (self._reconstruct, {4: self._receivers, 5: self._coefficients}),
        )
        for (program, buffers), groups in zip(steps, self._groups, strict=True):
            for binding, buffer in buffers.items():
                buffer.bind_to_storage_buffer(binding)
            program.run(groups)
            self._context.memory_barrier()


def _samples(model: SampledLight) -> Float[np.ndarray, "S 5 4"]:
    points = model.points
    out = np.zeros((len(points), 5, 4), "<f4")
    out[:, 0, :3], out[:, 0, 3] = points.position, model.transfer.cluster
    out[:, 1, :3], out[:, 1, 3] = points.normal, model.reach
    out[:, 2, :3] = tangent_frames(points.normal, np.zeros(len(points)))[:, 0]
    out[:, 3:] = model.walls.reshape(-1, 2, 4)
    return out


def _even(values: np.ndarray) -> np.ndarray:
    """An even number of columns, so that every row is whole pairs."""
    return np.pad(values, [*((0, 0) for _ in values.shape[1:]), (0, values.shape[-1] % 2)])
