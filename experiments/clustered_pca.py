"""Clustered PCA in a large interior: samples without a mesh, compressed visibility and transfer, and what they cost and miss.

Particles find the samples of the apartment, which are grouped into clusters. Each sample's hemisphere of depth is compressed to
a few coefficients of its cluster; direct light of 1000 lamps gives each cluster a basis, whose functions light the scene once.
Prints seconds and bytes, the error of shadows against ray casting by coefficients and directions (and soft ones, of lamps of
25 points), and that of indirect light against the operator on all samples, beside bases of the whole scene. Then the same
on a lightmap by registered methods, with as many functions, and frames of both: samples as splats and the lightmap, under one
point and under an area of 25, timed and against path tracing.

    python experiments/clustered_pca.py [--radius 0.088] [--clusters 48] [--rays 64] [--lights 1000] [--directions 2016 504 126]

Draws samples, clusters, shadows and light from above, and frames of both. Errors are relative to the norm over
all samples and lamps.
"""

import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from _frames import arguments, table
from _splats import compare
from jaxtyping import Float
from matplotlib.colors import hsv_to_rgb

import prt_bench as prt
from data_gen.direct import direct_irradiance, visibility
from data_gen.meshless import hemispheres, hidden_by_walls, nearest_hits, walls_around
from data_gen.particles import particle_samples
from data_gen.scenarios import sample_lightings
from data_gen.tracer import Tracer
from prt_bench.assets import RuntimeAsset
from prt_bench.clusters import Clusters, apart, bases_of_clusters, clusters_in_sight
from prt_bench.depth import ClusteredVisibility, hemisphere_directions, shadow_error
from prt_bench.images import exposure_for, tone_map
from prt_bench.lights import emitters
from prt_bench.linalg import fewer_columns, principal_rows
from prt_bench.metrics import relative_norm
from prt_bench.packing import packed, threshold
from prt_bench.points import SurfacePoints
from prt_bench.runtime.runtime import Runtime
from prt_bench.sampled import ClusteredTransfer, SampledLight, reaches
from prt_bench.transport import GatherOperator, indirect

SCENE = "apartment"
START = np.array([-3.0, 1.5, 2.3])
SOURCES = RECEIVERS = 10
COEFFICIENTS = 50
SIZES = (10, 25, 50, 100)
KEPT = (1.0, 0.5, 0.25, 0.2, 0.1, 0.08, 0.05, 0.025)
LIFT = 0.1  # of a cluster's side: how far above the samples walls count
NEAR = 0.25  # m, see ClusteredVisibility
BOUNCES = 12
TESTED, AREA_TESTED, SIDE = 16, 4, 5  # lamps: points, and areas of 5² points
AREA = 0.4  # m, their sides
_COLUMNS = 48


class Level(NamedTuple):
    """The samples with their clusters, and the operator between them."""

    points: SurfacePoints
    clusters: Clusters
    owner: np.ndarray
    gather: GatherOperator

    def bounced(self, direct: Float[np.ndarray, "S n"]) -> Float[np.ndarray, "S C n"]:
        """Indirect light of all bounces from columns of grey direct light."""
        albedo = jnp.asarray(self.points.albedo, jnp.float32)
        out = np.empty((len(self.points), 3, direct.shape[1]), np.float32)
        for start in range(0, direct.shape[1], _COLUMNS):
            part = jnp.asarray(direct[:, start : start + _COLUMNS].T, jnp.float32)
            light = jnp.broadcast_to(part[:, :, None], (*part.shape, 3))
            out[:, :, start : start + _COLUMNS] = np.moveaxis(
                np.asarray(indirect(self.gather, albedo, light, BOUNCES)), 0, 2
            )
        return out


seconds: dict[str, float] = {}


