"""Implicit scenes on OpenGL against JAX: distances, gradients, hits, networks and lobes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import prt_bench as prt
from prt_bench.assets import write_asset
from prt_bench.errors import AssetError
from prt_bench.glossy import Surface, TripleModel
from prt_bench.implicit.expression import code_of, distances, gradients
from prt_bench.implicit.grid import GridDistance
from prt_bench.implicit.operations import (
    Difference,
    Intersection,
    Moved,
    Scaled,
    SmoothIntersection,
    SmoothUnion,
    Turned,
    Union,
)
from prt_bench.implicit.scene import ImplicitScene, Part
from prt_bench.implicit.shapes import Box, Cylinder, Gyroid, Mandelbulb, Plane, Sphere, Torus
from prt_bench.learned.fields import Field
from prt_bench.learned.networks import Network
from prt_bench.learned.transfer import HarmonicFieldModel, TransferField
from prt_bench.lights import emitters
from prt_bench.runtime import shaders
from prt_bench.runtime.implicit import ImplicitRuntime
from prt_bench.scene import Camera, Glossy, Material

pytestmark = pytest.mark.gl
PARITY = 1e-3
SIZE = (64, 48)
LIGHTING = prt.Lighting(
    [prt.DirectionalLight((-0.6, -1.0, -0.5), (2.0, 1.5, 1.0)), prt.PointLight((2.0, 2.0, 1.0), (3.0, 4.0, 5.0))]
)
TURN = Rotation.from_euler("xyz", (20, 40, 60), degrees=True).as_matrix()


def ball_grid():
    nodes = np.linspace(-1.0, 1.0, 16)
    z, y, x = np.meshgrid(nodes, nodes, nodes, indexing="ij")
    return GridDistance((np.sqrt(x * x + y * y + z * z) - 0.6).ravel(), (-1.0, -1.0, -1.0), 2.0 / 15)


EVERYTHING = [
    Union(Sphere(0.7), Moved(Box((0.3, 0.5, 0.7), 0.1), (0.2, -0.1, 0.3))),
    Intersection(Turned(Torus(0.6, 0.2), TURN), Plane((0.0, 0.6, 0.8), 0.3)),
    Difference(Cylinder(0.4, 0.5), Scaled(Gyroid(0.9, 0.4), 0.5)),
    SmoothUnion(ball_grid(), Moved(ball_grid(), (0.5, 0.0, 0.0)), 0.2),
    SmoothIntersection(Mandelbulb(2), Box((0.9, 0.9, 0.9)), 0.1),
]


@pytest.mark.parametrize("shape", EVERYTHING, ids=lambda shape: type(shape).__name__)
def test_generated_distances_and_gradients_are_those_of_jax(shape, gl):
    places = np.random.default_rng(0).uniform(-1.2, 1.2, (1024, 3)).astype(np.float32)
    found, slope, plain = evaluated(gl, *code_of(shape), places)
    wanted = np.asarray(distances(shape, places.astype(np.float64)))
    np.testing.assert_allclose(found, wanted, atol=3e-6)
    np.testing.assert_allclose(plain, wanted, atol=3e-6)
    gap = np.abs(slope - np.asarray(gradients(shape, places.astype(np.float64)))).max(axis=1)
    assert np.quantile(gap, 0.99) < 1e-4


def evaluated(gl, code, tables, places):
    rows = gl.buffer(np.pad(places, ((0, 0), (0, 1))).astype("<f4").tobytes())
    plain, table = gl.buffer(reserve=4 * len(places)), gl.buffer(tables.astype("<f4").tobytes())
    program = shaders.compute(gl, "distance.comp", {"PLACES": len(places)}, {"distance": code})
    for binding, part in ((6, rows), (7, plain), (14, table)):
        part.bind_to_storage_buffer(binding)
    program.run(-(-len(places) // 64))
    gl.memory_barrier()
    found = np.frombuffer(rows.read(), "<f4").reshape(-1, 4)
    return found[:, 3], found[:, :3], np.frombuffer(plain.read(), "<f4")


def test_a_wrong_constant_in_the_code_is_noticed(gl):
    places = np.random.default_rng(0).uniform(-1.2, 1.2, (64, 3)).astype(np.float32)
    code, tables = code_of(Sphere(0.7))
    found, _, _ = evaluated(gl, code.replace("6.9", "7.1"), tables, places)
    assert np.abs(found - np.asarray(distances(Sphere(0.7), places))).max() > 5e-3


def scene_of(*, glossy=True, colour=(0.6, 0.2, 0.1)):
    lobe = Glossy((0.3, 0.2, 0.1), 12.0) if glossy else None
    figure = SmoothUnion(Sphere(0.5), Moved(Torus(0.5, 0.1), (0.0, 0.2, 0.0)), 0.1)
    return ImplicitScene(
        "figure",
        (
            Part(Moved(Box((1.0, 0.05, 1.0)), (0.0, -0.55, 0.0)), Material("ground", (0.5, 0.5, 0.5))),
            Part(figure, Material("figure", colour, glossy=lobe)),
        ),
        Camera((1.0, 0.8, 2.6), (0.0, -0.1, 0.0), fov_y=45.0),
    )


def field_of(rows, order, width=16, depth=2, encoding="frequency"):
    """A network with random weights about the size of trained ones."""
    keys = jax.random.split(jax.random.key(0), 3)
    box = jnp.array([0.0, -0.1, 0.0, 1.0], jnp.float32)
    field = Field.random(keys[0], encoding, box, width, depth, rows * order**2)
    biases = tuple(0.3 * jax.random.normal(keys[1], bias.shape, jnp.float32) for bias in field.network.biases)
    head = 0.05 * jax.random.normal(keys[2], field.head.shape, jnp.float32)
    return TransferField(Field(Network(field.network.matrices, biases), head, box, field.grids, field.octaves), rows)


def relative(found, wanted):
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def shaded(scene, field, surface, eye, materials=None):
    """The model in JAX at the places that the shader met."""
    met = surface.part >= 0
    position, normal, part = surface.position[met], surface.normal[met], surface.part[met]
    scene = scene if materials is None else replace(scene, parts=materials)
    model = TripleModel(
        field(jnp.asarray(position), jnp.asarray(normal)), jnp.asarray(scene.bounds.mean(axis=0), jnp.float32)
    )
    u = model.observe(jax.tree.map(lambda leaf: jnp.asarray(leaf[0], jnp.float32), emitters([LIGHTING])))
    towards = eye - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    lobes = scene.lobes[part].astype(np.float32)
    what = Surface(normal, scene.albedos[part].astype(np.float32), lobes[:, :3], lobes[:, 3])
    return np.asarray(model.radiance(u, what, jnp.asarray(towards, jnp.float32)))[0]


@pytest.mark.parametrize(
    ("by", "fixed", "rows", "order", "encoding"),
    [("fragment", False, 4, 3, "frequency"), ("compute", True, 4, 3, "grid"), ("compute", False, 2, 3, "none")],
)
def test_frames_are_those_of_the_model(by, fixed, rows, order, encoding):
    scene, field = scene_of(), field_of(rows, order, encoding=encoding)
    runtime = ImplicitRuntime(scene, field, SIZE, by, fixed)
    frame, surface = runtime.frame(LIGHTING), runtime.surface()
    met = surface.part >= 0
    assert {0, 1} <= set(surface.part[met])
    assert 0.2 < met.mean() < 0.95
    assert not frame[~met].any()
    assert relative(frame[met], shaded(scene, field, surface, runtime.eye)) < 0.01 * PARITY
    dull = shaded(scene_of(glossy=False), field, surface, runtime.eye)
    assert relative(dull, frame[met]) > 0.01, "the lobes have a say"


def test_hits_lie_on_the_surface_with_its_normals_and_parts():
    scene = scene_of(glossy=False)
    surface = ImplicitRuntime(scene, field_of(2, 2, width=4, depth=1), SIZE).surface()
    met = surface.part >= 0
    position = surface.position[met].astype(float)
    assert np.abs(np.asarray(distances(scene.shape, position))).max() < 2.5 * scene.tolerance
    assert np.quantile(np.abs(scene.normal_at(position) - surface.normal[met]).max(axis=1), 0.99) < 1e-4
    assert np.array_equal(scene.part_at(position), surface.part[met])


def test_both_ways_show_the_same_wide_network_and_material_and_light_are_editable():
    scene, field = scene_of(), field_of(4, 3, width=72, depth=3)
    frames = {by: ImplicitRuntime(scene, field, SIZE, by) for by in ("fragment", "compute")}
    found = {by: runtime.frame(LIGHTING) for by, runtime in frames.items()}
    assert relative(found["compute"], found["fragment"]) < 0.01 * PARITY
    runtime = frames["compute"]
    painted = Material("figure", (0.1, 0.2, 0.8), glossy=Glossy((0.1, 0.1, 0.1), 40.0))
    runtime.paint(1, painted)
    frame, surface = runtime.frame(LIGHTING), runtime.surface()
    parts = (scene.parts[0], Part(scene.parts[1].shape, painted))
    wanted = shaded(scene, field, surface, runtime.eye, parts)
    assert relative(frame[surface.part >= 0], wanted) < 0.01 * PARITY
    assert relative(frame, found["compute"]) > 0.1
    twice = prt.Lighting([*LIGHTING.lights, *LIGHTING.lights])
    assert relative(runtime.frame(twice), 2.0 * frame) < 1e-5


def test_networks_that_do_not_fit_are_refused():
    scene = scene_of()
    with pytest.raises(AssetError, match="128 at most"):
        ImplicitRuntime(scene, field_of(4, 2, width=160, depth=1), SIZE)
    with pytest.raises(AssetError, match="rows"):
        ImplicitRuntime(scene, field_of(3, 2, width=4, depth=1), SIZE)
    with pytest.raises(AssetError, match="fragment or compute"):
        ImplicitRuntime(scene, field_of(4, 2, width=4, depth=1), SIZE, by="vertex")


@pytest.mark.parametrize(("rows", "dtype"), [(1, "float32"), (3, "float16")])
def test_a_mesh_is_drawn_with_the_same_network(rows, dtype, runtime, cornell, tmp_path):
    points, mesh = cornell.points, cornell.scene.mesh
    model = HarmonicFieldModel(
        field_of(rows, 4), jnp.asarray(cornell.scene.bounds.mean(axis=0)), points.position, mesh.normals[points.face]
    )
    asset = write_asset(model, tmp_path / "asset", dtype)
    loaded, wanted = runtime.load(asset), asset.model()
    lights = runtime.light(LIGHTING)
    loaded.measure(lights)
    x = loaded.measured()
    assert relative(loaded.predict(x), np.asarray(wanted.reconstruct(x[None]))[0]) < 0.1 * PARITY
    assert runtime.frame(lights, loaded).any()
    assert not loaded.needs_shadows
