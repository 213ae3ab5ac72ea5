"""Levels of blocks drawn with their indirect light, by the matrices of a `LevelTransfer` on the GPU.

A frame is shadow maps, direct light at the blocks' samples, then for every bounce b, r and the light they stand for, which the
next bounce reflects; the last is shown as one padded image (`modular.atlas`). Emitters are those of every runtime, points and
spots as well as the points that larger lights are split into. Their shadow maps show the level's own mesh, so a light beyond a
wall or round a corner lights nothing directly; between blocks light passes as reduced lightfields, without shadows.
"""

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.errors import AssetError
from prt_bench.lights import Lighting
from prt_bench.modular.atlas import LevelAtlas
from prt_bench.modular.cube import FACES
from prt_bench.modular.level import LevelTransfer
from prt_bench.modular.rotations import INVERSE
from prt_bench.points import SurfacePoints
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check, headless
from prt_bench.runtime.draw import DrawPass, Screen
from prt_bench.runtime.lights import UploadedLights, upload
from prt_bench.runtime.measure import MeasurePass
from prt_bench.runtime.mesh import MeshBuffers
from prt_bench.runtime.projection import camera_matrix
from prt_bench.runtime.shadow import ShadowPass, lighting_defines
from prt_bench.scene import Camera, Scene

_LANES = 256  # of a workgroup that sums
_WORKGROUP = 64
_BLOCK = 12  # integers of a block: what it is, and six doors with room for two more, as `level.glsl` has them


