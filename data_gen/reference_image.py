"""Pictures by the independent path tracer: radiance per pixel, with its noise, that glossy renderings are held against.

What is reflected towards the camera is said in `glossy_reference.py`.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from data_gen.glossy_reference import arriving, reference_radiance, reflecting, surface_met
from data_gen.reference import normalised
from data_gen.tracer import Tracer
from prt_bench.lights import EnvironmentLight, Lighting
from prt_bench.scene import Camera, Scene


@dataclass(frozen=True)
class RadianceImage:
    """A Monte Carlo picture in W/m²/sr: `halves` [2, H, W, 3] of disjoint samples, `standard_error` [H, W, 3] of `mean`.

    `hit` [H, W] tells pixels that show a surface; the others show environment lights alone and have no error.
    """

    halves: Float[np.ndarray, "2 H W 3"]
    standard_error: Float[np.ndarray, "H W 3"]
    hit: Bool[np.ndarray, "H W"]

    @property
    def mean(self) -> Float[np.ndarray, "H W 3"]:
        """Mean over all samples."""
        return self.halves.mean(axis=0)

    @property
    def noise(self) -> float:
        """Relative root mean square error of `mean` over the surfaces, from its halves: ‖a − b‖ / ‖a + b‖."""
        first, second = self.halves[:, self.hit]
        total = float(np.linalg.norm(first + second))
        return float(np.linalg.norm(first - second)) / total if total > 0 else 0.0


def reference_image(
    scene: Scene,
    lighting: Lighting,
    height: int,
    width: int,
    paths: int,
    bounces: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    diffuse_between: bool = False,
    camera: Camera | None = None,
    lobes_alone: bool = False,
) -> RadianceImage:
    """The scene as its camera (or another) sees it through the middles of the pixels, with `paths` for each.

    Pixels are not averaged over their area. Backs of one-sided surfaces are black; area lights are not seen themselves,
    environment lights are where nothing stands before them. Arguments are those of `reference_radiance`. With `lobes_alone` the
    picture holds what the lobes of visible surfaces send to the camera and nothing else: to be added to a picture of the rest.
    """
    camera = camera or scene.camera
    direction = camera_directions(camera, height, width).reshape(-1, 3)
    tracer = Tracer(scene, workers)
    hits = tracer.intersect(np.broadcast_to(np.asarray(camera.position, float), direction.shape), direction)
    seen = np.flatnonzero(hits.face >= 0)
    lit = seen[reflecting(scene, hits, seen)]
    points = surface_met(scene, hits, lit)
    if lobes_alone:
        specular, _ = scene.glossy_at(points.face, points.barycentric)
        shiny = specular.any(axis=1)
        lit, points = lit[shiny], replace(points[shiny], albedo=np.zeros((int(shiny.sum()), 3)))
    estimate = reference_radiance(
        scene, lighting, points, -direction[lit], paths, bounces, seed, workers, diffuse_between
    )
    halves, error = np.zeros((2, height * width, 3)), np.zeros((height * width, 3))
    halves[:, lit], error[lit] = estimate.halves, estimate.standard_error
    hit = hits.face >= 0
    origin = np.broadcast_to(np.asarray(camera.position, float), direction[~hit].shape)
    for light in () if lobes_alone else lighting.lights:
        if isinstance(light, EnvironmentLight):
            halves[:, ~hit] += arriving(light, origin, direction[~hit]).radiance
    shape = (height, width)
    return RadianceImage(halves.reshape(2, *shape, 3), error.reshape(*shape, 3), hit.reshape(shape))


def camera_directions(camera: Camera, height: int, width: int) -> Float[np.ndarray, "H W 3"]:
    """Unit directions through the middles of pixels, row 0 at the top."""
    forward = normalised(np.subtract(camera.target, camera.position).astype(float)[None])[0]
    right = normalised(np.cross(forward, camera.up)[None])[0]
    half = np.tan(np.radians(camera.fov_y) / 2.0)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    across, down = (2.0 * x - width) / height * half, (2.0 * y / height - 1.0) * half
    through = forward + across[..., None] * right - down[..., None] * np.cross(right, forward)
    return through / np.linalg.norm(through, axis=-1, keepdims=True)
