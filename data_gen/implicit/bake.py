"""Transfer vectors at surface points of an implicit scene: visibility by sphere tracing, bounces by the gather operator.

A hit belongs to the sample that is nearest in position and normal together, so thin walls and creases do not leak. From
there on everything is what meshes go through: `escaping_transfer`, `GatherOperator`.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from data_gen.implicit.sampling import surface_points
from prt_bench.errors import SpecError
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.implicit.scene import OFFSET, ImplicitScene, SurfaceSamples
from prt_bench.implicit.tracing import trace
from prt_bench.progress import track
from prt_bench.transport import GatherOperator, final_gather, radiosity, tail_bounds
from prt_bench.visibility import escaping_transfer

_RAYS = 1 << 16  # traced at once
_TURNED = 8.0
"""What a normal of another direction costs, in spacings of the samples per unit of difference."""
_MOST_BOUNCES = 64
_HIGHEST = 8


class Baked(NamedTuple):
    """Samples that light bounces between, which a field is fitted to, and `fresh` ones that it has not seen.

    `noise` is the relative standard error of the direct vectors of `fresh`, from the two halves of its rays; `bounces` how
    many were followed.
    """

    samples: SurfaceSamples
    fresh: SurfaceSamples
    noise: float
    bounces: int


def bake(
    scene: ImplicitScene,
    count: int = 4096,
    rays: int = 256,
    order: int = 5,
    fresh: int = 1024,
    seed: int = 0,
    tolerance: float = 1e-3,
) -> Baked:
    """Sample the surface and trace it: K = order² transfer vectors at `count` samples and `fresh` other points, in float32.

    `tolerance` is the share of light that may be missing for want of bounces. Raises `SpecError` for settings out of range.
    """
    if count < 16 or fresh < 1 or rays < 2 or not 1 <= order <= _HIGHEST:
        raise SpecError(
            f"a bake of '{scene.name}' needs at least 16 samples, a fresh point, 2 rays and an order from 1 to {_HIGHEST},"
            f" not {count}, {fresh}, {rays} and {order}"
        )
    position = surface_points(scene, count + fresh, seed)
    position = np.random.default_rng(seed).permutation(position)  # neighbours on a line must not all be of one kind
    normal = scene.normal_at(position)
    albedo = scene.albedos[scene.part_at(position)]
    sampler = HemisphereSampler.create(rays, seed)
    index = SampleIndex(position[:count], normal[:count], scene)
    hits = hit_table(scene, index, position, normal, sampler)
    direct = escaping_transfer(hits == count + 1, sampler, 0, normal, order)
    halves = [
        escaping_transfer(hits[count:, rows] == count + 1, sampler, count, normal[count:], order, rows)
        for rows in (slice(0, rays // 2), slice(rays // 2, rays))
    ]
    noise = float(np.linalg.norm(halves[0] - halves[1]) / (2.0 * np.linalg.norm(direct[count:])))
    gather = GatherOperator.from_hits(hits[:count], count)
    channels = 1 if scene.achromatic else 3
    reflected = jnp.asarray(albedo[:count, :channels], jnp.float32)
    bounds = tail_bounds(gather, reflected, _MOST_BOUNCES)
    enough = np.flatnonzero(bounds <= tolerance)
    if not enough.size:
        raise SpecError(
            f"{_MOST_BOUNCES} bounces leave up to {bounds[-1]:.2g} of the light in '{scene.name}'; lower its largest albedo"
        )
    bounces = int(enough[0]) + 1
    columns = jnp.broadcast_to(jnp.asarray(direct[:count].T)[:, :, None], (order * order, count, channels))
    outgoing = radiosity(gather, reflected, columns, bounces - 1)
    received = final_gather(GatherOperator.from_hits(hits, count), outgoing)
    indirect = np.moveaxis(np.asarray(received), 0, 2)
    parts = [
        SurfaceSamples(*(array[rows] for array in (position, normal, albedo, direct, indirect)))
        for rows in (slice(0, count), slice(count, None))
    ]
    return Baked(parts[0], parts[1], noise, bounces)


class SampleIndex:
    """Finds the sample that a hit belongs to: the nearest in position and normal, `_TURNED` spacings for a unit of normal."""

    def __init__(
        self, position: Float[np.ndarray, "S 3"], normal: Float[np.ndarray, "S 3"], scene: ImplicitScene
    ) -> None:
        self._scene = scene
        nearest, _ = KDTree(position).query(position, k=2)
        self._cost = _TURNED * float(np.median(nearest[:, 1]))
        self._tree = KDTree(np.hstack([position, self._cost * normal]))

    def __call__(self, position: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """The sample of each point of the surface."""
        if not len(position):
            return np.zeros(0, int)
        normal = self._scene.normal_at(position)
        return np.asarray(self._tree.query(np.hstack([position, self._cost * normal]), workers=-1)[1])

    @property
    def samples(self) -> int:
        """How many there are."""
        return self._tree.n


def hit_table(
    scene: ImplicitScene,
    index: SampleIndex,
    position: Float[np.ndarray, "P 3"],
    normal: Float[np.ndarray, "P 3"],
    sampler: HemisphereSampler,
) -> Int[np.ndarray, "P R"]:
    """What the rays of `sampler` meet from points 0, 1, …: the index of a sample, or S + 1 where they escape."""
    rays = sampler.local.shape[1]
    step = max(_RAYS // rays, 1)
    table = np.full((len(position), rays), index.samples + 1, np.int32)
    origin = (position + OFFSET * scene.tolerance * normal).astype(np.float32)
    for at in track(range(0, len(position), step), f"trace {scene.name}"):
        rows = slice(at, at + step)
        origins, directions = (
            np.asarray(part) for part in sampler.rays(origin[rows], sampler.turns(at, normal[rows].astype(np.float64)))
        )
        found = trace(scene, origins, directions)
        place = origins[found.hit] + found.distance[found.hit, None] * directions[found.hit]
        part = table[rows].reshape(-1)
        part[found.hit] = index(place)
        table[rows] = part.reshape(-1, rays)
    return table
