"""A cube room whose rays are traced in closed form: a small, complete lighting dataset that needs no ray tracer.

The contract checks and many tests run on it. It is convex, so nothing is ever in shadow. With five walls its front is
open, and distant light comes in.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from prt_bench.dataset import LightingDataset, Transport, Vertices
from prt_bench.emitters import irradiance
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.lights import Lighting, PointLight, emitters
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Camera, Material, Mesh, Scene
from prt_bench.transport import final_gather, radiosity

_SIDES = [(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]  # the front, +z, is the last
_MATERIAL = np.array([1, 2, 0, 0, 0, 0])  # red and green walls, the rest white
_INWARD = 1e-3  # how far vertices are drawn into their wall, as in a bake


def example_dataset(
    seed: int = 0,
    texels: int = 6,
    lightings: int = 24,
    measurements: int = 24,
    rays: int = 64,
    bounces: int = 6,
    walls: int = 6,
) -> LightingDataset:
    """A white cube room of side 2 m with a red and a green wall, under coloured point lights.

    `texels`² receivers on each of its walls, which are the gather samples too; the four corners of each wall are its
    vertices. The splits are "train" with `lightings` lightings, of which the second is black, and "test" with half as many.
    As many again as of both are streamed.
    """
    rng = np.random.default_rng(seed)
    scene = _room(walls)
    points = _wall_points(scene, texels, walls)
    sampler = HemisphereSampler.create(rays, seed)
    vertices = _corners(scene)
    hits, at_vertices = (_trace(part, texels, walls, sampler) for part in (points, vertices))
    transport = Transport(
        scene,
        _atlas(texels, walls),
        points,
        np.zeros(len(points), bool),
        points,
        hits,
        hits,
        bounces,
        f"example-{seed}-{texels}-{rays}-{walls}",
        sampler,
        Vertices(vertices, scene.mesh.faces, at_vertices),
    )

    count = lightings + lightings // 2
    positions, colours = rng.uniform(-0.7, 0.7, (count, 3)), rng.uniform(0.2, 3.0, (count, 3))
    colours[1] = 0.0
    lights = tuple(Lighting((PointLight(p, c),)) for p, c in zip(positions, colours, strict=True))
    measured_at = points[rng.permutation(len(points))[:measurements]]
    direct, measured = _lit(lights, points), _lit(lights, measured_at)
    halves = [_bounced(transport, direct, half) for half in (0, 1)]
    full = _bounced(transport, direct, None)
    size = np.maximum(np.linalg.norm(full, axis=(1, 2)), np.finfo(np.float32).tiny)
    positions = np.random.default_rng([seed, 2]).uniform(-0.7, 0.7, (count, 3))
    further = tuple(Lighting((PointLight(p, np.ones(3)),)) for p in positions)
    arrays = {
        "streamed_direct": _lit(further, points)[..., 0],
        "streamed_measured": _lit(further, measured_at)[..., 0],
        "measured": measured,
        "direct": direct,
        "indirect": full,
        "indirect_half": halves[0][lightings:],
        "noise": np.linalg.norm(halves[0] - halves[1], axis=(1, 2)) / (2.0 * size),
    }
    metadata = {
        "scene": scene.name,
        "scenario": "point",
        "held_out": lightings,
        "hash": transport.key,
        "texels": 3 * texels,
        "rays": rays,
        "bounces": bounces,
        "lightings": lightings,
        "measurements": measurements,
        "channels": 3,
        "effects": [],
        "seconds": {},
    }
    splits = {"train": (0, lightings), "test": (lightings, count)}
    groups = np.arange(measurements)[:, None]
    return LightingDataset(transport, measured_at, measured_at, groups, lights, arrays, splits, metadata, (0, count))


def _lit(lights: tuple[Lighting, ...], points: SurfacePoints) -> Float[np.ndarray, "N P 3"]:
    light = jax.vmap(irradiance, (0, None, None))(emitters(lights), points.position, points.normal)
    return np.asarray(light, np.float32)


def _bounced(transport: Transport, direct: Float[np.ndarray, "N S 3"], half: int | None) -> Float[np.ndarray, "N T 3"]:
    gather, albedo = transport.sample_gather(half), jnp.asarray(transport.samples.albedo, jnp.float32)
    outgoing = radiosity(gather, albedo, jnp.asarray(direct), transport.bounces - 1)
    return np.asarray(final_gather(transport.receiver_gather(half=half), outgoing))


def _room(walls: int) -> Scene:
    faces = [(4 * side + a, 4 * side + b, 4 * side + c) for side in range(walls) for a, b, c in ((0, 1, 2), (3, 2, 1))]
    vertices = np.concatenate([_on_side(side, np.array([[0, 0], [1, 0], [0, 1], [1, 1]])) for side in range(walls)])
    materials = (
        Material("white", (0.7, 0.7, 0.7)),
        Material("red", (0.6, 0.1, 0.1)),
        Material("green", (0.1, 0.5, 0.1)),
    )
    mesh = Mesh(vertices, np.array(faces), np.repeat(_MATERIAL[:walls], 2))
    return Scene("cube", mesh, materials, Camera((0.0, 0.0, 0.95), (0.0, 0.0, -1.0), fov_y=80.0))


def _on_side(side: int, uv: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P 3"]:
    """Points of one wall; u and v run so that u × v is the inward normal."""
    axis, sign = _SIDES[side]
    u, v = (axis + 1) % 3, (axis + 2) % 3
    position = np.empty((len(uv), 3))
    position[:, axis] = sign
    position[:, u], position[:, v] = -sign * (2.0 * uv[:, 0] - 1.0), 2.0 * uv[:, 1] - 1.0
    return position


def _grid(texels: int) -> Float[np.ndarray, "P 2"]:
    centre = (np.arange(texels) + 0.5) / texels
    v, u = np.meshgrid(centre, centre, indexing="ij")
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _wall_points(scene: Scene, texels: int, walls: int) -> SurfacePoints:
    """Texel centres, wall by wall, row by row."""
    uv = _grid(texels)
    upper = uv.sum(axis=1) > 1.0
    u, v = uv[:, :1], uv[:, 1:]
    barycentric = np.where(upper[:, None], np.hstack([u + v - 1, 1 - u, 1 - v]), np.hstack([1 - u - v, u, v]))
    face = np.concatenate([2 * side + upper for side in range(walls)]).astype(int)
    barycentric = np.tile(barycentric, (walls, 1))
    position = np.concatenate([_on_side(side, uv) for side in range(walls)])
    return SurfacePoints(position, scene.mesh.normals[face], scene.albedo_at(face, barycentric), face, barycentric)


def _corners(scene: Scene) -> SurfacePoints:
    """The vertices of all walls, each drawn into the first of its faces."""
    corner = scene.mesh.faces
    _, first = np.unique(corner, return_index=True)
    face, place = first // 3, first % 3
    barycentric = np.full((len(first), 3), _INWARD)
    barycentric[np.arange(len(first)), place] = 1.0 - 2.0 * _INWARD
    position = np.einsum("pc,pcd->pd", barycentric, scene.mesh.triangles[face])
    return SurfacePoints(position, scene.mesh.normals[face], scene.albedo_at(face, barycentric), face, barycentric)


def _trace(points: SurfacePoints, texels: int, walls: int, sampler: HemisphereSampler) -> Int[np.ndarray, "P R"]:
    """The texel that each ray meets; what leaves through the open front has escaped."""
    direction = sampler.directions(0, points.normal).astype(float)
    origin = points.position[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (np.sign(direction) - origin) / direction
    distance[np.broadcast_to(np.abs(points.normal[:, None]) > 0.5, distance.shape) & (distance <= 1e-9)] = np.inf
    axis = np.argmin(distance, axis=-1)
    hit = origin + direction * np.min(distance, axis=-1, keepdims=True)
    sign = np.take_along_axis(np.sign(direction), axis[..., None], axis=-1)[..., 0]
    u = np.take_along_axis(hit, ((axis + 1) % 3)[..., None], axis=-1)[..., 0]
    v = np.take_along_axis(hit, ((axis + 2) % 3)[..., None], axis=-1)[..., 0]
    column, row = (np.clip(((c + 1) / 2 * texels).astype(int), 0, texels - 1) for c in (-sign * u, v))
    side = 2 * axis + (sign > 0)
    samples = walls * texels**2
    return np.where(side < walls, (side * texels + row) * texels + column, samples + 1)


def _atlas(texels: int, walls: int) -> Lightmap:
    """A square for each wall, in two rows of three."""
    resolution = 3 * texels
    corner = np.array([(side % 3, side // 3) for side in range(walls)])
    cell = np.stack(np.meshgrid(np.arange(texels), np.arange(texels), indexing="xy"), axis=-1).reshape(-1, 2)
    pixel = (corner[:, None] * texels + cell).reshape(-1, 2)
    quad = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0, 1], [1, 0]]).reshape(2, 3, 2)
    uv = ((corner[:, None, None] + quad) / 3.0).reshape(-1, 3, 2)
    return Lightmap(resolution, pixel[:, 1] * resolution + pixel[:, 0], uv, np.repeat(np.arange(walls), 2))
