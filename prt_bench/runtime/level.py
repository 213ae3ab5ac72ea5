"""Levels of blocks, and tunnels, drawn with their indirect light, by the matrices of a `LevelTransfer` on the GPU.

A frame is shadow maps, direct light at the blocks' samples, then for every bounce b, r and the light they stand for, which the
next bounce reflects; the last is shown as one padded image (`modular.tiles`). Emitters are those of every runtime, points and
spots as well as the points that larger lights are split into. Their shadow maps show the level's own mesh, so a light beyond a
wall or round a corner lights nothing directly; between blocks light passes as reduced lightfields, without shadows. Where
materials have normal images and the dictionary has vector irradiance, indirect light follows them, else it is that of the face.
"""

from collections.abc import Sequence

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.errors import AssetError, SpecError
from prt_bench.lights import Lighting
from prt_bench.modular.atlas import LevelAtlas
from prt_bench.modular.level import LevelTransfer
from prt_bench.modular.tiles import Tiles
from prt_bench.points import SurfacePoints
from prt_bench.runtime import shaders
from prt_bench.runtime.bodies import Body
from prt_bench.runtime.context import check, headless
from prt_bench.runtime.draw import DrawPass, Screen
from prt_bench.runtime.level_secondary import LevelProbes, Slopes
from prt_bench.runtime.lights import UploadedLights, upload
from prt_bench.runtime.measure import MeasurePass
from prt_bench.runtime.mesh import MeshBuffers
from prt_bench.runtime.projection import camera_matrix
from prt_bench.runtime.shadow import ShadowPass, lighting_defines
from prt_bench.scene import Camera, Mesh, Scene

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
        atlas: Tiles,
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
        if solid.shape != atlas.shape or len(points) != solid.size:
            raise AssetError(
                f"a level of {atlas.shape[0]} blocks with {atlas.shape[1]} samples and {len(points)} points does not fit"
                f" transfer of {solid.shape[0]} blocks with {solid.shape[1]} samples; make all of the same level"
            )
        self._blocks, self._samples = solid.shape
        self._light = self.context.buffer(reserve=16 * solid.size)
        self._albedo = self._vectors(points.albedo * solid.reshape(-1, 1))
        self._upload(transfer, atlas.faces)
        defines = lighting_defines(scene, shadow_resolution, shadows)
        self.measurement = MeasurePass(self.context, points, np.arange(len(points))[:, None], defines)
        mesh = MeshBuffers(self.context, scene, atlas.lightmap(scene.mesh, edge))
        self.shadows = ShadowPass(self.context, mesh, shadow_resolution, defines)
        self.screen = Screen(self.context, size)
        self._drawn = mesh, defines
        self._passes: dict[tuple[bool, bool], DrawPass] = {}
        tilted = mesh.has_normals and transfer.dictionary.secondary is not None
        self._slopes = Slopes(self.context, transfer) if tilted else None
        self._tilted = {"TILTED": 1} if tilted else {}
        layers = 4 if tilted else 1
        self.atlas = self.context.texture_array((atlas.resolution, atlas.resolution, layers), 4, dtype="f4")
        self.atlas.repeat_x = self.atlas.repeat_y = False
        self._sources = self.context.buffer(atlas.source.astype("<i4").tobytes())
        sizes = {"RESOLUTION": atlas.resolution, "WORKGROUP": _WORKGROUP, **self._tilted}
        self._pad = shaders.compute(self.context, "level_atlas.comp", sizes)
        self._texels = atlas.resolution**2
        self._atlas, self._transfer, self._edge = atlas, transfer, edge
        self.look_from(scene.camera)
        check(self.context, "loading a level")

    def _upload(self, transfer: LevelTransfer, face_count: int) -> None:
        """Matrices, which of them each block and interface has, and the passes that multiply with them."""
        dictionary, pairs = transfer.dictionary, np.asarray(transfer.pairs)
        samples, basis = dictionary.basis.shape[1:]
        arriving = dictionary.arriving.shape[1]
        self._interfaces = len(transfer.enters)
        faces = np.asarray(transfer.solid).reshape(self._blocks, face_count, -1)[:, :, 0] > 0
        bits = faces @ (1 << np.arange(face_count))
        rows = np.full((self._blocks, _BLOCK), -1)
        rows[:, :4] = np.stack(
            [*map(np.asarray, (transfer.kind, transfer.pose)), bits, np.asarray(transfer.back)], axis=1
        )
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
        sizes = {"SAMPLES": samples, "BASIS": basis, "ARRIVING": arriving, "FACES": face_count, "WORKGROUP": _WORKGROUP}
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
        beside = 0 if self._slopes is None else self._slopes.bytes
        return sum(buffer.size for buffer in buffers) + 16 * self._texels * self.atlas.layers + beside

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
        self.bind_coefficients()
        self._bind({3: self._basis, 4: self._response, 7: self._turns, 8: self._light})
        self._run("light", -(-self._samples // _WORKGROUP), self._blocks)

    def bind_coefficients(self) -> None:
        """Bind what blocks are, their b and the r of interfaces, for what turns these into light."""
        self._bind({5: self._coefficients, 6: self._block_rows, 9: self._entered})

    def tilt(self) -> None:
        """How the indirect light changes with the normal, where that matters."""
        if self._slopes is not None:
            self.bind_coefficients()
            self._slopes.run()

    def pad(self) -> None:
        """The image of the indirect light."""
        self._bind({6: self._sources, 8: self._light} | ({9: self._slopes.buffer} if self._slopes else {}))
        self.atlas.bind_to_image(0, read=False, write=True)
        self._pad.run(-(-self._texels // _WORKGROUP))
        self.context.memory_barrier()

    def bounce(self, bounces: int = 1) -> None:
        """Indirect light after so many bounces of what was measured last, and its image."""
        for _ in range(bounces):
            self.read()
            self.arrive()
            self.respond()
        self.tilt()
        self.pad()

    def probes(self) -> LevelProbes:
        """The irradiance volume of the level, for bodies. Raises `SpecError` for a tunnel, and where a dictionary has none."""
        if not isinstance(self._atlas, LevelAtlas):
            raise SpecError("a tunnel has no irradiance volume; light what moves in it directly")
        return LevelProbes(self, self._atlas.level, self._transfer, self._edge)

    def body(self, mesh: Mesh, albedo: tuple[float, float, float], light: LevelProbes) -> Body:
        """Upload a diffuse mesh that moves, lit by `light` and directly; give it to frames. See `Body`."""
        return Body(self.context, mesh, albedo, light, {**self._drawn[1], "DIRECT": 1})

    def shade(
        self,
        lights: UploadedLights,
        direct: bool = True,
        indirect: bool = True,
        exposure: float = 0.0,
        bodies: Sequence[Body] = (),
    ) -> None:
        """The draw pass and the tone map, with shadow maps, image and probes as they are."""
        lights.bind()
        self.shadows.bind()
        self.atlas.use(1)
        self._pass(direct, indirect).run(self.screen, self._camera, lights)
        for body in bodies:
            body.draw(self._camera, direct, indirect)
        self.screen.tone_map(exposure)

    def draw(
        self,
        lights: UploadedLights,
        bounces: int = 1,
        direct: bool = True,
        indirect: bool = True,
        exposure: float = 0.0,
        bodies: Sequence[Body] = (),
    ) -> None:
        """All passes of one frame. Raises `ValueError` for one with neither direct nor indirect light."""
        if not direct and not indirect:
            raise ValueError("a frame needs direct light, indirect light, or both")
        self.shadows.run(lights)
        if indirect:
            self.measure(lights)
            self.bounce(bounces)
            for probes in {id(body.light): body.light for body in bodies}.values():
                probes.prepare(lights)
        self.shade(lights, direct, indirect, exposure, bodies)

    def frame(
        self,
        lighting: Lighting,
        bounces: int = 1,
        direct: bool = True,
        indirect: bool = True,
        bodies: Sequence[Body] = (),
    ) -> Float[np.ndarray, "H W 3"]:
        """Radiance of a frame [H, W, 3], top row first, W/m²/sr; `bodies` are drawn in it, lit by their probes."""
        self.draw(self.light(lighting), bounces, direct, indirect, bodies=bodies)
        check(self.context, "drawing a frame of a level")
        return self.screen.read_linear()

    def picture(
        self,
        lighting: Lighting,
        bounces: int = 1,
        direct: bool = True,
        indirect: bool = True,
        exposure: float = 0.0,
        bodies: Sequence[Body] = (),
    ) -> np.ndarray:
        """A frame tone-mapped on the GPU: 8-bit sRGB [H, W, 3] of radiance · 2^exposure, top row first."""
        self.draw(self.light(lighting), bounces, direct, indirect, exposure, bodies)
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

    def slopes(self) -> Float[np.ndarray, "N n 3 3"]:
        """How the indirect light changes with the normal, as `modular.level_secondary.slope` has it.

        Raises `AssetError` where it is not computed: without normal images, or without a `Secondary`.
        """
        if self._slopes is None:
            raise AssetError(
                "this level has no vector irradiance; give it normal images, and build its dictionary with secondary"
            )
        found = np.frombuffer(self._slopes.buffer.read(), "<f4")
        return found.reshape(self._blocks, self._samples, 3, 4)[..., :3].copy()

    def image(self) -> Float[np.ndarray, "H W 3"]:
        """The padded image of the indirect light, row 0 at v = 0."""
        side = self.atlas.size[0]
        return np.frombuffer(self.atlas.read(), "<f4").reshape(side, side, 4)[:, :, :3].copy()

    def _pass(self, direct: bool, indirect: bool) -> DrawPass:
        """The draw pass for these parts of light; compiled on first use."""
        if (direct, indirect) not in self._passes:
            mesh, defines = self._drawn
            parts = {"DIRECT": 1} if direct else {}
            parts |= {"INDIRECT": 1, "RECONSTRUCT_LIGHTMAP": 1, **self._tilted} if indirect else {}
            self._passes[direct, indirect] = DrawPass(self.context, mesh, {**defines, **parts})
        return self._passes[direct, indirect]

    def _bind(self, buffers: dict[int, moderngl.Buffer]) -> None:
        for slot, buffer in buffers.items():
            buffer.bind_to_storage_buffer(slot)

    def _run(self, name: str, *groups: int) -> None:
        self._programs[name].run(*groups)
        self.context.memory_barrier()