class LevelRuntime:
    """One level with its scene, whose mesh lies on the faces of blocks of `edge` metres; `points` are all blocks' samples.

    Points give places and albedo, block by block. Raises `AssetError` for another number of them, and for a level that
    `transfer` is not of; `SpecError` for a mesh that does not lie on the level's faces.
    """

    def __init__(
        self,
        atlas: LevelAtlas,
        transfer: LevelTransfer,
        scene: Scene,
        points: SurfacePoints,
        edge: float,
        size: tuple[int, int] = (640, 480),
        shadow_resolution: int = 2048,
        shadows: bool = True,
        context: moderngl.Context | None = None,
    ) -> None:
        self.context = context or headless()
        self.scene, self.size, self._shadow_resolution = scene, size, shadow_resolution
        solid = np.asarray(transfer.solid)
        wanted = len(atlas.level.cells), FACES * atlas.side**2
        if solid.shape != wanted or len(points) != solid.size:
            raise AssetError(
                f"a level of {wanted[0]} blocks with {wanted[1]} samples and {len(points)} points does not fit transfer of"
                f" {solid.shape[0]} blocks with {solid.shape[1]} samples; make all of the same level"
            )
        self._blocks, self._samples = solid.shape
        self._light = self.context.buffer(reserve=16 * solid.size)
        self._albedo = self._vectors(points.albedo * solid.reshape(-1, 1))
        self._upload(transfer)
        defines = lighting_defines(scene, shadow_resolution, shadows)
        self.measurement = MeasurePass(self.context, points, np.arange(len(points))[:, None], defines)
        mesh = MeshBuffers(self.context, scene, atlas.lightmap(scene.mesh, edge))
        self.shadows = ShadowPass(self.context, mesh, shadow_resolution, defines)
        self.screen = Screen(self.context, size)
        self._drawn = mesh, defines
        self._passes: dict[tuple[bool, bool], DrawPass] = {}
        self.atlas = self.context.texture_array((atlas.resolution, atlas.resolution, 1), 4, dtype="f4")
        self.atlas.repeat_x = self.atlas.repeat_y = False
        self._sources = self.context.buffer(atlas.source.astype("<i4").tobytes())
        sizes = {"RESOLUTION": atlas.resolution, "WORKGROUP": _WORKGROUP}
        self._pad = shaders.compute(self.context, "level_atlas.comp", sizes)
        self._texels = atlas.resolution**2
        self.look_from(scene.camera)
        check(self.context, "loading a level")

    def _upload(self, transfer: LevelTransfer) -> None:
        """Matrices, which of them each block and interface has, and the passes that multiply with them."""
        dictionary, pairs = transfer.dictionary, np.asarray(transfer.pairs)
        samples, basis = dictionary.basis.shape[1:]
        arriving = dictionary.arrive.shape[0]
        self._interfaces = len(transfer.enters)
        faces, pose = (
            np.asarray(transfer.solid).reshape(self._blocks, FACES, -1)[:, :, 0] > 0,
            np.asarray(transfer.pose),
        )
        bits = faces @ (1 << np.arange(FACES))
        rows = np.full((self._blocks, _BLOCK), -1)
        rows[:, :4] = np.stack([np.asarray(transfer.kind), pose, bits, INVERSE[pose]], axis=1)
        rows[np.asarray(transfer.enters), 4 + np.asarray(transfer.along)] = np.arange(self._interfaces)
        starts = np.searchsorted(np.asarray(transfer.pair_to), np.arange(self._interfaces + 1))
        self._block_rows, self._turns = self._whole(rows), self._whole(transfer.turns)
        self._pair_from, self._starts = self._whole(transfer.pair_from), self._whole(starts)
        self._read = self._matrix(np.swapaxes(dictionary.read, 1, 2))
        self._basis = self._matrix(np.swapaxes(dictionary.basis, 1, 2))
        self._response = self._matrix(np.asarray(dictionary.arriving).T)
        self._pairs = self._matrix(np.swapaxes(pairs, 1, 2))
        self._coefficients = self.context.buffer(reserve=16 * self._blocks * basis)
        self._entered = self.context.buffer(reserve=16 * max(self._interfaces, 1) * arriving)
        sizes = {"SAMPLES": samples, "BASIS": basis, "ARRIVING": arriving, "WORKGROUP": _WORKGROUP}
        slices = {name: max(_LANES // count, 1) for name, count in (("read", basis), ("arrive", arriving))}
        self._programs = {
            name: shaders.compute(
                self.context, f"level_{name}.comp", {**sizes, **({"SLICES": slices[name]} if name in slices else {})}
            )
            for name in ("read", "arrive", "light")
        }

    def _vectors(self, values: Float[np.ndarray, "P 3"]) -> moderngl.Buffer:
        return self._matrix(np.pad(values, ((0, 0), (0, 1))))

    def _matrix(self, values: np.ndarray) -> moderngl.Buffer:
        return self._filled(np.ascontiguousarray(values, "<f4"))

    def _whole(self, values: np.ndarray) -> moderngl.Buffer:
        return self._filled(np.ascontiguousarray(values, "<i4"))

    def _filled(self, values: np.ndarray) -> moderngl.Buffer:
        return self.context.buffer(values.tobytes() or bytes(16))  # a level of one block has no pairs

    @property
    def bytes(self) -> int:
        """GPU memory of matrices, tables, light and its image; not that of mesh and shadow maps."""
        buffers = (
            self._read, self._basis, self._response, self._pairs, self._pair_from, self._starts, self._block_rows, self._turns,
            self._albedo, self._light, self._coefficients, self._entered, self._sources,
        )  # fmt: skip
        return sum(buffer.size for buffer in buffers) + 16 * self._texels

    def look_from(self, camera: Camera) -> None:
        """Draw the following frames from another camera."""
        self._camera = camera_matrix(camera, self.scene, self.size[0] / self.size[1])

    def light(self, lighting: Lighting) -> UploadedLights:
        """Upload a lighting. The other calls take the result as well as the lighting itself."""
        return upload(self.context, lighting, self.scene.bounds, self._shadow_resolution)

    def measure(self, lights: UploadedLights) -> None:
        """Direct light at the samples, of lights whose shadow maps are drawn and bound; the indirect light is forgotten."""
        self.measurement.run(lights)
        self._light.clear()

    def read(self) -> None:
        """b of every block, from direct light and the indirect light there is."""
        self._bind({3: self.measurement.measured, 4: self._read, 8: self._light, 9: self._albedo})
        self._bind({5: self._coefficients, 6: self._block_rows, 7: self._turns})
        self._run("read", self._blocks)

    def arrive(self) -> None:
        """r of every interface."""
        if self._interfaces:
            self._bind({4: self._pairs, 5: self._coefficients, 6: self._pair_from, 7: self._starts, 8: self._entered})
            self._run("arrive", self._interfaces)

    def respond(self) -> None:
        """Indirect light at the samples."""
        self._bind({3: self._basis, 4: self._response, 5: self._coefficients, 6: self._block_rows})
        self._bind({7: self._turns, 8: self._light, 9: self._entered})
        self._run("light", -(-self._samples // _WORKGROUP), self._blocks)

    def pad(self) -> None:
        """The image of the indirect light."""
        self._bind({6: self._sources, 8: self._light})
        self.atlas.bind_to_image(0, read=False, write=True)
        self._pad.run(-(-self._texels // _WORKGROUP))
        self.context.memory_barrier()

    def bounce(self, bounces: int = 1) -> None:
        """Indirect light after so many bounces of what was measured last, and its image."""
        for _ in range(bounces):
            self.read()
            self.arrive()
            self.respond()
        self.pad()

    def shade(self, lights: UploadedLights, direct: bool = True, indirect: bool = True, exposure: float = 0.0) -> None:
        """The draw pass and the tone map, with shadow maps and image as they are."""
        lights.bind()
        self.shadows.bind()
        self.atlas.use(1)
        self._pass(direct, indirect).run(self.screen, self._camera, lights)
        self.screen.tone_map(exposure)

    def draw(
        self,
        lights: UploadedLights,
        bounces: int = 1,
        direct: bool = True,
        indirect: bool = True,
        exposure: float = 0.0,
    ) -> None:
        """All passes of one frame. Raises `ValueError` for one with neither direct nor indirect light."""
        if not direct and not indirect:
            raise ValueError("a frame needs direct light, indirect light, or both")
        self.shadows.run(lights)
        if indirect:
            self.measure(lights)
            self.bounce(bounces)
        self.shade(lights, direct, indirect, exposure)

    def frame(
        self, lighting: Lighting, bounces: int = 1, direct: bool = True, indirect: bool = True
    ) -> Float[np.ndarray, "H W 3"]:
        """Radiance of a frame [H, W, 3], top row first, W/m²/sr."""
        self.draw(self.light(lighting), bounces, direct, indirect)
        check(self.context, "drawing a frame of a level")
        return self.screen.read_linear()

    def picture(
        self, lighting: Lighting, bounces: int = 1, direct: bool = True, indirect: bool = True, exposure: float = 0.0
    ) -> np.ndarray:
        """A frame tone-mapped on the GPU: 8-bit sRGB [H, W, 3] of radiance · 2^exposure, top row first."""
        self.draw(self.light(lighting), bounces, direct, indirect, exposure)
        check(self.context, "drawing a picture of a level")
        return self.screen.read_picture()

    def solve(self, lighting: Lighting, bounces: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Direct and indirect irradiance at the samples [N, n, 3], W/m²."""
        lights = self.light(lighting)
        self.shadows.run(lights)
        self.measure(lights)
        self.bounce(bounces)
        check(self.context, "lighting a level")
        light = np.frombuffer(self._light.read(), "<f4").reshape(-1, 4)[:, :3]
        shape = self._blocks, self._samples, 3
        return self.measurement.read().reshape(shape), light.reshape(shape).copy()

    def image(self) -> Float[np.ndarray, "H W 3"]:
        """The padded image of the indirect light, row 0 at v = 0."""
        side = self.atlas.size[0]
        return np.frombuffer(self.atlas.read(), "<f4").reshape(side, side, 4)[:, :, :3].copy()

    def _pass(self, direct: bool, indirect: bool) -> DrawPass:
        """The draw pass for these parts of light; compiled on first use."""
        if (direct, indirect) not in self._passes:
            mesh, defines = self._drawn
            parts = {"DIRECT": 1} if direct else {}
            parts |= {"INDIRECT": 1, "RECONSTRUCT_LIGHTMAP": 1} if indirect else {}
            self._passes[direct, indirect] = DrawPass(self.context, mesh, {**defines, **parts})
        return self._passes[direct, indirect]

    def _bind(self, buffers: dict[int, moderngl.Buffer]) -> None:
        for slot, buffer in buffers.items():
            buffer.bind_to_storage_buffer(slot)

    def _run(self, name: str, *groups: int) -> None:
        self._programs[name].run(*groups)
        self.context.memory_barrier()
