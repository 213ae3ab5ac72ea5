# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Clustered PCA: lamps that move through an apartment
#
# Six rooms joined by doors. Light from a lamp is stored neither in a lightmap nor in shadow maps: particles find samples of the
# surfaces, samples are grouped into clusters, and each cluster keeps a few functions, some for what its samples see and some
# for the light they pass on. This notebook looks at the pieces one by one and ends with a frame of splats. Sizes are small, so
# that everything runs in a quarter of a minute; `experiments/clustered_pca.py` has the sizes of the source paper.

# %%
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import prt_bench as prt
from data_gen.direct import direct_irradiance, visibility
from data_gen.meshless import hemispheres, hidden_by_walls, nearest_hits, walls_around
from data_gen.particles import particle_samples
from data_gen.scenarios import sample_lightings
from data_gen.tracer import Tracer
from prt_bench.clusters import clusters_in_sight
from prt_bench.depth import ClusteredVisibility, hemisphere_directions, shadow_error
from prt_bench.images import exposure_for, tone_map
from prt_bench.lights import emitters
from prt_bench.runtime import Runtime
from prt_bench.sampled import ClusteredTransfer, SampledLight, reaches
from prt_bench.transport import GatherOperator, indirect

# %% [markdown]
# ## Samples and clusters
#
# Particles leave the first room and bounce about. What they hit after the fifth bounce is thinned, so that no two samples are
# closer than a radius. Clusters are near in place and in normal, and mostly see their middle; the picture shows the apartment
# from above.

# %%
scene = prt.load_scene("apartment")
tracer = Tracer(scene)
points = particle_samples(scene, tracer, np.array([-3.0, 1.5, 2.3]), radius=0.3)
side = float(np.sqrt(scene.mesh.areas.sum() / 48))
clusters, owner = clusters_in_sight(points, 48, bend=side, hidden=hidden_by_walls(tracer, points, 0.1 * side))
print(f"{len(points)} samples, {len(clusters)} clusters of {np.bincount(owner).min()} to {np.bincount(owner).max()}")

from_above = points.normal[:, 1] > 0.5


def plan(axes, values, title, **more):
    """Values at the samples of floors and the tops of furniture."""
    x, z = points.position[from_above][:, [0, 2]].T
    axes.scatter(x, z, c=values[from_above], s=90, marker="s", lw=0, **more)
    axes.set(title=title, aspect="equal", xticks=[], yticks=[], facecolor="0.6")
    axes.invert_yaxis()


figure, axes = plt.subplots(figsize=(5, 3.8), layout="constrained")
plan(axes, np.random.default_rng(0).permutation(len(clusters))[owner], "clusters", cmap="turbo")
plt.show()

# %% [markdown]
# ## What samples see
#
# Each sample casts rays over its hemisphere. What is kept of a distance r is 1 / (r + 0.25 m), which is 0 where nothing is met.
# Within a cluster these hemispheres are much alike: their mean and a few principal components tell them apart.

# %%
directions = hemisphere_directions(252)
depth = hemispheres(tracer, points, directions)
seen = ClusteredVisibility.fit(depth, directions, owner, size=24, near=0.25)

sample = int(np.flatnonzero(from_above)[40])
of = owner[sample]
stored = 1.0 / (depth[sample] + seen.near)
disk = directions[:, :2] / np.sqrt(1.0 + directions[:, 2:])  # keeps areas
figure, grid = plt.subplots(2, 4, figsize=(10, 5.2), layout="constrained")
few = [seen.truncated(size).stored(np.array([sample]), np.arange(252)[None])[0] for size in (2, 8, 24)]
named = zip(["as traced", "2 components", "8 components", "24 components"], [stored, *few], strict=True)
for axes, (title, values) in zip(grid[0], named, strict=True):
    axes.scatter(*disk.T, c=values, s=36, vmin=stored.min(), vmax=stored.max(), cmap="magma", lw=0)
    axes.set_title(title)
for axes, number in zip(grid[1], range(4), strict=True):
    function = seen.mean[of] if number == 0 else seen.basis[of, :, number - 1]
    axes.scatter(*disk.T, c=function, s=36, cmap="magma" if number == 0 else "RdBu", lw=0)
    axes.set_title("mean of its cluster" if number == 0 else f"component {number}")
for axes in grid.ravel():
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.set_frame_on(False)
plt.show()

# %% [markdown]
# ## Shadows of a lamp
#
# A lamp is compared with the depth along the four directions nearest to its own. More components sharpen the edges.

