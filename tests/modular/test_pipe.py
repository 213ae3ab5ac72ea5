"""Pipes by closed forms and by rays on their meshes: view factors of cylinders, mirror images, what ends let through."""

import numpy as np
import pytest
import trimesh

from prt_bench.modular.cube import cosine_rays
from prt_bench.modular.lightfield import Grid
from prt_bench.modular.pipe import ALONG, AXIS, RADIUS, SHAPES, UP, Hit, bilinear, one_bounce, orders
from prt_bench.modular.pipe_light import direct_light, mirrored, passage, reduced, response

SIDE, GRID = 16, Grid(8, 14)
STRAIGHT, BEND = SHAPES
LENGTH = (1.0, 0.5 * np.pi * AXIS)
IDS = ("straight", "bend")


def ring_to_disk(distance):
    """View factor from a ring of a cylinder's wall to a disk across it (Howell's catalogue, B-59), in its diameter."""
    z = distance / (2.0 * RADIUS)
    return (z * z + 0.5) / np.sqrt(z * z + 1.0) - z


def mesh_of(pipe, along=60, around=96):
    """The wall of a pipe in triangles, vertices on it."""
    s, a = (
        part.ravel() for part in np.meshgrid(np.linspace(0, 1, along + 1), np.arange(around) / around, indexing="ij")
    )
    rows = np.arange(len(s)).reshape(along + 1, around)
    a00, a01 = rows[:-1].ravel(), np.roll(rows, -1, axis=1)[:-1].ravel()
    a10, a11 = rows[1:].ravel(), np.roll(rows, -1, axis=1)[1:].ravel()
    faces = np.concatenate([np.stack([a00, a01, a11], axis=1), np.stack([a00, a11, a10], axis=1)])
    return trimesh.Trimesh(pipe.place(s, a)[0], faces, process=False)


@pytest.mark.parametrize("pipe", SHAPES, ids=IDS)
def test_places_on_a_wall_are_found_again(pipe):
    along, around = np.random.default_rng(0).uniform(0, 1, (2, 500))
    position, normal = pipe.place(along, around)
    np.testing.assert_allclose(pipe.along(position), along, atol=1e-12)
    np.testing.assert_allclose(pipe.around(position), around, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)
    middle = pipe.frame(along).middle
    np.testing.assert_allclose(position + RADIUS * normal, middle, atol=1e-12)
    mesh = mesh_of(pipe)
    np.testing.assert_allclose(mesh.area, 2.0 * np.pi * RADIUS * LENGTH[SHAPES.index(pipe)], rtol=2e-3)
    column = pipe.around(mesh.triangles_center) // (1 / SIDE)
    shares = np.bincount(column.astype(int), mesh.area_faces)
    np.testing.assert_allclose(pipe.weights((np.arange(SIDE) + 0.5) / SIDE), shares / shares.mean(), rtol=0.02)


@pytest.mark.parametrize("pipe", SHAPES, ids=IDS)
def test_rays_meet_what_they_meet_on_a_mesh(pipe):
    random, mesh = np.random.default_rng(1), mesh_of(pipe, 240, 192)
    start = pipe.frame(random.uniform(0.05, 0.95, 4000))
    radius, angle = 0.9 * RADIUS * np.sqrt(random.uniform(0, 1, 4000)), random.uniform(0, 2 * np.pi, 4000)
    origin = start.middle + (radius * np.cos(angle))[:, None] * start.right + (radius * np.sin(angle))[:, None] * UP
    direction = random.normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    hit = pipe.meet(origin, direction)
    place, ray, _ = mesh.ray.intersects_location(origin, direction, multiple_hits=False)
    met = np.zeros(4000, bool)
    met[ray] = True
    own = (hit.along >= 0) & (hit.along <= 1)
    assert np.mean(met == own) > 0.998
    wanted = np.zeros((4000, 3))
    wanted[ray] = place
    found, _ = pipe.place(hit.along, hit.around)
    away = np.linalg.norm(found - wanted, axis=1)[met & own]
    assert np.median(away) < 5e-4
    assert np.quantile(away, 0.99) < 0.02  # along a wall, a facet is met elsewhere
    np.testing.assert_allclose(np.cross(found - origin, direction)[own], 0.0, atol=1e-5)


