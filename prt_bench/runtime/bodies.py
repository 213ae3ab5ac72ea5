"""What moves through a scene: probes filled on the GPU, by an asset or once, and rigid bodies that they light.

Probes are traced by `data_gen/effects/probes.py`, and mean what `prt_bench.irradiance_volume` says. A frame without bodies
compiles, uploads and runs nothing of this. Bodies receive the shadows of the scene, and cast none.
"""

from types import SimpleNamespace
from typing import TYPE_CHECKING

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError, SceneError
from prt_bench.irradiance_volume import ORDER, ProbeVolume, normals
from prt_bench.points import Lightmap
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.lightmap import LightmapLayout
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.measured import MeasuredAsset
from prt_bench.runtime.projection import to_glsl
from prt_bench.scene import Mesh

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64


class ProbeBuffer:
    """Coefficients of a volume's probes on the GPU, of its first lighting where it has one, and what reads them."""

    def __init__(self, context: moderngl.Context, volume: ProbeVolume) -> None:
        self.probes = len(volume.buried)
        self._context, self._volume = context, volume
        content = np.zeros((self.probes, ORDER**2, 4), "<f4")
        content[:, 0, 3] = ~np.asarray(volume.buried)
        if len(volume.coefficients):
            content[:, :, :3] = np.asarray(volume.coefficients[0])
        self.buffer = context.buffer(content.tobytes())
        doors = volume.open_to
        self._doors = None if doors is None else context.buffer(np.asarray(doors).astype("<i4").tobytes())

    @property
    def defines(self) -> shaders.Defines:
        """What compiles the lookup in."""
        rooms = {} if self._doors is None else {"ROOM": self._volume.room}
        return {"PROBES": 1, "ORDER": ORDER, "CELLS": f"ivec3({', '.join(map(str, self._volume.shape))})", **rooms}

    @property
    def bytes(self) -> int:
        """GPU memory of the coefficients."""
        return self.buffer.size + (0 if self._doors is None else self._doors.size)

    def read(self) -> Float[np.ndarray, "P 9 3"]:
        """The coefficients as they are now, W/m²."""
        check(self._context, "filling probes")
        return np.frombuffer(self.buffer.read(), "<f4").reshape(self.probes, ORDER**2, 4)[:, :, :3].copy()

    def prepare(self, lights: UploadedLights, measured: bool = False) -> None:
        """Coefficients under `lights`, whose shadow maps are there; `measured` says that their light is measured already. Those
        that were given stay as they are."""

    def bind(self, program: moderngl.Program) -> None:
        """Bind what `probes.glsl` reads."""
        self.buffer.bind_to_storage_buffer(9)
        if self._doors is not None:
            self._doors.bind_to_storage_buffer(10)
        for name, corner in (("volume_low", self._volume.low), ("volume_high", self._volume.high)):
            shaders.uniform(program, name).value = tuple(map(float, corner))


