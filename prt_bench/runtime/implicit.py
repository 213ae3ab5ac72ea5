"""Drawing implicit scenes: sphere tracing of the generated distance, and the transfer network in the fragment shader or in a
compute pass.

No mesh, no lightmap and no shadow map is on the GPU. Light is projected as for every asset that observes harmonics; how a
network came by its weights is no concern here.
"""

from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import AssetError
from prt_bench.implicit.expression import code_of
from prt_bench.implicit.scene import ImplicitScene
from prt_bench.implicit.tracing import CREEPING, MARGIN, STEPS
from prt_bench.learned.transfer import TransferField
from prt_bench.lights import Lighting
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check, headless, is_software, renderer
from prt_bench.runtime.draw import Screen, Sky, directions_from_screen, eye_of
from prt_bench.runtime.field import FieldBuffers
from prt_bench.runtime.glossy import MatrixPass
from prt_bench.runtime.harmonics import HarmonicsPass
from prt_bench.runtime.lights import UploadedLights, upload
from prt_bench.runtime.projection import camera_matrix, to_glsl
from prt_bench.runtime.transfer import CHANNELS
from prt_bench.scene import Camera, Material

_TILE_SIDE = 8
_WIDEST = {"fragment": 128, "compute": 512}
_NO_VIEWS = 64  # side of a shadow atlas that nothing is drawn into


class Surface(NamedTuple):
    """What every pixel meets: position and unit normal [H, W, 3], and the part, −1 where there is only sky; top row first."""

    position: Float[np.ndarray, "H W 3"]
    normal: Float[np.ndarray, "H W 3"]
    part: Int[np.ndarray, "H W"]


