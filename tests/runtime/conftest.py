"""Datasets for the runtime's tests, made by hand: no ray is traced, every quad of a scene has its own square chart."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.scenes import load_scene
from prt_bench.assets import write_asset
from prt_bench.dataset import LightingDataset, Transport
from prt_bench.errors import RuntimeUnavailable
from prt_bench.gamma import GammaModel, in_gamma_space
from prt_bench.models import CoupledModel, LinearModel, NearestModel
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.runtime import Runtime, headless
from prt_bench.scene import Scene

GAP = 2


@pytest.fixture(scope="session", autouse=True)
def gl():
    try:
        return headless()
    except RuntimeUnavailable as error:
        pytest.skip(str(error))


def points_on(scene: Scene, face: np.ndarray, barycentric: np.ndarray) -> SurfacePoints:
    position = np.einsum("pc,pcd->pd", barycentric, scene.mesh.triangles[face])
    return SurfacePoints(position, scene.mesh.normals[face], scene.albedo_at(face, barycentric), face, barycentric)


def quad_dataset(scene: Scene, cell: int = 24, measurements: int = 64, supersamples: int = 8) -> LightingDataset:
    """A dataset without lightings: each quad, faces (0, 1, 2) and (0, 2, 3), has a chart of `cell` texels a side."""
    quads = len(scene.mesh.faces) // 2
    side = int(np.ceil(np.sqrt(quads)))
    resolution = side * (cell + GAP)
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float) * cell
    origin = np.array([[i % side, i // side] for i in range(quads)]) * (cell + GAP)
    square = (origin[:, None] + corner) / resolution
    corner_uv = square[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 2)
    y, x = np.mgrid[:cell, :cell].reshape(2, -1)
    s, t = (x + 0.5) / cell, (y + 0.5) / cell
    upper = t > s
    first = np.stack([1 - s, s - t, t], axis=1)
    second = np.stack([1 - t, s, t - s], axis=1)
    barycentric = np.tile(np.where(upper[:, None], second, first), (quads, 1))
    face = (2 * np.arange(quads)[:, None] + upper).ravel()
    texel = ((origin[:, 1, None] + y) * resolution + origin[:, 0, None] + x).ravel()
    order = np.argsort(texel)
    lightmap = Lightmap(resolution, texel[order], corner_uv, np.repeat(np.arange(quads), 2))
    receivers = points_on(scene, face[order], barycentric[order])
    rng = np.random.default_rng(0)
    count = measurements * supersamples
    dense_face = rng.choice(len(scene.mesh.faces), count, p=scene.mesh.areas / scene.mesh.areas.sum())
    dense = points_on(scene, dense_face, rng.dirichlet((1, 1, 1), count))
    groups = np.arange(count).reshape(measurements, supersamples)
    nothing = np.zeros((len(receivers), 1), np.int32)
    transport = Transport(
        scene, lightmap, receivers, np.zeros(len(receivers), bool), receivers, nothing, nothing, 1, "test"
    )
    return LightingDataset(transport, dense[groups[:, 0]], dense, groups, (), {}, {}, {}, (0, 0))


def linear_model(ds: LightingDataset, basis: int, channels: int = 1, seed: int = 0) -> LinearModel:
    """A random basis and random weights."""
    keys = jax.random.split(jax.random.key(seed), 2)
    shape = (channels, basis, len(ds.groups) + 1)
    return LinearModel(jax.random.normal(keys[0], (len(ds.points), basis)), jax.random.normal(keys[1], shape))


def coupled_model(ds: LightingDataset, basis: int, channels: int = 3, seed: int = 0) -> CoupledModel:
    """A random basis of several channels and random weights."""
    keys = jax.random.split(jax.random.key(seed), 2)
    return CoupledModel(
        jax.random.normal(keys[0], (len(ds.points), channels, basis)),
        jax.random.normal(keys[1], (basis, channels * len(ds.groups) + 1)),
    )


def gamma_model(model: LinearModel | CoupledModel, gamma: float = 2.2) -> GammaModel:
    """The same in gamma space, with weights for predictions of the size of light."""
    damped = eqx.tree_at(lambda model: model.weights, model, 0.05 * model.weights)
    return in_gamma_space(damped, gamma)


def nearest_model(ds: LightingDataset, columns: int, seed: int = 0) -> NearestModel:
    """Random columns for random directions."""
    keys = jax.random.split(jax.random.key(seed), 2)
    directions = jnp.abs(jax.random.normal(keys[1], (columns, len(ds.groups))))
    return NearestModel(
        jax.random.uniform(keys[0], (len(ds.points), columns)),
        directions / jnp.linalg.norm(directions, axis=1, keepdims=True),
    )


@pytest.fixture(scope="session")
def cornell() -> LightingDataset:
    return quad_dataset(load_scene("cornell"))


@pytest.fixture(scope="session")
def runtime(cornell) -> Runtime:
    return Runtime(cornell, size=(160, 120), shadow_resolution=1024)


@pytest.fixture
def export(tmp_path):
    """Write a model as an asset and load it back."""
    return lambda model, dtype="float32": write_asset(model, tmp_path / "asset", dtype)