class ProbeLight(ProbeBuffer):
    """Coefficients of probes in a buffer: those of `volume`, or of what `asset` predicts from the light of each frame.

    The asset is one fitted to `Probes.dataset`; of the volume only the grid counts then. Raises `AssetError` for an asset of
    other receivers or one that does not observe direct light, and for a volume of several lightings without an asset.
    """

    def __init__(self, runtime: "Runtime", volume: ProbeVolume, asset: RuntimeAsset | None = None) -> None:
        if asset is None and len(volume.coefficients) != 1:
            raise AssetError(
                f"a volume of {len(volume.coefficients)} lightings lights no body; pick one, or give an asset"
            )
        super().__init__(runtime.context, volume)
        self._runtime = runtime
        self._asset = None if asset is None else self._loaded(asset)

    def _loaded(self, asset: RuntimeAsset) -> MeasuredAsset:
        directions, matrix = normals()
        receivers = self.probes * len(directions)
        if not MeasuredAsset.runs(asset):
            raise AssetError(f"{asset.path} has the kernels {asset.kernels}, which light no probes")
        if len(asset.arrays["basis"]) != receivers:
            raise AssetError(
                f"{asset.path} predicts {len(asset.arrays['basis'])} receivers, but these {self.probes} probes have"
                f" {receivers}; fit it to their own dataset"
            )
        runtime, side = self._runtime, int(np.ceil(np.sqrt(receivers)))
        square = Lightmap(side, np.arange(receivers), np.zeros((0, 3, 2)), np.zeros(0, int))
        layout = LightmapLayout(runtime.context, square, np.zeros(receivers, bool))
        beside = SimpleNamespace(context=runtime.context, measurement=runtime.measurement, layout=layout)
        loaded = MeasuredAsset(beside, asset)  # pyright: ignore[reportArgumentType]
        sizes = {"WORKGROUP": _WORKGROUP, "PROBES": self.probes, "FACINGS": len(directions), "RESOLUTION": side}
        self._program = shaders.compute(runtime.context, "probes.comp", {**sizes, **loaded.defines})
        self._projection = runtime.context.buffer(np.ascontiguousarray(matrix, "<f4").tobytes())
        return loaded

    @property
    def bytes(self) -> int:
        """GPU memory of the coefficients, and of the asset that makes them."""
        return super().bytes + (0 if self._asset is None else self._asset.bytes + self._projection.size)

    def prepare(self, lights: UploadedLights, measured: bool = False) -> None:
        """Coefficients that the asset predicts for this light, if there is one."""
        if self._asset is None:
            return
        if not measured:
            self._asset.measure(lights)
        self._asset.transfer()
        self._fill(self._asset)

    def predict(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "P 9 3"]:
        """Coefficients from a given measured vector, for comparison with the model. Raises `AssetError` without an asset."""
        if self._asset is None:
            raise AssetError("these probes hold the light of one lighting, and no asset that predicts another")
        self._asset.coefficients_of(x)
        self._fill(self._asset)
        return self.read()

    def _fill(self, asset: MeasuredAsset) -> None:
        asset.bind()
        self._projection.bind_to_storage_buffer(6)
        self.buffer.bind_to_storage_buffer(9)
        self._program.run(-(-self.probes // _WORKGROUP))
        self._runtime.context.memory_barrier()


class Body:
    """A rigid diffuse mesh, `mesh` in metres about its own origin, of one `albedo`, at a pose that `move` changes.

    Its light is direct light with the scene's shadows, and that of probes. Raises `SceneError` for a mesh without faces.
    """

    def __init__(
        self,
        context: moderngl.Context,
        mesh: Mesh,
        albedo: tuple[float, float, float],
        light: ProbeBuffer,
        direct: shaders.Defines,
    ) -> None:
        if not len(mesh.faces):
            raise SceneError("a body that moves has no faces; give it a mesh")
        self.light, self._albedo = light, albedo
        attributes = {"in_position": mesh.triangles, "in_normal": np.repeat(mesh.normals[:, None], 3, axis=1)}
        buffers = {
            name: context.buffer(np.ascontiguousarray(values, "<f4").tobytes()) for name, values in attributes.items()
        }
        ways = {(True, True): {**direct, **light.defines}, (True, False): direct, (False, True): light.defines}
        self._ways = {}
        for way, defines in ways.items():
            program = shaders.program(context, "body.vert", "body.frag", defines)
            self._ways[way] = program, context.vertex_array(program, [(buffers[n], "3f4", n) for n in buffers])
        self._context = context
        self.move(np.eye(4))

    def move(self, pose: Float[np.ndarray, "4 4"]) -> None:
        """Place the body: `pose` takes its own coordinates to the scene's, by a rotation, a translation and one scale.

        Raises `SceneError` for a pose that is not such a matrix.
        """
        pose = np.asarray(pose, float)
        turn = pose[:3, :3] if pose.shape == (4, 4) and np.all(np.isfinite(pose)) else np.zeros((3, 3))
        square = turn.T @ turn
        if np.linalg.det(turn) <= 0 or not np.allclose(square, square[0, 0] * np.eye(3), atol=1e-5 * square[0, 0]):
            raise SceneError("the pose of a body must be a 4 × 4 matrix of a rotation, a translation and one scale")
        self._pose = pose

    def draw(self, camera: Float[np.ndarray, "4 4"], direct: bool, indirect: bool) -> None:
        """Draw it into the frame that is bound, behind and before what is there. Lights and shadow maps are bound."""
        program, mesh = self._ways[direct, indirect]
        if indirect:
            self.light.bind(program)
        shaders.uniform(program, "camera").write(to_glsl(camera))
        shaders.uniform(program, "pose").write(to_glsl(self._pose))
        shaders.uniform(program, "albedo").value = self._albedo
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._context.cull_face, self._context.depth_func = "back", "<"
        mesh.render(moderngl.TRIANGLES)