@contextmanager
def stage(name: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started
    print(f"{name}: {seconds[name]:.1f} s", flush=True)


def main() -> None:
    parser = arguments(
        __doc__,
        "clustered_pca.webp",
        radius=0.084,
        clusters=48,
        rays=64,
        lights=1000,
        directions=[2016, 504, 126],
        texels=192,
    )
    settings = parser.parse_args()
    scene = prt.load_scene(SCENE)
    tracer = Tracer(scene)
    with stage("samples"):
        points = particle_samples(scene, tracer, START, settings.radius)
    with stage("clusters"):
        bend = float(np.sqrt(scene.mesh.areas.sum() / settings.clusters))
        clusters, owner = clusters_in_sight(
            points, settings.clusters, bend, hidden_by_walls(tracer, points, LIFT * bend)
        )
    with stage("hit table"):
        hits = nearest_hits(tracer, points, scene.mesh.normals, settings.rays)
        level = Level(points, clusters, owner, GatherOperator.from_hits(hits, len(points)))
    sizes = np.bincount(owner)
    print(
        f"{len(points)} samples, {len(clusters)} clusters of {sizes.min()} to {sizes.max()} (median {np.median(sizes):.0f})"
    )

    first, *others = settings.directions
    with stage("depth buffers"):
        depth = hemispheres(tracer, points, hemisphere_directions(first))
    with stage("visibility"):
        seen = ClusteredVisibility.fit(depth, hemisphere_directions(first), owner, COEFFICIENTS, NEAR)
    lamps = sample_lightings(scene, "point", TESTED, 1, tracer, achromatic=True)
    shown = shadows(level, tracer, lamps, seen, {first: depth, **dict.fromkeys(others)})
    del depth

    with stage("direct light"):
        trained = sample_lightings(scene, "point", settings.lights, 0, tracer, achromatic=True)
        light = np.concatenate(
            [
                direct_irradiance(tracer, points, emitters(trained[at : at + 50]))[..., 0].T
                for at in range(0, len(trained), 50)
            ],
            axis=1,
        )
        light /= np.linalg.norm(light, axis=0)
    tested = direct_irradiance(tracer, points, emitters(lamps))[..., 0].T
    transfer, pictures = transfers(level, light, tested)
    total = sum(
        seconds[name]
        for name in (
            "samples",
            "clusters",
            "hit table",
            "depth buffers",
            "visibility",
            "direct light",
            "source bases",
            "emission",
            "receiver bases",
        )
    )
    print(f"\nprecomputation: {total:.0f} s\n")
    draw(settings.out, level, {**shown, **pictures})
    test, asset, lamp = on_lightmap(scene, settings)
    model = SampledLight(points, seen, transfer, reaches(points), walls_around(tracer, points, scene.mesh.normals))
    (grid,) = area_lamps(np.asarray(lamp.lights[0].emitters().position)[:, :3])
    compare(test, model, asset, lamp, grid, settings.out.with_stem(settings.out.stem + "_splats"))


def shadows(
    level: Level,
    tracer: Tracer,
    lamps: tuple[prt.Lighting, ...],
    seen: ClusteredVisibility,
    traced: dict[int, np.ndarray | None],
) -> dict[str, np.ndarray]:
    """Tables of shadow errors; what the first lamp lights, cast and reconstructed."""
    points = level.points
    places = np.array([np.asarray(lamp.lights[0].emitters().position)[0, :3] for lamp in lamps])
    open_light = direct_irradiance(tracer, points, emitters(lamps), shadow_rays=False)[..., 0]
    cast = visibility(tracer, points, emitters(lamps))[..., 0]
    rows = []
    for count, depth in traced.items():
        around = hemisphere_directions(count)
        cast_depth = hemispheres(tracer, points, around) if depth is None else depth
        model = ClusteredVisibility.fit(cast_depth, around, level.owner, max(SIZES), NEAR)
        rows.append(
            [
                count,
                *(f"{shadow_error(model.truncated(size).lit(points, places), cast, open_light):.3f}" for size in SIZES),
            ]
        )
    print("\nerror of shadowed direct light, point lamps, by directions and coefficients")
    table(("directions", *map(str, SIZES)), rows)

    kept = seen
    soft, wanted = area_lamps(places[:AREA_TESTED]), []
    for grid in soft:
        lighting = [prt.Lighting(tuple(prt.PointLight(place, (1.0, 1.0, 1.0)) for place in grid))]
        wanted.append(visibility(tracer, points, emitters(lighting))[0].mean(axis=1))
    found = np.array([kept.lit(points, grid).mean(axis=0) for grid in soft])
    error = shadow_error(found, np.array(wanted), open_light[:AREA_TESTED])
    print(f"\narea lamps of {SIDE**2} points, {COEFFICIENTS} coefficients: error {error:.3f}\n")
    mean, rows = 2 * kept.mean.size, []
    for share in KEPT:
        parts, model = kept.packed(share), kept.quantised(share)
        error = shadow_error(model.lit(points, places), cast, open_light)
        rows.append((f"{share:g}", f"{(mean + sum(part.bytes for part in parts)) / 1e6:.2f}", f"{error:.3f}"))
    print("visibility: share of entries kept, MB, error of shadows")
    table(("kept", "MB", "error"), rows)
    lit = open_light[0]
    return {
        "direct, ray cast": lit * cast[0],
        f"direct, {COEFFICIENTS} coefficients": lit * kept.lit(points, places[:1])[0],
    }


def area_lamps(centres: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "L 25 3"]:
    """Square grids of points about some places, facing down."""
    offset = (np.arange(SIDE) + 0.5) / SIDE * AREA - 0.5 * AREA
    x, z = np.meshgrid(offset, offset)
    return centres[:, None] + np.stack([x.ravel(), np.zeros(SIDE**2), z.ravel()], axis=1)


def transfers(
    level: Level, light: Float[np.ndarray, "S n"], tested: Float[np.ndarray, "S k"]
) -> tuple[ClusteredTransfer, dict[str, np.ndarray]]:
    """Tables of indirect errors and bytes; the model per cluster, and the first lamp's indirect light by it and by others."""
    count, samples = len(level.clusters), len(level.points)
    with stage("source bases"):
        local = bases_of_clusters(light, level.owner, count, SOURCES)
        emitted = apart(local, level.owner, count)
    with stage("emission"):
        response = level.bounced(emitted)
    sent = emitted.T @ light
    with stage("receiver bases"):
        model = ClusteredTransfer.joined(light, level.owner, local, response, RECEIVERS)
    basis, blocks = model.receivers, model.blocks
    spread = np.asarray(fewer_columns(jnp.asarray(sent))).astype(np.float32)
    caused = (response @ spread).reshape(samples, -1)
    reference = level.bounced(tested)
    own = emitted.T @ tested
    by_blocks = np.stack([model.indirect(np.repeat(lamp[:, None], 3, axis=1)) for lamp in tested.T], axis=2)
    whole = principal_rows(light.T.astype(np.float64), SOURCES * count).T
    wide = principal_rows(caused.T.astype(np.float64), SOURCES * count).T
    found = {
        f"{SOURCES} sources per cluster": (response @ own, 2 * (local.size + response.size)),
        f"{SOURCES} sources and {RECEIVERS} receivers per cluster": (
            by_blocks, 2 * (local.size + basis.size + blocks.size)),
        f"{SOURCES} sources of the scene": (
            level.bounced(whole[:, :SOURCES] @ (whole[:, :SOURCES].T @ tested)), 2 * samples * SOURCES * 4),
    }  # fmt: skip
    for size in (RECEIVERS, SOURCES * count):
        part = wide[:, :size]
        best = np.einsum("sb,bck->sck", part, np.einsum("sb,sck->bck", part, reference))
        found[f"{size} receivers of the scene, light known"] = (best, 2 * samples * size)
    rows = [(name, f"{size / 1e6:.1f}", f"{relative(values, reference):.3f}") for name, (values, size) in found.items()]
    print("\nindirect light against the operator; MB in 16 bits, nothing dropped")
    table(("model", "MB", "error"), rows)
    rows = []
    weight = np.repeat(np.sqrt(np.mean(sent**2, axis=1))[None], 3, axis=0).ravel()
    flat = response.reshape(samples, -1)
    for share in KEPT:
        part = packed(flat, threshold(share, np.abs(flat) * weight), weight)
        values = part.unpacked().reshape(response.shape) @ own
        rows.append((f"{share:g}", f"{(part.bytes + 2 * local.size) / 1e6:.1f}", f"{relative(values, reference):.3f}"))
    print("\ntransfer between clusters: share of entries kept, MB with source bases, error")
    table(("kept", "MB", "error"), rows)
    names = list(found)
    return model, {
        "indirect, operator": reference[:, :, 0],
        "indirect, per cluster": found[names[1]][0][:, :, 0],
        "indirect, scene-wide": found[names[3]][0][:, :, 0],
    }


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def on_lightmap(scene: prt.Scene, settings: Namespace) -> tuple[prt.LightingDataset, RuntimeAsset, prt.Lighting]:
    """Registered methods with as many functions per receiver, on a bake of the same scene; frames beside the reference.

    The held-out lightings with the asset of clustered PCA, and the one that is shown.
    """
    ds = prt.bake(scene, "point", 128, settings.texels, 64, measurements=768, seed=0, out=settings.data, streamed=1024)
    test, rows, frames = ds.split("test"), [], {}
    nearest = np.linalg.norm(
        [np.subtract(each.lights[0].position, scene.camera.target) for each in test.lightings], axis=1
    ).argmin()
    lamp, runtime = test.lightings[nearest], Runtime(test, size=(480, 360))
    shown = runtime.frame(lamp, runtime.lightmap(test.indirect[nearest]))
    exposure = exposure_for(shown, 0.9)
    frames["operator"] = tone_map(shown, exposure)
    for name, more in (("svd-ridge", {}), ("streamed-ridge", {}), ("clustered-pca", {"clusters": settings.clusters})):
        method = prt.method(name, basis=RECEIVERS, **more)
        started = time.perf_counter()
        model = method.fit(ds.split("train"))
        took = time.perf_counter() - started
        with TemporaryDirectory() as folder:
            asset = model.export(Path(folder) / "asset", "float16")
            loaded = runtime.load(asset)
        frames[method.label] = tone_map(runtime.frame(lamp, loaded), exposure)
        error = np.mean(relative_norm(asset.predict(test) - test.indirect, test.indirect))
        stored = sum(asset.bytes.values()) / 1e6
        rows.append((method.label, f"{error:.3f}", f"{stored:.2f}", f"{loaded.bytes / 1e6:.1f}", f"{took:.0f}"))
    print(f"\nlightmap of {len(ds.points)} receivers, 768 measurement points, noise floor {test.noise_floor:.3f}")
    table(("method", "error", "asset MB", "runtime MB", "fit s"), rows)
    figure, axes = plt.subplots(2, 2, figsize=(10, 8), layout="constrained")
    for axis, (title, frame) in zip(axes.ravel(), frames.items(), strict=True):
        axis.imshow(frame)
        axis.set_title(title)
        axis.set_axis_off()
    figure.savefig(settings.out.with_stem(settings.out.stem + "_frames"), dpi=80)
    plt.close(figure)
    return test, asset, lamp


def draw(path: Path, level: Level, lights: dict[str, np.ndarray]) -> None:
    """The apartment from above: samples and clusters, then light on floors and the tops of furniture."""
    points, seen = level.points, level.points.normal[:, 1] > 0.5
    x, z = points.position[seen][:, [0, 2]].T
    figure, axes = plt.subplots(2, 3, figsize=(15, 8.2), layout="constrained")
    panels = axes.ravel()
    order = np.random.default_rng(3).permutation(len(level.clusters)) / len(level.clusters)
    shade = np.where(np.arange(len(order)) % 2, 1.0, 0.65)
    hues = hsv_to_rgb(np.stack([order, np.full_like(order, 0.75), shade], axis=1))
    panels[0].scatter(x, z, c=hues[level.owner[seen]], s=5, lw=0)
    roots = points[level.clusters.chosen]
    above = roots.normal[:, 1] > 0.5
    panels[0].scatter(*roots.position[above][:, [0, 2]].T, c="white", edgecolors="black", s=36)
    panels[0].set_title(f"{len(points)} samples, {len(level.clusters)} clusters, from above")
    for axis, (title, light) in zip(panels[1:], lights.items(), strict=True):
        names = [name for name in lights if name.split(",")[0] == title.split(",")[0]]
        top = np.quantile(lights[names[0]][seen], 0.99)
        colour = np.clip(light[seen] / top, 0, 1) ** (1 / 2.2)
        colour = np.repeat(colour[:, None], 3, axis=1) if colour.ndim == 1 else colour
        axis.scatter(x, z, c=colour, s=26, marker="s", lw=0)
        axis.set_title(title)
    for axis in panels:
        axis.set(aspect="equal", xticks=[], yticks=[])
        axis.invert_yaxis()
        axis.set_frame_on(False)
    figure.savefig(path, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