def test_light_in_a_cylinder_is_that_of_the_closed_form():
    side = 32
    transport = one_bounce(STRAIGHT, side)
    at = (np.arange(side) + 0.5) / side
    wanted = 1.0 - ring_to_disk(at) - ring_to_disk(1.0 - at)
    np.testing.assert_allclose(transport.sum(axis=1).reshape(side, side), np.tile(wanted[:, None], side), atol=3e-3)
    # Two places are in view of each other as cos θ cos θ′ / π d², on all of the cylinder.
    position, normal, _ = STRAIGHT.samples(side)
    to = position[None] - position[0]
    square = np.sum(to**2, axis=2)[0]
    cosines = (to[0] @ normal[0]) * -np.sum(to[0] * normal, axis=1)
    far = square > 0.3**2
    kernel = cosines[far] / (np.pi * square[far] ** 2) * (2.0 * np.pi * RADIUS / side**2)
    assert np.linalg.norm(transport[0][far] - kernel) < 0.02 * np.linalg.norm(kernel)


@pytest.mark.parametrize("pipe", SHAPES, ids=IDS)
def test_light_in_a_pipe_goes_both_ways_alike_and_none_is_made(pipe):
    transport, (_, _, area) = one_bounce(pipe, SIDE), pipe.samples(SIDE)
    np.testing.assert_allclose(area[:, None] * transport, (area[:, None] * transport).T, atol=1e-15)
    assert transport.min() >= 0
    assert transport.sum(axis=1).max() < 1
    backwards = orders(SIDE)[ALONG]
    np.testing.assert_allclose(transport[np.ix_(backwards, backwards)], transport, atol=1e-15)


def seen_on_mesh(mesh, origin, towards):
    """Where rays meet a mesh first: which rays do, and the places."""
    place, ray, _ = mesh.ray.intersects_location(origin, towards, multiple_hits=False)
    return ray, place