class ImplicitRuntime:
    """One implicit scene with one transfer network, at a frame size.

    `field` has a row for each channel, or one for all, and one more of direct light for lobes (`SurfaceSamples.vectors`).
    `by` "fragment" evaluates it where the ray ends; "compute" first keeps the hits of all pixels, then shares weights in
    workgroups. With `fixed` light, lobes are read off a matrix made once a frame instead of by a triple product in every
    pixel. Raises `AssetError` for a network that is too wide, or whose rows are not those of the scene.
    """

    def __init__(
        self,
        scene: ImplicitScene,
        field: TransferField,
        size: tuple[int, int] = (640, 480),
        by: str = "fragment",
        fixed: bool = False,
        context: moderngl.Context | None = None,
    ) -> None:
        if by not in _WIDEST:
            raise AssetError(f"a network is evaluated by {' or '.join(_WIDEST)}, not '{by}'")
        diffuse = field.rows - 1
        if diffuse not in (1, CHANNELS):
            raise AssetError(
                f"'{scene.name}' is drawn with 1 or {CHANNELS} rows of diffuse transfer and one for lobes, but the network"
                f" has {field.rows} rows; fit it to `SurfaceSamples.vectors`"
            )
        self.context = context or headless()
        self.scene, self.field, self.size, self.by = scene, field, size, by
        self.screen, self._sky = Screen(self.context, size), Sky(self.context)
        arrays = {name: array.astype(np.float32) for name, array in field.arrays().items()}
        self._field = FieldBuffers(self.context, arrays, f"the network of '{scene.name}'", _WIDEST[by])
        self.projection = HarmonicsPass(self.context, scene.bounds.mean(axis=0), field.order**2)
        self._matrix = MatrixPass(self.context, self.projection, field.order) if fixed and scene.glossy else None
        self._materials = [part.material for part in scene.parts]
        self._reflectances = self.context.buffer(reserve=32 * len(self._materials))
        code, tables = code_of(*(part.shape for part in scene.parts))
        pasted = {"distance": code}
        self._tables = self.context.buffer(tables.astype("<f4").tobytes())
        shading = {
            "RECONSTRUCT_FIELD": 1, "DIFFUSE_ROWS": diffuse, "COEFFICIENTS": self.projection.slots, "WORKGROUP": _TILE_SIDE**2,
            **self._field.defines, **({"GLOSSY": 1} if scene.glossy else {}), **({"FIXED": 1} if self._matrix else {}),
        }  # fmt: skip
        tracing = _tracing_defines(scene)
        hits = {"HITS_ONLY": 1, **tracing}
        self._hits = shaders.program(self.context, "screen.vert", "implicit.frag", hits, pasted)
        self._hit_images = [self.context.texture(size, 4, dtype="f4") for _ in range(2)]
        self._hit_frame = self.context.framebuffer(self._hit_images)
        if by == "fragment":
            self._fragment = shaders.program(
                self.context, "screen.vert", "implicit.frag", {**tracing, **shading}, pasted
            )
            self._triangle = self.context.vertex_array(self._fragment, [])
        else:
            sharing = {"SHARED_WEIGHTS": 1, "TILE_SIDE": _TILE_SIDE}
            self._compute = shaders.compute(self.context, "implicit.comp", {**shading, **sharing})
        self._hit_triangle = self.context.vertex_array(self._hits, [])
        self.look_from(scene.camera)
        for part, material in enumerate(self._materials):
            self.paint(part, material)
        check(self.context, f"loading '{scene.name}'")

    @property
    def device(self) -> str:
        """The renderer's name."""
        return renderer(self.context)

    @property
    def software(self) -> bool:
        """Whether the renderer runs on the CPU."""
        return is_software(self.device)

    @property
    def bytes(self) -> int:
        """GPU memory of the network, tables of distances, coefficients, matrices and materials."""
        buffers = [self._tables, self.projection.coefficients, self._reflectances]
        buffers += [self._matrix.matrix] if self._matrix else []
        return self._field.bytes + sum(buffer.size for buffer in buffers)

    def look_from(self, camera: Camera) -> None:
        """Draw the following frames from another camera."""
        self._camera = camera_matrix(camera, self.scene, self.size[0] / self.size[1])

    @property
    def eye(self) -> Float[np.ndarray, "3"]:
        """Where the camera is."""
        return eye_of(self._camera)

    def paint(self, part: int, material: Material) -> None:
        """Give a part another material in the following frames; what its neighbours reflect of it stays as it was baked."""
        lobe = material.glossy
        specular = (0.0, 0.0, 0.0, 0.0) if lobe is None else (*lobe.specular, lobe.exponent)
        self._reflectances.write(np.array([*material.albedo, 0.0, *specular], "<f4").tobytes(), offset=32 * part)

    def light(self, lighting: Lighting) -> UploadedLights:
        """Upload a lighting. The other calls take the result as well as the lighting itself."""
        return upload(self.context, lighting, self.scene.bounds, _NO_VIEWS)

    def frame(self, lighting: Lighting | UploadedLights) -> Float[np.ndarray, "H W 3"]:
        """Radiance of a frame [H, W, 3], top row first, W/m²/sr."""
        self.draw(self._uploaded(lighting))
        check(self.context, "drawing a frame")
        return self.screen.read_linear()

    def picture(self, lighting: Lighting | UploadedLights, exposure: float = 0.0) -> np.ndarray:
        """The same frame tone-mapped on the GPU: 8-bit sRGB [H, W, 3] of radiance · 2^exposure."""
        self.draw(self._uploaded(lighting), exposure)
        check(self.context, "drawing a picture")
        return self.screen.read_picture()

    def draw(self, lights: UploadedLights, exposure: float = 0.0) -> None:
        """All passes of one frame: projection of the light, its matrices where it is fixed, sky, hits and shading."""
        self.projection.run(lights)
        if self._matrix is not None:
            self._matrix.run()
        self.screen.linear.use()
        self.screen.linear.clear(depth=1.0)
        self.context.enable_only(moderngl.BLEND)
        self._sky.draw(self._camera, lights)
        self.context.enable_only(moderngl.NOTHING)
        self._bind()
        if self.by == "fragment":
            self._aim(self._fragment)
            self._triangle.render(moderngl.TRIANGLES, vertices=3)
        else:
            self._find_hits()
            for unit, image in zip((5, 6), self._hit_images, strict=True):
                image.use(unit)
            shaders.uniform(self._compute, "eye").value = tuple(self.eye)
            self.screen.radiance.bind_to_image(0, read=False, write=True)
            self._compute.run(*(-(-side // _TILE_SIDE) for side in self.size))
            self.context.memory_barrier()
        self.screen.tone_map(exposure)

    def surface(self) -> Surface:
        """What the pixels meet, as the shader found it: for comparison with the model at the same places."""
        self._find_hits()
        check(self.context, "tracing")
        position, normal = (
            np.frombuffer(image.read(), "<f4").reshape(self.size[1], self.size[0], 4)[::-1]
            for image in self._hit_images
        )
        return Surface(position[..., :3].copy(), normal[..., :3].copy(), position[..., 3].astype(int) - 1)

    def _find_hits(self) -> None:
        self._hit_frame.use()
        self._hit_frame.clear()
        self.context.enable_only(moderngl.NOTHING)
        self._tables.bind_to_storage_buffer(14)
        self._aim(self._hits)
        self._hit_triangle.render(moderngl.TRIANGLES, vertices=3)

    def _aim(self, program: moderngl.Program) -> None:
        shaders.uniform(program, "eye").value = tuple(self.eye)
        shaders.uniform(program, "from_screen").write(to_glsl(directions_from_screen(self._camera)))

    def _bind(self) -> None:
        self._field.bind()
        self._tables.bind_to_storage_buffer(14)
        self._reflectances.bind_to_storage_buffer(15)
        self.projection.coefficients.bind_to_uniform_block(0)
        if self._matrix is not None:
            self._matrix.matrix.bind_to_uniform_block(1)

    def _uploaded(self, lighting: Lighting | UploadedLights) -> UploadedLights:
        return self.light(lighting) if isinstance(lighting, Lighting) else lighting


def _tracing_defines(scene: ImplicitScene) -> dict[str, int | str]:
    margin = MARGIN * scene.tolerance
    low, high = (
        ", ".join(f"{value:.9e}" for value in corner) for corner in scene.bounds + margin * np.array([[-1], [1]])
    )
    return {
        "STEPS": STEPS, "TOLERANCE": f"{scene.tolerance:.9e}",
        "CREEPING": f"{CREEPING * scene.tolerance:.9e}", "STEP_SHARE": f"{1.0 / scene.shape.slope:.9e}",
        "BOX_LOW": f"vec3({low})", "BOX_HIGH": f"vec3({high})",
    }  # fmt: skip
