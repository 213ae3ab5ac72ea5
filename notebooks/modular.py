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
# # Modular radiance transfer: light in a maze that was never traced
#
# Indirect light within a cube is nearly the same few functions whatever the light, so they are computed once for a handful of
# cubes with missing sides, together with what passes through a missing side. Any level that is made of such cubes can then be
# lit at once. This notebook looks at the functions and at the pieces of a level. Sizes are small, so that everything runs in a
# quarter of a minute; `experiments/modular.py` has the sizes of the source paper.

# %%
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import prt_bench as prt
from data_gen.direct import direct_irradiance
from data_gen.levels import EDGE, block_samples, scene_of
from data_gen.tracer import Tracer
from prt_bench.lights import emitters
from prt_bench.modular.cube import FACES, one_bounce
from prt_bench.modular.dictionary import KINDS, build
from prt_bench.modular.level import maze, transfer
from prt_bench.modular.lightfield import Grid
from prt_bench.modular.modes import direct_light, enriched, needed, reduced

SIDE = 8  # samples along an edge of a face
FLOOR = 3

# %% [markdown]
# ## Few functions are enough
#
# The one-bounce operator *F* of a cube has many singular values worth keeping. Light that comes from lamps has fewer (*L*), and
# what *F* makes of such light is a handful of functions (*M = F P S*, with *P* and *S* from the singular vectors and values
# of *L*): a bounce blurs.

# %%
operator, lamps = one_bounce(SIDE), direct_light(SIDE, (), 48)
prior, weights = enriched([lamps], 48)
spectra = {
    "F, one bounce": np.linalg.svd(operator, compute_uv=False),
    "L, light of lamps": np.linalg.svd(lamps, compute_uv=False),
    "M, one bounce of that light": np.linalg.svd(operator @ (prior * weights), compute_uv=False),
}
figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
for name, values in spectra.items():
    axis.semilogy(values[:48] / values[0], label=f"{name}: {needed(values, 0.95)} hold 95 % of the energy")
axis.set(xlabel="singular value", ylabel="relative to the first", ylim=(1e-4, 1.5))
axis.legend()
plt.show()
assert needed(spectra["M, one bounce of that light"], 0.95) < 10 < needed(spectra["F, one bounce"], 0.95)

# %% [markdown]
# ## The functions of a corridor
#
# A cube with two opposite sides missing, from the strongest function on. Each row of pictures is one function on the faces
# +x, −x, ceiling, floor, +z and −z; red is above zero, blue below. The missing sides are white.

# %%
corridor = reduced(SIDE, KINDS[2], functions=12, prior=48, lights=48)
figure, axes = plt.subplots(4, FACES, figsize=(8, 5), layout="constrained")
for row, function in zip(axes, corridor.basis.T, strict=False):
    top = np.abs(function).max()
    for face, axis in enumerate(row):
        shown = function.reshape(FACES, SIDE, SIDE)[face].T
        axis.imshow(np.where(np.abs(shown) < 1e-9, np.nan, shown), cmap="RdBu_r", vmin=-top, vmax=top, origin="lower")
        axis.set_axis_off()
plt.show()

# %% [markdown]
# ## The dictionary
#
# Six cubes, up to rotation; nine with `dimension=3`, for levels of several layers. Beside functions and the matrices that read
# them from radiosity, it has the lightfields that leave a missing side, how these pass straight on, left and right through a
# block, and the light they leave on its faces. None of these steps makes light stronger.

# %%
dictionary = build(SIDE, functions=24, prior=48, lights=48, grid=Grid(6, 10), lightfields=48, arriving=20)
print(f"{len(dictionary.basis)} blocks, {dictionary.bytes / 1e6:.1f} MB")
strongest = [float(np.linalg.norm(np.asarray(way), 2)) for way in dictionary.onwards]
print("largest singular value straight on, left, right:", *(f"{value:.3f}" for value in strongest))
assert max(strongest) <= 1 + 1e-5

# %% [markdown]
# ## A maze
#
# Nine rooms and one lamp. Direct light is traced at the samples of all blocks. Everything else is matrices: *b*, the
# coefficients of each block, *r*, what enters through each opening, and the light that these stand for.

# %%
level = maze(9, seed=3)
scene, samples = scene_of(level), block_samples(level, SIDE)
lighting = prt.Lighting([prt.PointLight(EDGE * np.add(level.cells[0], (0.0, 0.1, 0.0)), (9.0, 8.5, 7.5))])
direct = direct_irradiance(Tracer(scene), samples, emitters([lighting]))[0].reshape(len(level.cells), -1, 3)
model = transfer(level, dictionary)
b = model.coefficients(jnp.asarray(0.7 * direct))
r = model.arriving(b)
print(f"b {b.shape}: blocks, functions, channels; r {r.shape}: openings, functions, channels")
once, all_bounces = (np.asarray(model(jnp.asarray(direct), 0.7, bounces)) for bounces in (1, 12))

# %%
cells = np.array(level.cells)[:, [0, 2]]  # columns and rows
low, high = cells.min(axis=0), cells.max(axis=0)


def floor(light):
    """The floor from above, x to the right and z down; white where no room is."""
    across, down = (high - low + 1) * SIDE
    shown = np.full((down, across, 3), 1.0)
    for block, (x, z) in enumerate((cells - low) * SIDE):
        tile = light[block].reshape(FACES, SIDE, SIDE, 3)[FLOOR]  # rows along x, columns along z
        shown[z : z + SIDE, x : x + SIDE] = np.swapaxes(tile, 0, 1)
    return shown


pictures = {"direct": direct, "one bounce": once, "twelve bounces": all_bounces}
figure, axes = plt.subplots(1, 3, figsize=(9, 3.5), layout="constrained")
top = np.quantile(all_bounces, 0.99)
for axis, (title, light) in zip(axes, pictures.items(), strict=True):
    axis.imshow(np.clip(floor(light / top), 0, 1) ** (1 / 2.2), interpolation="nearest")
    axis.set(title=title, xticks=[], yticks=[])
plt.show()

# %% [markdown]
# Light goes round corners and fades: a room that sees nothing of the lamp has light from its neighbours, and more with each
# bounce. No light is made on the way: with albedo *ρ* all bounces together hold less than *ρ / (1 − ρ)* times the direct light.

# %%
unlit = direct.sum(axis=(1, 2)) == 0
print(f"{unlit.sum()} of {len(unlit)} rooms see nothing of the lamp")
assert np.all(all_bounces[unlit].sum(axis=(1, 2)) > once[unlit].sum(axis=(1, 2)))
assert 0 < all_bounces.sum() < 0.7 / (1 - 0.7) * direct.sum()
