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
# # Gradients, and models that learn
#
# Every stage of the framework is a function that JAX can differentiate: lights → measured light → coefficients → indirect
# light, albedo → all bounces, light → fit → error. This notebook trains a small network beside its closed form, and uses
# three of these derivatives: to find a light from the indirect light it causes, to find the colour of walls, and to see
# where a ridge should go. Sizes are small, so that everything runs in two minutes on two cores; the experiments
# `inverse_light.py`, `inverse_albedo.py`, `measurement_points.py` and `learned_frontier.py` go further.

# %%
import time

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax

import prt_bench as prt
from prt_bench.chain import direct_light, indirect_light, measured_light

scene = prt.load_scene("cornell")
ds = prt.bake(scene, "point", lightings=96, texels=48, rays=64, measurements=128, streamed=256)
train, test = ds.split("train"), ds.split("test")


def relative_error(prediction, truth):
    """‖prediction − truth‖ / ‖truth‖ over everything."""
    return float(np.linalg.norm(np.asarray(prediction) - truth) / np.linalg.norm(truth))


# %% [markdown]
# ## A network beside its closed form
#
# `mlp-coefficients` starts as the linear map of `reduced-rank` and learns what it leaves: with a head of zeros it *is* the
# linear map. Lightings that are held out of its training say when to stop. At this size it gains nothing over the linear
# map; `learned_frontier.py` asks where a network does.

# %%
models, seconds = {}, {}
for name in ("reduced-rank", "mlp-coefficients"):
    started = time.perf_counter()
    models[name] = prt.method(name, basis=16).fit(train, jax.random.key(0))
    seconds[name] = time.perf_counter() - started
    print(
        f"{name:17} error {relative_error(models[name].predict(test), test.indirect):.3f}, fitted in {seconds[name]:.1f} s"
    )

history = models["mlp-coefficients"].history
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
for name in ("training_loss", "validation_error"):
    axes.plot(history["training_steps"], history[name], label=name.replace("_", " "))
axes.set(xlabel="step", yscale="log")
axes.grid(alpha=0.3)
axes.legend()
plt.show()

# %% [markdown]
# ## Where is the light?
#
# A point light that no model has seen, of which nothing is given but its indirect lightmap. Adam moves a guess, place and
# intensity, down the gradient of the relative error. What a ray decides has no gradient: which points see the light is
# traced anew every few steps and held fixed in between.

# %%
model = models["reduced-rank"]
hidden = test.lightings[4]
target = jnp.asarray(test.indirect[4:5])
extent = scene.extent


def lighting(guess):
    """A point light from numbers of about one size: place over the scene's extent, logarithm of the intensity."""
    return prt.Lighting([prt.PointLight(guess["place"] * extent, jnp.exp(guess["brightness"]))])


def miss(guess, seen):
    """Relative squared error of the indirect light that the model predicts for a guess."""
    prediction = model.reconstruct(model.transfer(measured_light(ds, [lighting(guess)], seen)))
    return jnp.sum((prediction - target) ** 2) / jnp.sum(target**2)


def seen_by(guess):
    """Which measurement points the light of a guess reaches."""
    return jnp.asarray(prt.seen(scene, ds.dense_points, [lighting(guess)]))


# %% [markdown]
# One derivative against a finite difference, before it is trusted:

# %%
guess = {"place": jnp.array([0.05, 0.3, 0.02]), "brightness": jnp.zeros(3)}
seen = seen_by(guess)
gradient = jax.jit(jax.grad(miss))(guess, seen)["place"]
step = 1e-5
for axis in range(3):
    moved = [{**guess, "place": guess["place"].at[axis].add(sign * step)} for sign in (1, -1)]
    difference = (miss(moved[0], seen) - miss(moved[1], seen)) / (2 * step)
    print(f"{'xyz'[axis]}: gradient {gradient[axis]:+.6f}, finite difference {difference:+.6f}")
    np.testing.assert_allclose(gradient[axis], difference, rtol=1e-4)

# %%
margin = 0.25 * np.ptp(scene.bounds, axis=0).max()  # lights may stand before the open side of the box
low, high = (scene.bounds + np.array([[-margin], [margin]])) / extent
starts = np.random.default_rng(0).uniform(low, high, (6, 3)) * 0.8 + 0.1 * (low + high)
rule = optax.adam(optax.cosine_decay_schedule(0.03, 90, 0.02))


@jax.jit
def advanced(guess, state, seen):
    """The next guess, and how far off this one is."""
    error, gradient = jax.value_and_grad(miss)(guess, seen)
    updates, state = rule.update(gradient, state, guess)
    moved = optax.apply_updates(guess, updates)
    return {**moved, "place": jnp.clip(moved["place"], low, high)}, state, error


