"""The runtime: loads any asset for one baked scene and runs shadow → measure → transfer → draw."""

from collections.abc import Sequence

import moderngl
import numpy as np
from jaxtyping import Float, Int

from prt_bench.assets import RuntimeAsset
from prt_bench.dataset import LightingDataset
from prt_bench.errors import AssetError
from prt_bench.irradiance_volume import ProbeVolume
from prt_bench.lights import Lighting
from prt_bench.runtime import shaders
from prt_bench.runtime.bodies import Body, ProbeLight
from prt_bench.runtime.context import check, headless, is_software, renderer
from prt_bench.runtime.draw import DrawPass, Screen
from prt_bench.runtime.field import FieldAsset, HarmonicFieldAsset
from prt_bench.runtime.glossy import GlossyAsset
from prt_bench.runtime.glossy_indirect import GlossyIndirect
from prt_bench.runtime.harmonics import HarmonicAsset, VertexAsset
from prt_bench.runtime.indirect import Indirect, LoadedAsset, PlainLightmap
from prt_bench.runtime.lightmap import LightmapLayout
from prt_bench.runtime.lights import UploadedLights, upload
from prt_bench.runtime.measure import MeasurePass
from prt_bench.runtime.measured import MeasuredAsset
from prt_bench.runtime.mesh import MeshBuffers
from prt_bench.runtime.projection import camera_matrix
from prt_bench.runtime.shadow import ShadowPass, lighting_defines
from prt_bench.runtime.splats import SplattedLight
from prt_bench.sampled import SampledLight
from prt_bench.scene import Camera, Mesh