# %%
lamps = sample_lightings(scene, "point", 8, 1, tracer, achromatic=True)
places = np.array([np.asarray(lamp.lights[0].emitters().position)[0, :3] for lamp in lamps])
unshadowed = direct_irradiance(tracer, points, emitters(lamps), shadow_rays=False)[..., 0]
cast = visibility(tracer, points, emitters(lamps))[..., 0]
errors = []
for size in (2, 8, 24):
    errors.append(shadow_error(seen.truncated(size).lit(points, places), cast, unshadowed))
    print(f"{size:2} components: error of shadowed light {errors[-1]:.3f}")
assert errors[0] > errors[1] > errors[2]

top = np.quantile(unshadowed[0], 0.99)
figure, pair = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for axes, title, share in (
    (pair[0], "shadows by rays", cast[0]),
    (pair[1], "by 24 components", seen.lit(points, places[:1])[0]),
):
    plan(axes, np.sqrt(np.clip(unshadowed[0] * share / top, 0, 1)), title, cmap="gray", vmin=0, vmax=1)
plt.show()

# %% [markdown]
# ## Light between clusters
#
# Direct light of two hundred lamps gives each cluster its leading functions. Each of them lights the whole apartment once,
# through all bounces, its negative parts included; what that causes gives each cluster functions to receive with. What joins
# them is a small matrix between all pairs of clusters.

# %%
hits = nearest_hits(tracer, points, scene.mesh.normals, rays=32)
gather = GatherOperator.from_hits(hits, len(points))
albedo = jnp.asarray(points.albedo, jnp.float32)


def bounced(direct):
    """Indirect light of twelve bounces from columns of grey direct light."""
    light = jnp.broadcast_to(jnp.asarray(direct.T, jnp.float32)[:, :, None], (direct.shape[1], len(points), 3))
    return np.moveaxis(np.asarray(indirect(gather, albedo, light, 12)), 0, 2)


training = sample_lightings(scene, "point", 200, 0, tracer, achromatic=True)
light = direct_irradiance(tracer, points, emitters(training))[..., 0].T
transfer = ClusteredTransfer.fit(light / np.linalg.norm(light, axis=0), owner, bounced, sources=8, receivers=8)

lit = (unshadowed * cast).T
reference = bounced(lit)
found = np.stack([transfer.indirect(np.repeat(column[:, None], 3, axis=1)) for column in lit.T], axis=2)
error = np.linalg.norm(found - reference) / np.linalg.norm(reference)
print(
    f"{transfer.blocks[0].shape} matrix for each channel; error of indirect light of lamps that were held out: {error:.3f}"
)
assert error < 0.3

figure, pair = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
top = np.quantile(reference[:, :, 0], 0.99)
for axes, title, values in ((pair[0], "all samples", reference), (pair[1], "8 functions per cluster", found)):
    plan(axes, np.clip(values[:, :, 0] / top, 0, 1) ** 0.5, title)
plt.show()

# %% [markdown]
# ## In shaders, as splats
#
# The runtime holds all of this in 16 bits and finds the same light as NumPy does. To get from samples to pixels, each sample
# spreads its light over a disk in its surface, an ellipse on the screen, but not through walls. Shadows are spread so too, and
# multiply direct light that is evaluated per pixel.

# %%
model = SampledLight(points, seen, transfer, reaches(points), walls_around(tracer, points, scene.mesh.normals))
ds = prt.bake(scene, "point", lightings=2, texels=64, rays=4, measurements=16)  # what frames are drawn with
runtime = Runtime(ds, size=(400, 300))
splats = runtime.splats(model)
room = np.array([-3.6, 2.0, 2.4])
around = [room + 0.1 * np.array([i, 0, j]) for i in range(-2, 3) for j in range(-2, 3)]
lights = {
    "one point": prt.Lighting([prt.PointLight(room, (12.0, 12.0, 12.0))]),
    "25 points": prt.Lighting([prt.PointLight(place, (0.48, 0.48, 0.48)) for place in around]),
}
figure, pair = plt.subplots(1, 2, figsize=(10, 3.9), layout="constrained")
for axes, (title, lighting) in zip(pair, lights.items(), strict=True):
    frame = runtime.frame(lighting, splats)
    axes.imshow(tone_map(frame, exposure_for(frame, 0.95)))
    axes.set(title=title, xticks=[], yticks=[])
plt.show()

direct, _, passed_on = splats.samples.read()
same = model.quantised()
wanted = same.direct(lights["25 points"])
off = np.abs(direct - wanted).max() / wanted.max()
off = max(off, np.abs(passed_on - same.indirect(wanted)).max() / np.abs(same.indirect(wanted)).max())
print(f"shaders against NumPy: {off:.1e}; {splats.bytes / 1e6:.1f} MB on the GPU")
assert off < 1e-3
