"""What a scene calls for, decided before anything is simulated: each decision with its reason, and the predicted cost."""

import time
from dataclasses import dataclass, replace
from math import ceil, log
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from data_gen.atlas import check_mips, padding
from data_gen.effects.subsurface import media, predicted_events, predicted_walks
from data_gen.hull import check_hull
from data_gen.sampling import check_measurements
from data_gen.scenarios import check_scenario
from data_gen.tracer import Tracer
from prt_bench.emitters import Emitters
from prt_bench.errors import SpecError
from prt_bench.lights import AREA_SAMPLES, ENVIRONMENT_SAMPLES
from prt_bench.scene import Scene
from prt_bench.transport import GatherOperator

MOST_BOUNCES = 256
MeasureOn = Literal["surface", "hull"]
_GATHER_TEXELS = 256
_LIGHT_SAMPLES = {"area": AREA_SAMPLES, "environment": ENVIRONMENT_SAMPLES}
_NODE_SHARE = 0.2  # share of receivers that become nodes, for predictions
_COVERAGE = 0.75  # share of lightmap texels that charts cover, for predictions


@dataclass(frozen=True)
class Decision:
    """One choice of the planner, and why."""

    what: str
    decision: str
    why: str


@dataclass(frozen=True)
class Cost:
    """Predicted cost of a bake: rays of each kind, bytes on disk, peak bytes in memory, seconds."""

    gather_rays: int
    shadow_rays: int
    disk_bytes: int
    memory_bytes: int
    seconds: float


@dataclass(frozen=True)
class Plan:
    """The settings of a bake and what the scene needs.

    `texels` and `gather_texels` are the sides of the receivers' and the gather samples' lightmaps, `rays` is per point,
    `bounces` an upper bound that the traced operator lowers, `channels` 1 for achromatic scenes, `convex` "outside" (a lone
    convex body), "inside" (a convex room) or None.
    """

    texels: int
    gather_texels: int
    rays: int
    bounces: int
    tolerance: float
    channels: int
    convex: str | None
    effects: tuple[str, ...]
    vertices: bool
    decisions: tuple[Decision, ...]
    cost: Cost
    node_rays: int = 0
    node_tolerance: float = 0.0
    mips: int = 0
    texture_set: bool = False

    def needs_shadow_rays(self, scene: Scene, emitters: Emitters) -> bool:
        """False only where nothing can stand between these emitters and a surface they face."""
        if self.convex == "outside":
            return False
        if self.convex == "inside":
            place = np.asarray(emitters.position).reshape(-1, 4)
            place = place[np.asarray(emitters.intensity).reshape(-1, 3).max(axis=1) > 0]
            return bool(np.any(place[:, 3] == 0)) or not _in_front_of_all(scene, place[:, :3])
        return True

    def table(self) -> str:
        """The decisions and the predicted cost as aligned text."""
        rows = [(d.what, d.decision, d.why) for d in self.decisions]
        cost = self.cost
        rows.append(
            (
                "predicted cost",
                f"{cost.seconds:.1f} s",
                f"{cost.gather_rays / 1e6:.1f} M gather rays, {cost.shadow_rays / 1e6:.1f} M shadow rays at most, "
                f"{cost.disk_bytes / 1e6:.0f} MB on disk, {cost.memory_bytes / 1e6:.0f} MB in memory",
            )
        )
        first, second = (max(len(row[i]) for row in rows) for i in (0, 1))
        return "\n".join(f"{a:<{first}}  {b:<{second}}  {c}" for a, b, c in rows)

    def to_json(self) -> list[dict[str, str]]:
        """The decisions as rows for records and reports."""
        return [vars(decision).copy() for decision in self.decisions]


