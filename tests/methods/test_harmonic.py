"""Classical precomputed radiance transfer against closed forms, quadrature and light that the bake traced by itself."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.geometry import assemble, quad
from data_gen.scenes.two_plates import ALBEDO, view_factor
from data_gen.vertices import shading_vertices, smooth_corners
from prt_bench.errors import DatasetError, FitError, SpecError
from prt_bench.example import example_dataset
from prt_bench.harmonic import light_coefficients
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.lights import emitters
from prt_bench.methods.escaping import transfer_vectors
from prt_bench.scene import Camera, Material, Mesh, Scene
from prt_bench.spherical import evaluate, product_matrix, quadrature
from prt_bench.visibility import escaping_transfer, transfer_matrices

ORDER = 5
SETTINGS = {"lightings": 2, "texels": 24, "rays": 256, "measurements": 16, "vertices": True}


@pytest.fixture(scope="module")
def plates(tmp_path_factory):
    return prt.bake(prt.load_scene("two-plates"), "directional", **SETTINGS, out=tmp_path_factory.mktemp("plates"))


@pytest.fixture(scope="module")
def room():
    return example_dataset(rays=256, walls=5)


def normals(count: int) -> np.ndarray:
    drawn = np.random.default_rng(0).normal(size=(count, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def test_open_points_have_the_cosine_lobe_about_their_normals():
    """No noise at all: what a set of directions gets wrong is known."""
    directions, weight = quadrature(40)
    normal = normals(40)
    exact = np.einsum("q,qk,pq->pk", weight, evaluate(directions, 3), np.maximum(normal @ directions.T, 0.0))
    found = escaping_transfer(np.ones((40, 16), bool), HemisphereSampler.create(16, 0), 5, normal, 3)
    np.testing.assert_allclose(found, exact, atol=4e-3)  # of the quadrature, which meets the cosine's kink
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(found[0]), rtol=1e-5)


def test_transfer_is_the_sum_over_the_rays_themselves():
    """In the world, ray by ray; and a local product that was turned the wrong way would differ."""
    sampler, normal = HemisphereSampler.create(64, 1), normals(70)
    directions = sampler.directions(3, normal)
    escaped = directions[..., 1] > 0.3 * directions[..., 0]
    share = escaped.mean(axis=1, keepdims=True)
    harmonics = np.asarray(evaluate(directions.astype(float), ORDER)) * np.pi / 64
    everything = escaping_transfer(np.ones((70, 64), bool), sampler, 3, normal, ORDER)
    plain = np.einsum("pr,prk->pk", escaped, harmonics)
    wanted = plain + share * (everything - harmonics.sum(axis=1))
    np.testing.assert_allclose(escaping_transfer(escaped, sampler, 3, normal, ORDER), wanted, atol=2e-6)


def test_matrices_take_light_to_what_arrives():
    """Ray by ray in the world; the first column is the transfer vector, which distant light of one coefficient meets."""
    sampler, normal = HemisphereSampler.create(64, 1), normals(70)
    directions = sampler.directions(3, normal).astype(float)
    escaped = directions[..., 1] > 0.3 * directions[..., 0]
    y = np.asarray(evaluate(directions, 3))
    wanted = np.einsum("pr,pri,prj->pij", escaped, y, y) * np.pi / 64
    found = transfer_matrices(escaped, sampler, 3, normal, 3)
    np.testing.assert_allclose(found, wanted, atol=5e-6)
    np.testing.assert_allclose(found, np.swapaxes(found, 1, 2), atol=5e-6)


def test_triple_products_are_the_matrices_of_what_the_order_holds():
    """Products of bands up to 2 have bands up to 4, so vectors of order 5 lose nothing of them."""
    normal = normals(20)
    sampler = HemisphereSampler.create(1024, 0)
    matrices = transfer_matrices(np.ones((20, 1024), bool), sampler, 0, normal, 3)
    vectors = escaping_transfer(np.ones((20, 1024), bool), sampler, 0, normal, 5)
    whole = np.asarray(product_matrix(vectors.astype(float)))[:, :9, :9]
    np.testing.assert_allclose(matrices, whole, atol=4e-3)


def test_first_coefficient_is_the_open_share_of_the_hemisphere(plates):
    direct, indirect = transfer_vectors(plates.transport, jnp.full((len(plates.points), 1), ALBEDO, jnp.float32), ORDER)
    constant = float(evaluate(np.array([0.0, 0.0, 1.0]), 1)[0])
    found = direct[:, 0] / (np.pi * constant)
    exact = 1.0 - view_factor(plates.points.position)
    assert np.sqrt(np.mean((found - exact) ** 2)) < 0.004
    assert np.all(indirect[:, 0, 0] > 0)


def test_even_light_from_everywhere_needs_one_coefficient(plates):
    """Light of constant radiance: direct and indirect light as the rays of the bake see it, for any order."""
    sky = np.full((8, 16, 3), 0.7, np.float32)
    lit = prt.light(plates, [prt.Lighting([prt.EnvironmentLight(sky)])])
    whole = np.asarray(lit.direct[0] + lit.indirect[0], float)
    found = np.asarray(prt.method("sh-texture", order=3).fit(plates).predict(lit))[0]
    # The bake's 64 directions stand for the sky in direct light; rays stand for it here.
    assert abs(found.mean() / whole.mean() - 1.0) < 0.02
    assert np.sqrt(np.mean((found - whole) ** 2)) / whole.mean() < 0.1


def test_more_bands_come_closer(plates):
    test = plates.split("test")
    errors = []
    for order in (2, 4, 8):
        model = prt.method("sh-texture", order=order).fit(plates)
        errors.append(prt.evaluate(model, test).errors.total)
    assert errors[0] > 1.15 * errors[1] > 1.15**2 * errors[2]


def test_indirect_light_alone_is_what_direct_light_leaves(room):
    whole, alone = (prt.method("sh-texture", light=light).fit(room) for light in ("all", "indirect"))
    direct, _ = transfer_vectors(room.transport, jnp.ones((len(room.points), 1), jnp.float32), ORDER)
    u = whole.measure(room)
    np.testing.assert_allclose(
        whole.reconstruct(u) - alone.reconstruct(u), jnp.einsum("tk,nkc->ntc", direct, u), atol=1e-4
    )
    assert whole.includes_direct
    assert not alone.includes_direct


def test_error_of_a_method_with_direct_light_counts_what_is_wrong_there(room):
    """Over the same reference as for any other method."""
    test, model = room.split("test"), prt.method("sh-texture").fit(room)
    found = prt.evaluate(model, test).errors
    wrong = np.asarray(model.predict(test)) - test.direct - test.indirect
    norms = np.linalg.norm(wrong, axis=(1, 2)) / np.linalg.norm(test.indirect, axis=(1, 2))
    assert found.relative_rmse == pytest.approx(np.sqrt(np.mean(norms**2)), rel=1e-4)
    totals = np.linalg.norm(wrong, axis=(1, 2)) / np.linalg.norm(test.direct + test.indirect, axis=(1, 2))
    assert found.total == pytest.approx(np.sqrt(np.mean(totals**2)), rel=1e-4)


def test_distant_light_has_the_coefficients_of_its_direction():
    light = prt.DirectionalLight((0.3, -1.0, 0.2), (1.0, 2.0, 3.0))
    lights = jax.tree.map(lambda leaf: leaf[0], emitters([prt.Lighting([light])]))
    found = light_coefficients(lights, jnp.array([5.0, 1.0, 2.0]), ORDER)
    towards = -np.array([0.3, -1.0, 0.2]) / np.linalg.norm([0.3, -1.0, 0.2])
    np.testing.assert_allclose(found, np.outer(evaluate(towards, ORDER), (1.0, 2.0, 3.0)), rtol=1e-12, atol=1e-14)


def test_near_light_counts_as_far_as_it_looks_from_the_middle():
    lights = [prt.PointLight((0.0, 3.0, 4.0), (2.0, 2.0, 2.0), 0.0)]
    single = jax.tree.map(lambda leaf: leaf[0], emitters([prt.Lighting(lights)]))
    found = light_coefficients(single, jnp.zeros(3), ORDER)
    np.testing.assert_allclose(found[:, 0], 2.0 / 25.0 * evaluate(np.array([0.0, 0.6, 0.8]), ORDER), rtol=1e-6)


def test_light_coefficients_are_differentiable_in_the_light():
    def loss(direction: jax.Array) -> jax.Array:
        lights = emitters([prt.Lighting([prt.DirectionalLight(direction, jnp.ones(3))])])
        single = jax.tree.map(lambda leaf: leaf[0], lights)
        return jnp.sum(light_coefficients(single, jnp.zeros(3), ORDER) * jnp.arange(75.0).reshape(25, 3))

    where, along = jnp.array([0.1, -1.0, 0.0]), jnp.array([0.3, 0.2, -0.5])
    difference = (loss(where + 1e-6 * along) - loss(where - 1e-6 * along)) / 2e-6
    assert float(jnp.vdot(jax.grad(loss)(where), along)) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.parametrize("window", ["hann", "lanczos", "positive"])
def test_windows_keep_the_mean_and_calm_the_rest(room, window):
    plain, calm = (prt.method("sh-texture", window=name).fit(room).basis for name in ("none", window))
    np.testing.assert_allclose(calm[..., 0], plain[..., 0], rtol=1e-6)
    assert float(jnp.linalg.norm(calm[..., 16:])) < 0.7 * float(jnp.linalg.norm(plain[..., 16:]))


def test_transfer_at_vertices_is_the_texels_where_both_are(plates):
    """At the corners of two-plates the view factor has its closed form too."""
    model = prt.method("sh-vertex", order=3).fit(plates)
    assert model.basis.shape == (8, 1, 9)
    vertices = plates.transport.vertices
    constant = float(evaluate(np.array([0.0, 0.0, 1.0]), 1)[0])
    direct, _ = transfer_vectors(
        plates.transport.at_vertices()[0], jnp.full((len(plates.points), 1), ALBEDO, jnp.float32), 3
    )
    exact = 1.0 - view_factor(vertices.points.position)
    np.testing.assert_allclose(direct[:, 0] / (np.pi * constant), exact, atol=0.01)


def test_between_vertices_light_is_linear(room):
    model = prt.method("sh-vertex").fit(room)
    u = model.measure(room)
    at_vertices = np.einsum("vck,nkc->nvc", model.basis, u)
    faces, points = room.transport.vertices.corner, room.points
    wanted = np.einsum("ti,ntic->ntc", points.barycentric, at_vertices[:, faces[points.face]])
    np.testing.assert_allclose(model.reconstruct(u), wanted, rtol=1e-5, atol=1e-6)


def test_what_was_not_traced_is_asked_for(room):
    bare = replace(room, transport=replace(room.transport, vertices=None, sampler=None))
    with pytest.raises(DatasetError, match="vertices = true"):
        prt.method("sh-vertex").fit(bare)
    with pytest.raises(FitError, match="bake it again"):
        prt.method("sh-texture").fit(bare)
    with pytest.raises(SpecError, match="'order' must be from 1 to 16, not 0"):
        prt.method("sh-texture", order=0)


def mesh_of(*parts, two_sided: bool = False) -> Mesh:
    mesh = assemble(parts)
    if not two_sided:
        return mesh
    faces = np.concatenate([mesh.faces, mesh.faces[:, ::-1]])
    return Mesh(mesh.vertices, faces, np.concatenate([mesh.material, mesh.material]))


SQUARE = quad([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 0)


def test_smooth_surfaces_share_vertices_and_creases_do_not():
    fold = quad([(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)], 0)
    assert smooth_corners(mesh_of(SQUARE)).max() + 1 == 4
    assert smooth_corners(mesh_of(SQUARE, fold)).max() + 1 == 8
    assert smooth_corners(mesh_of(SQUARE, two_sided=True)).max() + 1 == 8
    bent = quad([(1, 0, 0), (2, 0, 0.2), (2, 1, 0.2), (1, 1, 0)], 0)
    assert smooth_corners(mesh_of(SQUARE, bent)).max() + 1 == 6


def test_normals_of_vertices_are_smooth_and_places_lie_inside():
    bent = quad([(1, 0, 0), (2, 0, 0.2), (2, 1, 0.2), (1, 1, 0)], 0)
    scene = Scene("bent", mesh_of(SQUARE, bent), (Material(),), Camera((0, 0, 1), (0, 0, 0)))
    points, corner = shading_vertices(scene)
    assert corner.shape == scene.mesh.faces.shape
    np.testing.assert_allclose(np.linalg.norm(points.normal, axis=1), 1.0, rtol=1e-12)
    middle = np.abs(points.position[:, 0] - 1.0) < 0.01
    between = points.normal[middle]
    assert len(between) == 2
    assert np.all(between[:, 0] < -0.05)
    assert np.all(between[:, 0] > -0.15)
    far = np.linalg.norm(points.position[corner] - scene.mesh.triangles, axis=-1)
    assert far.max() < 0.005