def test_light_in_a_bend_is_that_of_rays_on_its_mesh():
    side, across = 32, 64
    transport, mesh = one_bounce(BEND, side), mesh_of(BEND, 160, 128)
    position, normal, _ = BEND.samples(side)

    def sent(place):
        return np.stack([np.ones(len(place)), place[:, 0], place[:, 1] ** 2, np.cos(9.0 * place[:, 2])])

    rows = np.arange(7, side * side, 41)
    rays = cosine_rays(normal[rows], across).reshape(-1, 3)
    ray, place = seen_on_mesh(mesh, np.repeat(position[rows] + 0.0015 * normal[rows], across**2, axis=0), rays)
    for light, met in zip(sent(position), sent(place), strict=True):
        found = (transport @ light)[rows]
        wanted = np.bincount(ray // across**2, met, len(rows)) / across**2
        assert np.linalg.norm(found - wanted) < 0.01 * np.linalg.norm(transport[rows] @ np.abs(light))


def test_lights_in_a_bend_and_beyond_its_ends_cast_shadows():
    before, after = mesh_of(STRAIGHT), mesh_of(STRAIGHT)
    before.vertices = before.vertices - [1.0, 0.0, 0.0]
    after.vertices = after.vertices[:, [2, 1, 0]] * [1.0, 1.0, -1.0] - [0.0, 0.0, 1.0]
    mesh = trimesh.util.concatenate([before, mesh_of(BEND), after])
    position, normal, _ = BEND.samples(SIDE)
    start = position + 0.003 * normal
    for light in ((-0.49, 0.0, -0.2), (-0.1, 0.1, -0.1), (-1.1, 0.1, 0.1), (0.15, -0.1, -0.9)):
        away = np.linalg.norm(light - start, axis=1)
        ray, place = seen_on_mesh(mesh, start, light - start)
        wanted = np.ones(len(start), bool)
        wanted[ray] = np.linalg.norm(place - start[ray], axis=1) > away[ray]
        facing = np.sum((light - start) * normal, axis=1) > 0
        seen = BEND.sees(np.array([light]), position)[0]
        assert np.mean((seen == wanted)[facing]) > 0.97  # at the edge of a shadow either will do
        assert np.all(seen[facing]) == (light[0] in (-0.49, -0.1))  # a light within a bend sees all that faces it
    assert np.all(STRAIGHT.sees(np.array([[0.8, 0.1, 0.0]]), STRAIGHT.samples(SIDE)[0]))


@pytest.mark.parametrize("pipe", SHAPES, ids=IDS)
def test_modes_are_orthonormal_by_area_and_hold_the_light_of_the_prior(pipe):
    modes, (_, _, area) = reduced(pipe, SIDE, functions=24, prior=48, lights=40), pipe.samples(SIDE)
    np.testing.assert_allclose(modes.basis.T @ (area[:, None] * modes.basis), np.eye(24), atol=1e-9)
    bounced = one_bounce(pipe, SIDE) @ modes.prior
    missed = bounced - modes.basis @ (modes.read @ modes.prior)
    assert np.sum(area[:, None] * missed**2) < 1e-3 * np.sum(area[:, None] * bounced**2)
    np.testing.assert_allclose(one_bounce(pipe, SIDE) @ modes.implicit, modes.basis, atol=1e-8)
    light = direct_light(pipe, SIDE, 20)
    assert light.shape[1] >= 20 + 2 * 5
    held = np.linalg.norm(np.linalg.lstsq(light, light[orders(SIDE)[ALONG]], rcond=None)[0], axis=0)
    np.testing.assert_allclose(held, 1.0, atol=1e-6)  # each light's image is one of the others
    assert light.min() >= 0


def test_orders_of_samples_are_what_pipes_look_like_from_elsewhere():
    as_is, back, mirror, along = orders(SIDE)
    np.testing.assert_array_equal(as_is, np.arange(SIDE * SIDE))
    for order in (back, mirror, along):
        np.testing.assert_array_equal(order[order], as_is)
    np.testing.assert_array_equal(back[mirror], along)
    position, _, _ = STRAIGHT.samples(SIDE)
    np.testing.assert_allclose(position[back], position * [-1.0, 1.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(position[mirror], position * [1.0, 1.0, -1.0], atol=1e-12)
    turned = BEND.samples(SIDE)[0][along]
    np.testing.assert_allclose(turned[:, [2, 1, 0]], BEND.samples(SIDE)[0], atol=1e-12)


def test_lookups_on_a_wall_are_even_and_find_samples():
    middles = (np.arange(SIDE) + 0.5) / SIDE
    rows, columns, weights = bilinear(Hit(np.repeat(middles, SIDE), np.tile(middles, SIDE)), SIDE)
    np.testing.assert_allclose(np.sum((rows * SIDE + columns) * weights, axis=1), np.arange(SIDE * SIDE), atol=1e-9)
    rows, columns, weights = bilinear(Hit(np.array([0.0, 1.0]), np.array([0.0, 0.999])), SIDE)
    assert rows.min() == -1
    assert rows.max() == SIDE
    assert {0, SIDE - 1} == set(columns.ravel().tolist())
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)


def test_ends_pass_even_light_as_view_factors_say():
    """Of the light through one end of a cylinder, what goes out at the other: coaxial disks (Howell's catalogue, C-41)."""
    even, disks = np.ones(GRID.size), 1.0 + (1.0 - np.sqrt(4.0 * RADIUS**2 + 1.0)) / (2.0 * RADIUS**2)
    for pipe in SHAPES:
        leave, onwards = passage(pipe, SIDE, GRID)
        # All light that leaves came from the wall or from the other end.
        np.testing.assert_allclose(onwards @ even + np.pi * (leave @ np.ones(SIDE * SIDE)), 1.0, atol=1e-12)
        received = response(pipe, SIDE, GRID, even[:, None], across=32)[:, 0].reshape(SIDE, SIDE) / np.pi
        lost = 1.0 - one_bounce(pipe, SIDE).sum(axis=1).reshape(SIDE, SIDE)
        np.testing.assert_allclose(received + received[::-1], lost, atol=1e-12)
        if pipe is STRAIGHT:
            assert (onwards @ even).mean() == pytest.approx(disks, abs=2e-3)
            at = (np.arange(SIDE) + 0.5) / SIDE
            np.testing.assert_allclose(received.mean(axis=1), ring_to_disk(at), atol=6e-3)


def test_what_leaves_through_an_end_is_what_would_arrive_by_it():
    """The response is the adjoint of emission: a lightfield sent back against the light lights the wall as it was sent."""
    random = np.random.default_rng(3)
    for pipe, length in zip(SHAPES, LENGTH, strict=True):
        position, _, area = pipe.samples(SIDE)
        # Through the near end, seen along the light that leaves; light that comes back has right and left exchanged,
        # and parts of its directions to the right and up are those of the light that left, the second with its sign turned.
        leave = passage(pipe, SIDE, GRID).leave[mirrored(GRID)][:, orders(SIDE)[ALONG]]
        shape = GRID.places, GRID.places, GRID.turns, GRID.turns
        back = np.arange(GRID.size).reshape(shape)[:, ::-1, ::-1, :].ravel()
        wall, end = 2.0 * np.pi * RADIUS * length / SIDE**2 * area, (np.pi * RADIUS) ** 2 / GRID.size
        for sent in (np.ones(len(position)), 1.0 + 0.8 * np.cos(4.0 * position @ random.normal(size=3))):
            came = response(pipe, SIDE, GRID, (leave @ np.ones(len(position)))[back][:, None], across=32)[:, 0]
            assert np.sum(wall * sent * came) == pytest.approx(
                np.pi * end * np.sum((leave @ sent) * (leave @ np.ones(len(sent)))), rel=0.02
            )
