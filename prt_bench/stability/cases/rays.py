"""Rays: hits at any scale and place, shadows of thin gaps, back faces, and seams of the lightmap. Embree has float32."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from data_gen.direct import direct_irradiance
from data_gen.gather import buried, trace_hits
from data_gen.resolve import HitResolver
from data_gen.tracer import Tracer
from prt_bench.emitters import Emitters
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Camera, Material, Mesh, Scene
from prt_bench.stability.cell import Measured, Member, case
from prt_bench.stability.rigs import room
from prt_bench.stability.routes import F32, Route

_RAYS = 64


class Placed(NamedTuple):
    """The cube room, scaled and moved, with its lightmap."""

    scene: Scene
    points: SurfacePoints
    lightmap: Lightmap


def _placed(scale: float, shift: float) -> Placed:
    ds = room()
    scene = ds.transport.scene
    mesh = scene.mesh
    moved = Mesh(scale * (np.asarray(mesh.vertices) + shift), mesh.faces, mesh.material)
    points = ds.points
    place = SurfacePoints(
        scale * (points.position + shift), points.normal, points.albedo, points.face, points.barycentric
    )
    return Placed(Scene("placed", moved, scene.materials, scene.camera), place, ds.lightmap)


def _places(route: Route) -> Iterator[Member]:
    for scale in (1e-3, 1.0, 1e4):
        for shift in (0.0, 30.0):
            yield Member(f"scale {scale:g}, moved by {shift:g} sizes", _placed(scale, shift))


def tracers() -> dict[str, Any]:
    """What traces: rays of a scene, on one worker."""
    return {"embree": lambda scene: Tracer(scene, 1)}


@case("G3", "hits at any scale and place", subjects=tracers, family=_places, routes=(F32,))
def any_scale(made: Any, placed: Placed, route: Route) -> Iterator[Measured]:
    """G3: a fixed offset hits the surface it starts from in large scenes, and jumps over others in small ones.

    From inside a closed box every ray meets a front, never its own wall, and the same texel as in the plain room but for
    those whose place lies within the offset of an edge.
    """
    tables = []
    for place in (_placed(1.0, 0.0), placed):
        tracer = made(place.scene)
        resolver = HitResolver.create(place.scene.mesh, place.lightmap, place.points)
        sampler = HemisphereSampler.create(_RAYS, 0)
        tables.append(trace_hits(tracer, resolver, sampler, place.points, 0))
    plain, found = tables
    wall = np.arange(len(found)) // (len(found) // 6)
    nothing = len(found)
    yield Measured(float(np.mean(found == nothing)), 1e-3)
    own = wall[np.minimum(found, nothing - 1)] == wall[:, None]
    yield Measured(float(np.mean(own & (found < nothing))), 1e-3)
    yield Measured(float(np.mean(found != plain)), 0.02)


def _two_sheets(gap: float, scale: float) -> Scene:
    """A floor of side 2 and a ceiling of the same size above it, facing each other, `gap` apart."""
    square = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    vertices = scale * np.concatenate([square, square + np.array([0.0, gap, 0.0])])
    faces = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]])
    mesh = Mesh(vertices, faces, np.zeros(4, int))
    return Scene("sheets", mesh, (Material("white", (0.5, 0.5, 0.5)),), Camera((0, 0, 5), (0, 0, -1)))


def _gaps(route: Route) -> Iterator[Member]:
    for scale in (1e-3, 1.0, 1e4):
        for gap in (1e-2, 0.2):
            yield Member(f"scale {scale:g}, gap of {gap:g} sizes", (_two_sheets(gap, scale), scale))


@case("G3", "a near occluder is seen", subjects=tracers, family=_gaps, routes=(F32,))
def near_occluder(made: Any, posed: tuple[Scene, float], route: Route) -> Iterator[Measured]:
    """G3: the floor under a sheet is in its shadow, and no point of a sheet shadows itself."""
    scene, scale = posed
    tracer = made(scene)
    rng = np.random.default_rng(0)
    count = 200
    place = scale * rng.uniform(-0.6, 0.6, (count, 3)) * [1, 0, 1]
    up = np.tile([0.0, 1.0, 0.0], (count, 1))
    points = SurfacePoints(place, up, np.full((count, 3), 0.5), np.zeros(count, int), np.full((count, 3), 1 / 3))
    lamp = Emitters(
        np.array([[[0.0, 1.0, 0.0, 0.0]]]), np.array([[[0.0, -1.0, 0.0]]]), np.ones((1, 1, 3)),
        np.array([[[-3.0, -2.0, 0.0, 0.0]]]),
    )  # fmt: skip
    yield Measured(float(np.mean(direct_irradiance(tracer, points, lamp) > 0)), 0.0)
    lifted = SurfacePoints(
        place + np.array([0.0, 0.5 * scale, 0.0]), up, points.albedo, points.face, points.barycentric
    )
    yield Measured(float(np.mean(direct_irradiance(tracer, lifted, lamp) == 0)), 0.0)


def _boxes(route: Route) -> Iterator[Member]:
    for scale in (1e-2, 1.0, 1e3):
        yield Member(f"scale {scale:g}", scale)


@case("G5", "back faces carry nothing", subjects=tracers, family=_boxes, routes=(F32,))
def back_faces(made: Any, scale: float, route: Route) -> Iterator[Measured]:
    """G5: seen from outside, the room shows backs alone: every ray from there carries nothing; points there are not buried.

    Points beyond the walls, facing in, see only the outsides; points inside see only fronts.
    """
    placed = _placed(scale, 0.0)
    tracer = made(placed.scene)
    resolver = HitResolver.create(placed.scene.mesh, placed.lightmap, placed.points)
    away = placed.points.position * 1.5
    outside = SurfacePoints(
        away, placed.points.normal, placed.points.albedo, placed.points.face, placed.points.barycentric
    )
    table = trace_hits(tracer, resolver, HemisphereSampler.create(_RAYS, 0), outside, 0)
    yield Measured(float(np.mean(table < len(placed.points))), 0.0)
    yield Measured(float(np.mean(buried(tracer, placed.points, 0))), 0.0)


def _borders(route: Route) -> Iterator[Member]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        faces = rng.integers(0, 12, 4000)
        u = rng.uniform(0, 1, 4000)
        v = (1 - u) * rng.choice([0.0, 0.5, 1.0], 4000)
        # Just within the edges: the room's charts touch, without the padding of a real atlas.
        u, v = (1e-3 + 0.997 * part for part in (u, v))
        yield Member(f"seed {seed}", (faces, u, v, rng.uniform(-0.5, 0.5, (4000, 2))))


@case(
    "G5", "nothing is looked up across a seam", subjects=lambda: {"resolver": HitResolver.create}, family=_borders,
    routes=(F32,),
)  # fmt: skip
def seams(make: Any, hits: tuple[np.ndarray, ...], route: Route) -> Iterator[Measured]:
    """G5: hits at the edges of charts, jittered by half a texel, stay on the wall that was hit; back hits carry nothing."""
    ds = room()
    mesh = ds.transport.scene.mesh
    resolver = make(mesh, ds.lightmap, ds.points)
    faces, u, v, jitter = hits
    normal = mesh.normals[faces].astype(np.float32)
    found = {"primID": faces.astype(np.int32), "u": u.astype(np.float32), "v": v.astype(np.float32)}
    one_set = tuple(jnp.asarray(offsets[None], jnp.float32) for offsets in jitter.T)
    once = np.zeros(1, int)
    sample = resolver(found, jnp.asarray(-normal), one_set, once)
    chart = ds.lightmap.chart[ds.points.face]
    carried = sample < len(ds.points)
    wrong = chart[np.minimum(sample, len(ds.points) - 1)] != ds.lightmap.chart[faces]
    yield Measured(float(np.mean(wrong & carried) + np.mean(~carried)), 0.0)
    yield Measured(float(np.mean(resolver(found, jnp.asarray(normal), one_set, once) < len(ds.points))), 0.0)