def plan(
    scene: Scene,
    scenario: str = "spot",
    lightings: int = 128,
    texels: int = 128,
    rays: int = 256,
    measurements: int = 256,
    supersampling: int = 8,
    tolerance: float = 1e-4,
    gather_texels: int | None = None,
    ood: tuple[str, ...] = (),
    workers: int | None = None,
    streamed: int = 0,
    measure_on: MeasureOn = "surface",
    vertices: bool = False,
    node_rays: int = 0,
    node_tolerance: float = 0.02,
    mips: int = 0,
    texture_set: bool = False,
) -> Plan:
    """Decide what baking `scene` needs.

    `tolerance` bounds the light that truncating the bounces leaves out, relative to the brightest direct light; `node_rays`,
    `node_tolerance`, `mips` and `texture_set` are those of `bake`. Raises
    `SpecError` for settings that cannot be baked and `SceneError` for more measurement points than the surface can hold,
    or for a hull where there is no body.
    """
    for name, value, least in (("lightings", lightings, 1), ("texels", texels, 8), ("gather_texels", gather_texels, 8),
                               ("measurements", measurements, 1), ("supersampling", supersampling, 1),
                               ("workers", workers, 1), ("streamed", streamed, 0)):  # fmt: skip
        if value is not None and value < least:
            raise SpecError(f"{name} is {value}, but a bake needs at least {least}")
    for name in (scenario, *ood):
        check_scenario(name)
    check_measurements(scene, measurements, supersampling)
    if measure_on not in get_args(MeasureOn):
        raise SpecError(f"measure_on must be {' or '.join(map(repr, get_args(MeasureOn)))}, not {measure_on!r}")
    if measure_on == "hull":
        check_hull(scene)
    for name, value, least in (("rays", rays, 2), ("node_rays", node_rays, 0)):
        if value < least or value % 2:
            raise SpecError(
                f"{name} is {value}, but it must be an even number from {least} up: the two halves measure the noise"
            )
    for name, value in (("tolerance", tolerance), ("node_tolerance", node_tolerance)):
        if not 0 < value < 1:
            raise SpecError(f"{name} is {value}, but it must lie between 0 and 1")

    check_mips(texels, mips)

    convex = _convexity(scene)
    channels = 1 if scene.achromatic else 3
    gather = min(texels, gather_texels or _GATHER_TEXELS)
    if node_rays and gather == texels:
        raise SpecError(
            f"node_rays is {node_rays}, but at {texels}² texels the receivers are the gather samples, which are all traced;"
            " leave it out, or ask for fewer gather_texels"
        )
    bounces, bounce_reason = _bounces(scene.largest_albedo, tolerance, convex)
    bodies = media(scene)
    decisions = (
        Decision("effects", "diffuse, subsurface", f"{_names(scene, bodies)} filled with a medium")
        if bodies
        else Decision(
            "effects",
            "diffuse",
            "lobes towards the eye take no part in it" if scene.glossy else "no material asks for more",
        ),
        Decision("channels", str(channels), "every albedo is grey" if channels == 1 else "albedo differs by channel"),
        Decision("bounces", f"≤ {bounces}", bounce_reason),
        Decision(
            "shadow rays",
            {"outside": "none", "inside": "only for lights outside", None: "yes"}[convex],
            {
                "outside": "a lone convex body cannot shadow itself",
                "inside": "nothing stands between points of a convex room",
                None: "surfaces can occlude each other",
            }[convex],
        ),
        Decision("view dependence", "in the runtime", "materials have glossy lobes, which sh-triple shows")
        if scene.glossy
        else Decision("view dependence", "none", "every material is diffuse"),
        Decision(
            "gather samples",
            f"{gather}² texels",
            "the receivers themselves"
            if gather == texels
            else "bounced light is smooth: a coarser lightmap carries it",
        ),
        Decision("rays per point", str(rays), "as asked; the noise is measured from their two halves"),
        Decision(
            "receivers",
            f"{node_rays} rays, at nodes",
            f"as asked: light between them is interpolated where that misses by less than {node_tolerance:.1%}",
        )
        if node_rays
        else Decision("receivers", "all traced", "interpolation of smooth light was not asked for (node_rays)"),
    )
    if bodies:
        walks = f"{rays} walks per point" + ("" if channels == 1 else " and channel")
        worst = max(predicted_events(scene, index) for index in bodies)
        decisions += (
            Decision("subsurface", walks, f"at most {worst:.0f} events each on average, by the bodies' size"),
        )
    if vertices:
        decisions += (Decision("vertices", "traced", "as asked, for transfer that is stored there"),)
    if mips:
        decisions += (Decision("mip levels", str(mips), f"as asked: charts lie {padding(mips)} texels apart"),)
    if texture_set:
        decisions += (Decision("lightmap", "a texture set", "as asked: every material has a square of its own"),)
    draft = Plan(
        texels, gather, rays, bounces, tolerance, channels, convex, ("subsurface",) if bodies else (), vertices,
        decisions, Cost(0, 0, 0, 0, 0.0),
        node_rays, node_tolerance, mips, texture_set,
    )  # fmt: skip
    count = lightings + max(16, ceil(lightings / 4)) + 16 * len(ood)
    dense = measurements * supersampling
    return replace(draft, cost=_predict(draft, scene, scenario, count, dense, workers, streamed))


def _names(scene: Scene, indices: list[int]) -> str:
    """Materials as the subject of a sentence."""
    names = [f"'{scene.materials[index].name}'" for index in indices]
    return f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'}"


