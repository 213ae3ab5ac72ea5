"""Clusters by distance alone and clusters whose members see their root: what walls are worth at equal bytes.

Samples of the apartment are clustered both ways. Functions per cluster and component, and so bytes, are the same in each row.
Prints in how many rooms a cluster lies on average, the error of indirect light against the operator on all samples, over
all held-out lamps and of the median one, and that of shadowed direct light against ray casting.

    python experiments/cluster_walls.py [--radius 0.15] [--clusters 24 48 96] [--lights 300] [--lifts 0.01 0.1]

`lift` is how far above the samples walls count, in sides of a cluster.
"""

import numpy as np
from _frames import arguments, table
from clustered_pca import NEAR, SCENE, START, TESTED, Level, relative
from jaxtyping import Float, Int

import prt_bench as prt
from data_gen.direct import direct_irradiance, visibility
from data_gen.meshless import hemispheres, hidden_by_walls, nearest_hits
from data_gen.particles import particle_samples
from data_gen.scenarios import sample_lightings
from data_gen.tracer import Tracer
from prt_bench.clusters import clusters_in_sight, clusters_of
from prt_bench.depth import ClusteredVisibility, hemisphere_directions, shadow_error
from prt_bench.lights import emitters
from prt_bench.sampled import ClusteredTransfer
from prt_bench.transport import GatherOperator

FUNCTIONS, COMPONENTS, DIRECTIONS, RAYS = 10, 30, 504, 64


def main() -> None:
    settings = arguments(
        __doc__, None, data=False, radius=0.15, clusters=[24, 48, 96], lights=300, lifts=[0.01, 0.1]
    ).parse_args()
    scene = prt.load_scene(SCENE)
    tracer = Tracer(scene)
    points = particle_samples(scene, tracer, START, settings.radius)
    hits = nearest_hits(tracer, points, scene.mesh.normals, RAYS)
    gather = GatherOperator.from_hits(hits, len(points))
    trained = sample_lightings(scene, "point", settings.lights, 0, tracer, achromatic=True)
    light = direct_irradiance(tracer, points, emitters(trained))[..., 0].T
    light /= np.linalg.norm(light, axis=0)
    lamps = sample_lightings(scene, "point", TESTED, 1, tracer, achromatic=True)
    places = np.array([np.asarray(lamp.lights[0].emitters().position)[0, :3] for lamp in lamps])
    unshadowed = direct_irradiance(tracer, points, emitters(lamps), shadow_rays=False)[..., 0]
    cast = visibility(tracer, points, emitters(lamps))[..., 0]
    around = hemisphere_directions(DIRECTIONS)
    depth = hemispheres(tracer, points, around)
    reference = None
    print(f"{len(points)} samples")
    rows = []
    for count in settings.clusters:
        bend = float(np.sqrt(scene.mesh.areas.sum() / count))
        by_distance = clusters_of(points, count, bend)
        found = {"distance": (by_distance, by_distance.owner(points))}
        for lift in settings.lifts:
            hidden = hidden_by_walls(tracer, points, lift * bend)
            found[f"distance and sight, lift {lift:g}"] = clusters_in_sight(points, count, bend, hidden)
        for name, (clusters, owner) in found.items():
            level = Level(points, clusters, owner, gather)
            if reference is None:
                reference = level.bounced((unshadowed * cast).T)
            transfer = ClusteredTransfer.fit(light, owner, level.bounced, FUNCTIONS, FUNCTIONS)
            grey = np.repeat((unshadowed * cast)[:, :, None], 3, axis=2)
            off = np.stack([transfer.indirect(lamp) for lamp in grey], axis=2)
            each = [relative(off[..., k], reference[..., k]) for k in range(TESTED)]
            seen = ClusteredVisibility.fit(depth, around, owner, COMPONENTS, NEAR)
            shadows = shadow_error(seen.lit(points, places), cast, unshadowed)
            rows.append(
                (
                    count,
                    name,
                    f"{rooms(points.position, owner):.2f}",
                    relative(off, reference),
                    float(np.median(each)),
                    shadows,
                )
            )
            print(*rows[-1], flush=True)
    table(("clusters", "by", "rooms", "indirect", "median lamp", "shadows"), rows)


def rooms(position: Float[np.ndarray, "S 3"], owner: Int[np.ndarray, " S"]) -> float:
    """In how many of the apartment's six rooms a cluster lies on average."""
    room = np.searchsorted((-2.0, 2.0), position[:, 0]) + 3 * (position[:, 2] > 0)
    return len(np.unique(6 * owner + room)) / len(np.unique(owner))


if __name__ == "__main__":
    main()
