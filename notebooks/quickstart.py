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
# # Quickstart
#
# Bake a Cornell box, fit two transfer models, look at what they get wrong, and take a gradient through the light
# transport. Sizes are small, so that everything runs in under a minute on two cores.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import prt_bench as prt
from prt_bench.lights import emitters, irradiance
from prt_bench.transport import indirect

# %% [markdown]
# ## Bake
#
# The planner says what the scene calls for and why. The bake traces rays once and keeps which lightmap texels they hit;
# that table then answers for every lighting. Held-out lightings come with it as the split `test`.

# %%
scene = prt.load_scene("cornell")
size = {"lightings": 64, "texels": 48, "rays": 64, "measurements": 128}
print(prt.plan(scene, scenario="point", **size).table())

# %%
ds = prt.bake(scene, scenario="point", **size)
train, test = ds.split("train"), ds.split("test")
print(f"measured [N, M, C] = {train.measured.shape}, indirect [N, T, C] = {train.indirect.shape}")

# %% [markdown]
# ## Fit and evaluate
#
# Both methods see direct light at the measurement points alone, and predict indirect light at every texel. The noise
# floor is the Monte Carlo error of the reference itself: differences under it mean nothing.

# %%
models, records = {}, {}
for name in ("svd-ridge", "operator-ridge"):
    models[name] = prt.method(name, basis=16).fit(train)
    records[name] = prt.evaluate(models[name], test)
    errors = records[name].errors
    print(
        f"{name:15} relative RMSE {errors.relative_rmse:.3f}"
        f" = projection {errors.projection:.3f} ⊕ coefficients {errors.coefficient:.3f}"
    )
print(f"{'noise floor':15} {test.noise_floor:.3f}")


# %%
def shown(irradiance, white):
    """Linear irradiance as a picture."""
    return np.clip(irradiance / white, 0, 1) ** (1 / 2.2)


chosen = np.argsort(np.linalg.norm(test.indirect, axis=(1, 2)))[len(test) // 2]  # of median brightness
reference = test.indirect[chosen]
white = np.percentile(reference, 99)

figure = plt.figure(figsize=(11, 6.5), layout="constrained")
x, y, z = ds.measurement_points.position.T
measured = test.measured[chosen]
panel = figure.add_subplot(2, 3, 1, projection="3d")
panel.scatter(x, -z, y, c=shown(measured, np.percentile(measured, 95)), edgecolors="0.6", linewidths=0.3)
panel.set(title="direct light, measured", box_aspect=(1, 1, 1), xticks=[], yticks=[], zticks=[])

panel = figure.add_subplot(2, 3, 4)
panel.imshow(shown(ds.lightmap.image(reference), white), origin="lower")
panel.set(title="indirect light, reference", xticks=[], yticks=[])

for row, (name, model) in enumerate(models.items()):
    prediction = np.asarray(model.predict(test))[chosen]
    panel = figure.add_subplot(2, 3, 3 * row + 2)
    panel.imshow(shown(ds.lightmap.image(prediction), white), origin="lower")
    panel.set(title=name, xticks=[], yticks=[])

    error = np.linalg.norm(prediction - reference, axis=1, keepdims=True) / np.linalg.norm(reference, axis=1).mean()
    panel = figure.add_subplot(2, 3, 3 * row + 3)
    scale = panel.imshow(ds.lightmap.image(error), origin="lower", cmap="magma", vmin=0, vmax=0.5)
    panel.set(title="error / mean of the reference", xticks=[], yticks=[])
    figure.colorbar(scale, ax=panel)
plt.show()

# %% [markdown]
# The singular values of the indirect light tell how many basis functions are worth having.

# %%
values = np.array(records["svd-ridge"].curves["singular_values"])
values = values[values > 1e-10 * values[0]]
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.semilogy(np.arange(1, len(values) + 1), values / values[0], ".-")
axes.set(xlabel="index", ylabel="σ / σ₁", title="singular values of the centred indirect light")
axes.grid(alpha=0.3)
plt.show()

# %% [markdown]
# ## New light on the traced scene
#
# Lights of any kind can be put into the baked scene; only shadow rays are traced.

# %%
lamp = prt.PointLight(position=(0.3, 1.6, 0.2), intensity=(4.0, 3.6, 3.0))
relit = prt.light(ds, [prt.Lighting([lamp])])
print(f"direct {relit.direct.mean():.3f}, indirect {relit.indirect.mean():.3f} W/m² on average")

# %% [markdown]
# ## A gradient
#
# $E_\mathrm{ind} = (I - G\rho)^{-1} G\rho E$ is differentiable in the albedo $\rho$ and in every parameter of the
# lights (visibility is held fixed). Here: how the indirect light of the whole box changes with the lamp's position, its
# intensity, and the colour of the surfaces; each derivative, along a random direction, is checked against a central
# difference.

# %%
samples = ds.transport.samples
gather = ds.transport.sample_gather(differentiable=True)
visible = jnp.asarray(relit.direct[0] > 0).any(axis=1, keepdims=True)


def mean_indirect(position, intensity, tint):
    """Mean indirect irradiance [W/m²] of the box under one point light."""
    lights = emitters([prt.Lighting([prt.PointLight(position, intensity)])])
    one = jax.tree.map(lambda batch: batch[0], lights)
    direct = irradiance(one, samples.position, samples.normal, visible)
    return jnp.mean(indirect(gather, samples.albedo * tint, direct[None], ds.transport.bounces))


at = (jnp.array([0.3, 1.6, 0.2]), jnp.array([4.0, 3.6, 3.0]), jnp.ones(3))
gradient = jax.grad(mean_indirect, argnums=(0, 1, 2))(*at)
for index, name in enumerate(("position", "intensity", "tint of all surfaces")):
    direction = jax.random.normal(jax.random.key(index), (3,))
    step = 1e-5
    ahead, behind = ([*at[:index], at[index] + sign * step * direction, *at[index + 1 :]] for sign in (1, -1))
    difference = (mean_indirect(*ahead) - mean_indirect(*behind)) / (2 * step)
    derivative = gradient[index] @ direction
    print(f"d/d {name:21} {np.round(gradient[index], 4)}")
    print(f"    along a direction {derivative:+.7f}, by differences {difference:+.7f}")
    np.testing.assert_allclose(derivative, difference, rtol=1e-5)