paths, errors = [], []
for start in starts:
    guess = {"place": jnp.asarray(start), "brightness": jnp.zeros(3)}
    state, path = rule.init(guess), []
    for step in range(90):
        if step % 5 == 0:
            seen = seen_by(guess)
        path.append(np.asarray(guess["place"]) * extent)
        guess, state, error = advanced(guess, state, seen)
    paths.append(np.array(path))
    errors.append(float(error))

true_place = np.asarray(hidden.lights[0].position)
best = int(np.argmin(errors))
away = np.linalg.norm(paths[best][-1] - true_place) / extent
print(f"best of {len(starts)} starts: {away:.1%} of the scene's extent from the light, error {errors[best] ** 0.5:.3f}")
assert away < 0.1

# %%
figure, views = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
for axes, (across, up) in zip(views, ((0, 2), (0, 1)), strict=True):
    for path, error in zip(paths, errors, strict=True):
        axes.plot(path[:, across], path[:, up], lw=1, color="tab:blue" if error == errors[best] else "0.7")
        axes.plot(path[0, across], path[0, up], "o", ms=3, color="0.5")
    axes.plot(true_place[across], true_place[up], "*", ms=12, color="tab:orange", label="the light")
    axes.set(xlabel=f"{'xyz'[across]}, m", ylabel=f"{'xyz'[up]}, m", aspect="equal")
    axes.set(xlim=extent * np.array([low, high])[:, across], ylim=extent * np.array([low, high])[:, up])
    axes.add_patch(
        plt.Rectangle(scene.bounds[0][[across, up]], *np.ptp(scene.bounds, axis=0)[[across, up]], fill=False)
    )
views[0].legend()
plt.show()

# %% [markdown]
# ## What colour are the walls?
#
# The traced operator takes any albedo. Given the indirect light of two known lamps, the colour of each material is
# found by descent through all bounces, from the same grey for all.

# %%
lamps = test.lightings[:2]
samples, transport = ds.transport.samples, ds.transport
owner = scene.mesh.material[samples.face]
direct = direct_light(samples, lamps, prt.seen(scene, samples, lamps))
observed = indirect_light(transport, direct, jnp.asarray(samples.albedo))
weight = jnp.where(jnp.asarray(transport.buried), 0.0, 1.0)[None, :, None]


def mismatch(colours):
    """Relative squared error of the indirect light when materials have these colours."""
    found = indirect_light(transport, direct, jax.nn.sigmoid(colours)[owner])
    return jnp.sum(weight * (found - observed) ** 2) / jnp.sum(weight * observed**2)


colours = jnp.zeros((len(scene.materials), 3))
rule = optax.adam(0.15)
state = rule.init(colours)
descent = jax.jit(jax.value_and_grad(mismatch))
curve = []
for _ in range(60):
    error, gradient = descent(colours)
    updates, state = rule.update(gradient, state)
    colours = optax.apply_updates(colours, updates)
    curve.append(float(error))
found = np.asarray(jax.nn.sigmoid(colours))
for material, colour in zip(scene.materials, found, strict=True):
    print(f"{material.name:8} is {np.round(material.albedo, 3)}, found {np.round(colour, 3)}")
wrong = np.abs(found - np.array([material.albedo for material in scene.materials])).max()
assert wrong < 0.05

# %% [markdown]
# What is observed here comes from the operator itself, so nothing but the descent is tried;
# `experiments/inverse_albedo.py` observes what an independent path tracer renders.

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.semilogy(curve)
axes.set(xlabel="step", ylabel="relative squared error")
axes.grid(alpha=0.3)
plt.show()

# %% [markdown]
# ## Where should the ridge go?
#
# A fit is a function of its data and settings, so the error on other lightings has a derivative in the ridge. The
# tangents are those derivatives.


# %%
def held_out(log_ridge):
    """Relative error on the test lightings of a fit with this ridge."""
    fitted = prt.method("svd-ridge", basis=24).with_traced(ridge=10.0**log_ridge).fit(train)
    off = fitted.predict(test) - test.indirect
    return jnp.linalg.norm(off) / jnp.linalg.norm(test.indirect)


value_and_slope = jax.jit(jax.value_and_grad(held_out))
places = np.linspace(-5, 0, 6)
values, slopes = np.array([value_and_slope(place) for place in places]).T
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.plot(places, values, "o")
for place, value, slope in zip(places, values, slopes, strict=True):
    axes.plot([place - 0.4, place + 0.4], [value - 0.4 * slope, value + 0.4 * slope], color="tab:orange")
axes.set(xlabel="log₁₀ of the ridge", ylabel="held-out error")
axes.grid(alpha=0.3)
plt.show()