class Runtime:
    """Everything of a baked scene that does not depend on an asset: mesh, camera, shadow atlas, measurement points.

    `size` is the frame's width and height, `shadow_resolution` the side of the shadow atlas in texels, which all views
    of a lighting share. Without `shadows`, lookups are compiled out. `camera` is the scene's unless given; as an attribute
    it is the matrix from the world to clip space.
    Raises `RuntimeUnavailable` where no OpenGL context can be made.
    """

    def __init__(
        self,
        ds: LightingDataset,
        size: tuple[int, int] = (640, 480),
        shadow_resolution: int = 2048,
        shadows: bool = True,
        camera: Camera | None = None,
        context: moderngl.Context | None = None,
    ) -> None:
        self.context = context or headless()
        self.scene, self.size, self._shadow_resolution = ds.scene, size, shadow_resolution
        self.look_from(camera or ds.scene.camera)
        self._lighting_defines = lighting_defines(ds.scene, shadow_resolution, shadows)
        vertices, walks = ds.transport.vertices, ds.transport.walks
        corner = vertices and vertices.corner
        bodies = ds.scene.translucent or ds.scene.strands is None  # without strands all walks are through bodies
        colour = walks.colour if walks and bodies else None
        self.mesh = MeshBuffers(self.context, ds.scene, ds.lightmap, corner, colour)
        self.mesh_vertices = 0 if vertices is None else len(vertices.points)
        self.layout = LightmapLayout(self.context, ds.lightmap, ds.transport.buried)
        self.screen = Screen(self.context, size)
        self.shadows = ShadowPass(self.context, self.mesh, shadow_resolution, self._lighting_defines)
        self.measurement = MeasurePass(self.context, ds.dense_points, ds.groups, self._lighting_defines)
        self._baseline = self.draw_pass({"DIRECT": 1})
        check(self.context, "loading the scene")

    @property
    def device(self) -> str:
        """The renderer's name."""
        return renderer(self.context)

    @property
    def software(self) -> bool:
        """Whether the renderer runs on the CPU."""
        return is_software(self.device)

    def look_from(self, camera: Camera) -> None:
        """Draw the following frames from another camera."""
        self.camera = camera_matrix(camera, self.scene, self.size[0] / self.size[1])

    def light(self, lighting: Lighting) -> UploadedLights:
        """Upload a lighting. The other calls take the result as well as the lighting itself."""
        return upload(self.context, lighting, self.scene.bounds, self._shadow_resolution)

    def load(self, asset: RuntimeAsset) -> LoadedAsset:
        """Upload an asset and compile its passes. Raises `AssetError` when it was fitted on another dataset."""
        for kind in (MeasuredAsset, FieldAsset, HarmonicFieldAsset, HarmonicAsset, VertexAsset, GlossyAsset):
            if kind.runs(asset):
                return kind(self, asset)
        raise AssetError(f"{asset.path} has the kernels {asset.kernels}, which this runtime lacks")

    def lightmap(self, irradiance: Float[np.ndarray, "T C"]) -> PlainLightmap:
        """Indirect irradiance given per receiver, for frames of a reference or of any prediction."""
        return PlainLightmap(self, irradiance)

    def glossy(self, diffuse: Indirect, asset: RuntimeAsset, rows: Int[np.ndarray, " G"]) -> GlossyIndirect:
        """`diffuse` light with lobes of the glossy receivers `rows` beside it, by an asset of directional light. See
        `GlossyIndirect`."""
        return GlossyIndirect(self, diffuse, asset, rows)

    def splats(self, model: SampledLight, shadow_maps: bool = False) -> SplattedLight:
        """Light of meshless samples, splatted onto the screen; direct light by their own shadows or by `shadow_maps`."""
        return SplattedLight(self, model, shadow_maps)

    def probes(self, volume: ProbeVolume, asset: RuntimeAsset | None = None) -> ProbeLight:
        """Upload an irradiance volume for bodies that move; see `ProbeLight` for what lights it and what it refuses."""
        return ProbeLight(self, volume, asset)

    def body(self, mesh: Mesh, albedo: tuple[float, float, float], light: ProbeLight) -> Body:
        """Upload a diffuse mesh that moves, lit by `light` and directly; give it to frames. See `Body`."""
        return Body(self.context, mesh, albedo, light, {**self._lighting_defines, "DIRECT": 1})

    def measure(self, lighting: Lighting | UploadedLights) -> Float[np.ndarray, "M 3"]:
        """The measured vector of a lighting, with shadow maps, W/m²."""
        lights = self._uploaded(lighting)
        self.shadows.run(lights)
        self.measurement.run(lights)
        check(self.context, "measuring")
        return self.measurement.read()

    def frame(
        self,
        lighting: Lighting | UploadedLights,
        indirect: Indirect | None = None,
        direct: bool = True,
        bodies: Sequence[Body] = (),
    ) -> Float[np.ndarray, "H W 3"]:
        """Radiance of a frame [H, W, 3], top row first, W/m²/sr: with direct light, `indirect` light, or both.

        `bodies` are drawn in it with the same parts of light, the indirect one from probes. Raises `ValueError` for neither.
        """
        self.draw(self._uploaded(lighting), indirect, direct, bodies=bodies)
        check(self.context, "drawing a frame")
        return self.screen.read_linear()

    def picture(
        self,
        lighting: Lighting | UploadedLights,
        indirect: Indirect | None = None,
        direct: bool = True,
        exposure: float = 0.0,
        bodies: Sequence[Body] = (),
    ) -> np.ndarray:
        """The same frame tone-mapped on the GPU: 8-bit sRGB [H, W, 3] of radiance · 2^exposure."""
        self.draw(self._uploaded(lighting), indirect, direct, exposure, bodies)
        check(self.context, "drawing a picture")
        return self.screen.read_picture()

    def draw(
        self,
        lights: UploadedLights,
        indirect: Indirect | None = None,
        direct: bool = True,
        exposure: float = 0.0,
        bodies: Sequence[Body] = (),
    ) -> None:
        """All passes of one frame, as a user would run them: what `frame` reads back and timing times.

        An asset that includes direct light is drawn without any other, and needs no shadow maps but for `bodies`.
        """
        if indirect is None or indirect.needs_shadows or bodies:
            self.shadows.run(lights)
        if indirect is not None:
            indirect.prepare(lights)
        measured = isinstance(indirect, MeasuredAsset)
        for light in {id(body.light): body.light for body in bodies if indirect is not None}.values():
            light.prepare(lights, measured)
            measured = True
        self.shade(lights, indirect, direct, exposure, bodies)

    def shade(
        self,
        lights: UploadedLights,
        indirect: Indirect | None = None,
        direct: bool = True,
        exposure: float = 0.0,
        bodies: Sequence[Body] = (),
    ) -> None:
        """The draw pass and the tone map alone, of what the passes before left."""
        if indirect is not None:
            indirect.bind()
            pass_ = indirect.draw_pass if direct and not indirect.includes_direct else indirect.draw_pass_alone
        elif direct:
            pass_ = self._baseline
        else:
            raise ValueError("a frame needs direct light, indirect light, or both")
        lights.bind()
        self.shadows.bind()
        pass_.run(self.screen, self.camera, lights)
        for body in bodies:
            body.draw(self.camera, direct, indirect is not None)
        self.screen.tone_map(exposure)

    def draw_pass(self, defines: shaders.Defines, shadow_maps: bool = True) -> DrawPass:
        """A draw pass of this scene; `defines` choose its effects. Without `shadow_maps` it looks up none."""
        lighting = {name: value for name, value in self._lighting_defines.items() if shadow_maps or name != "SHADOWS"}
        return DrawPass(self.context, self.mesh, {**lighting, **defines})

    def _uploaded(self, lighting: Lighting | UploadedLights) -> UploadedLights:
        return self.light(lighting) if isinstance(lighting, Lighting) else lighting