def _bounces(albedo: float, tolerance: float, convex: str | None) -> tuple[int, str]:
    """Bounces after which the geometric tail ρ^k / (1 − ρ) is under the tolerance; one where no surface sees another."""
    if convex == "outside":
        return 1, "a lone convex body sees no surface; one gather shows that it is black"
    if albedo <= 0:
        return 1, "every surface is black"
    if albedo >= 1:
        return MOST_BOUNCES, "albedo 1 gives no bound; the traced operator must show that light escapes"
    bound = ceil(log(tolerance * (1 - albedo)) / log(albedo))
    if bound > MOST_BOUNCES:
        return MOST_BOUNCES, f"albedo {albedo:.3f} would need {bound}; the traced operator must show that fewer do"
    return max(bound, 1), f"largest albedo {albedo:.3f} leaves less than {tolerance:g} after that; tracing lowers it"


def _convexity(scene: Scene) -> str | None:
    """ "outside" when every vertex lies behind every face, "inside" when in front of every face, None otherwise."""
    slack = 1e-6 * scene.extent
    behind = in_front = True
    normals, corners = scene.mesh.normals, scene.mesh.triangles[:, 0]
    for start in range(0, len(normals), 256):
        part = slice(start, start + 256)
        height = normals[part] @ scene.mesh.vertices.T - np.sum(normals[part] * corners[part], axis=1)[:, None]
        behind &= bool(np.all(height <= slack))
        in_front &= bool(np.all(height >= -slack))
        if not (behind or in_front):
            return None
    if behind and in_front:
        return None  # flat
    return "outside" if behind else "inside"


def _in_front_of_all(scene: Scene, points: Float[np.ndarray, "P 3"]) -> bool:
    normals, corners = scene.mesh.normals, scene.mesh.triangles[:, 0]
    return bool(np.all(points @ normals.T >= np.sum(normals * corners, axis=1)))


def _predict(
    draft: Plan, scene: Scene, scenario: str, lightings: int, dense: int, workers: int | None, streamed: int
) -> Cost:
    """Cost from counts and from rates measured here and now on this scene."""
    receivers = int(_COVERAGE * draft.texels**2)
    samples = int(_COVERAGE * draft.gather_texels**2)
    shared = draft.gather_texels == draft.texels
    traced = receivers if shared else receivers + samples
    lit = receivers + dense + (0 if shared else samples)
    columns = lightings * draft.channels
    if draft.node_rays:
        traced -= receivers
    gather_rays = (traced + draft.vertices * len(scene.mesh.vertices)) * draft.rays
    gather_rays += int(_NODE_SHARE * receivers) * draft.node_rays
    lit_points = lit * lightings + (samples + dense) * streamed
    shadow_rays = 0 if draft.convex == "outside" else lit_points * _LIGHT_SAMPLES.get(scenario, 1)
    ray_rate, sum_rate = _rates(scene, workers)
    gathered = _NODE_SHARE * receivers * draft.node_rays if draft.node_rays else receivers * draft.rays
    sums = (samples * min(draft.bounces, 16) * draft.rays + gathered) * columns
    seconds = (gather_rays + 0.5 * shadow_rays) / ray_rate + sums / sum_rate
    pairs = 4 * receivers * columns
    disk = 2 * pairs + pairs // 4 + gather_rays * 2 + 4 * samples * streamed
    if scene.translucent:
        starts = (receivers + (0 if shared else samples) + draft.vertices * len(scene.mesh.vertices)) * draft.rays
        walks, queries = predicted_walks(scene, draft.channels)
        gather_rays += int(starts * queries)
        disk += int(2 * starts * walks)
        seconds += starts * queries / ray_rate
    memory = int(6e8) + 12 * samples * columns * 4 + 6 * min(receivers, 1 << 14) * columns * 4
    return Cost(gather_rays, shadow_rays, disk, memory, seconds)


def _rates(scene: Scene, workers: int | None) -> tuple[float, float]:
    """Rays per second on this scene and gathered values per second, each timed on a small batch."""
    rng = np.random.default_rng(0)
    tracer = Tracer(scene, workers)
    origins = rng.uniform(scene.bounds[0], scene.bounds[1], (1 << 17, 3)).astype(np.float32)
    directions = rng.normal(size=origins.shape).astype(np.float32)
    tracer.intersect(origins[:1024], directions[:1024])
    started = time.perf_counter()
    tracer.intersect(origins, directions)
    ray_rate = len(origins) / (time.perf_counter() - started)

    gather = GatherOperator.from_hits(rng.integers(0, 4096, (1024, 64)), 4096)
    light = jnp.ones((4096, 256), jnp.float32)
    _gathered(gather, light).block_until_ready()
    started = time.perf_counter()
    _gathered(gather, light).block_until_ready()
    return ray_rate, 1024 * 64 * 256 / (time.perf_counter() - started)


@jax.jit
def _gathered(gather: GatherOperator, light: Array) -> Array:
    return gather(light)
