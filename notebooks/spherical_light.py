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
# # Light as spherical harmonics
#
# Classical precomputed radiance transfer (Sloan, Kautz and Snyder 2002) projects distant light onto K = order² spherical
# harmonics and keeps at every point how much of each arrives there, shadows and bounces included. This notebook turns an
# environment around a room, and looks at what the number of bands, the place of storage and a window change. Sizes are
# small, so that everything runs in a minute or two on two cores.

# %%
import matplotlib.pyplot as plt
import numpy as np

import prt_bench as prt

# %% [markdown]
# ## Bake
#
# The rays of a bake know along which directions nothing was hit. That is all that distant light needs. With `vertices`
# rays start at the mesh's vertices too. The scene is an open room with a table in it.

# %%
scene = prt.load_scene("room")
ds = prt.bake(scene, scenario="environment", lightings=2, texels=96, rays=128, measurements=16, vertices=True)
print(f"{len(scene.mesh.faces)} triangles, {len(ds.points)} texels")


# %% [markdown]
# ## An environment that turns
#
# A dim sky with a small sun, turned about the vertical. Nothing has to be fitted again for a light that
# moves: its coefficients change, the transfer stays.

# %%
height, width = 32, 64
elevation = (0.5 - (np.arange(height) + 0.5) / height) * np.pi
sky = np.broadcast_to(np.where(elevation > 0, 0.05, 0.02)[:, None, None], (height, width, 3)) * np.array(
    [0.7, 0.85, 1.0]
)
sky[8:10, 40:42] = (90.0, 80.0, 60.0)

angles = np.radians([0, 90, 180, 270])
lit = prt.light(ds, [prt.Lighting([prt.EnvironmentLight(sky, rotation=(0.0, angle, 0.0))]) for angle in angles])
reference = lit.direct + lit.indirect  # [N, T, C] irradiance, W/m²


def relative_error(prediction):
    """‖error‖ / ‖reference‖ of each lighting."""
    prediction = np.asarray(prediction)
    return np.linalg.norm(prediction - reference, axis=(1, 2)) / np.linalg.norm(reference, axis=(1, 2))


# %% [markdown]
# ## Orders, in a texture and at the vertices
#
# `sh-texture` stores its vectors in the texels of the lightmap, `sh-vertex` at the vertices, between which light is
# interpolated. This room has a floor of two triangles: at its vertices there is no table's shadow, whatever the order.

# %%
orders = (1, 2, 3, 5, 8)
errors, models = {}, {}
for name in ("sh-texture", "sh-vertex"):
    for order in orders:
        models[name, order] = prt.method(name, order=order).fit(ds)
        errors[name, order] = relative_error(models[name, order].predict(lit))
    print(f"{name:10}", *(f"order {order}: {errors[name, order].mean():.3f} " for order in orders))

assert all(errors["sh-texture", 8] < errors["sh-texture", 2])
assert all(errors["sh-texture", 8] < errors["sh-vertex", 8])

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
for name in ("sh-texture", "sh-vertex"):
    axes.plot(orders, [errors[name, order].mean() for order in orders], ".-", label=name)
axes.set(xlabel="order", ylabel="relative error of all light", ylim=(0, None), xticks=orders)
axes.grid(alpha=0.3)
axes.legend()
plt.show()


# %% [markdown]
# Seen as lightmaps, a row for each angle of the environment. The shadow turns with it and stays soft: five bands cannot
# hold a shadow's edge.


# %%
def shown(irradiance, white):
    """Linear irradiance as a picture."""
    return np.clip(ds.lightmap.image(irradiance) / white, 0, 1) ** (1 / 2.2)


columns = {"reference": reference}
columns |= {
    f"{name}, order {order}": np.asarray(models[name, order].predict(lit))
    for name, order in (("sh-texture", 2), ("sh-texture", 5), ("sh-texture", 8), ("sh-vertex", 5))
}
white = np.percentile(reference, 97)
figure, grid = plt.subplots(
    len(angles), len(columns), figsize=(2.4 * len(columns), 2.5 * len(angles)), layout="constrained"
)
for row, angle in enumerate(angles):
    for axes, (title, light) in zip(grid[row], columns.items(), strict=True):
        axes.imshow(shown(light[row], white), origin="lower")
        axes.set(xticks=[], yticks=[], title=title if row == 0 else "")
    grid[row, 0].set_ylabel(f"{np.degrees(angle):.0f}°")
plt.show()

# %% [markdown]
# ## Windows
#
# A sun that is cut off after a few bands rings: there is light below zero on surfaces that face away from it. A window
# fades the higher bands. It takes the ringing away, and with it some of what the bands held.

# %%
windows = {}
for window in ("none", "lanczos", "hann", "positive"):
    prediction = np.asarray(prt.method("sh-texture", order=5, window=window).fit(ds).predict(lit))
    below = np.where(prediction < 0, -prediction, 0).sum() / reference.sum()
    windows[window] = (relative_error(prediction).mean(), below, prediction)
    print(f"{window:9} relative error {windows[window][0]:.3f}, light below zero {below:.3%} of all light")

assert windows["positive"][1] < windows["none"][1]

# %%
figure, panels = plt.subplots(1, len(windows), figsize=(2.6 * len(windows), 2.9), layout="constrained")
for axes, (window, (_, _, prediction)) in zip(panels, windows.items(), strict=True):
    below = np.minimum(prediction[0], 0.0).sum(axis=1, keepdims=True)
    image = axes.imshow(ds.lightmap.image(below)[..., 0], origin="lower", cmap="magma", vmax=0, vmin=-0.2 * white)
    axes.set(xticks=[], yticks=[], title=window)
figure.colorbar(image, ax=panels, label="light below zero, W/m²")
plt.show()

# %% [markdown]
# ## The light's coefficients
#
# A rotation moves energy within each band, never between bands: what `measure` sees of the turned environments has
# the same energy in every band.

# %%
coefficients = np.asarray(models["sh-texture", 8].measure(lit))  # [N, K, C]
band = np.repeat(np.arange(8), 2 * np.arange(8) + 1)
energy = np.array([[np.sum(one[band == level] ** 2) for level in range(8)] for one in coefficients])
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.semilogy(energy.T, ".-", label=[f"{np.degrees(angle):.0f}°" for angle in angles])
axes.set(xlabel="band", ylabel="energy")
axes.legend()
plt.show()
np.testing.assert_allclose(energy, np.broadcast_to(energy[0], energy.shape), rtol=1e-6)
