"""Walks through a medium against what is known exactly: half-spaces, slabs, energy, reciprocity, and the mean path."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import prt_bench as prt
from data_gen import medium_walk
from data_gen.effects.subsurface import enclosed_volume, predicted_events
from data_gen.geometry import assemble, box
from data_gen.medium_walk import Ends, Fate, bodies, follow, follow_all, scattered, uniform, walk_keys
from data_gen.reference import cosine_directions
from prt_bench.errors import SceneError
from prt_bench.medium import Subsurface, diffuse_reflectance, fresnel
from prt_bench.scene import Camera, Glossy, Material, Mesh, Scene

BLACK = (0.0, 0.0, 0.0)


def grey(scattering: float, absorption: float, anisotropy: float = 0.0, ior: float = 1.0) -> Subsurface:
    return Subsurface((scattering,) * 3, (absorption,) * 3, anisotropy, ior)


def body(mesh: Mesh, medium: Subsurface) -> Scene:
    return Scene("body", mesh, (Material("m", BLACK, subsurface=medium),), Camera((0, 0, 4), (0, 0, 0)))


def ball(medium: Subsurface, subdivisions: int = 2) -> Scene:
    made = trimesh.creation.icosphere(subdivisions=subdivisions)
    return body(Mesh(made.vertices, made.faces, np.zeros(len(made.faces), int)), medium)


def slab(medium: Subsurface, thickness: float, width: float = 100.0) -> Scene:
    return body(assemble([box((width / 2, thickness / 2, width / 2), 0)]), medium)


def walked(scene: Scene, count: int, seed: int = 0) -> tuple[Ends, np.ndarray, np.ndarray]:
    """Walks from all over the surface; where they began and ended (faces)."""
    rng = np.random.default_rng(seed)
    area = scene.mesh.areas
    face = rng.choice(len(area), count, p=area / area.sum())
    position = np.einsum("nc,ncd->nd", rng.dirichlet([1, 1, 1], count), scene.mesh.triangles[face])
    normal = scene.mesh.normals[face]
    ends = follow(
        bodies(scene)[0],
        0,
        position,
        normal,
        cosine_directions(rng, normal),
        walk_keys(np.arange(count), 1, seed)[:, 0],
    )
    return ends, face, ends.face


def from_the_middle(scene: Scene, count: int, seed: int = 0) -> tuple[Ends, np.ndarray]:
    """Walks from the middle of a slab's top, and where they left it."""
    rng = np.random.default_rng(seed)
    position = np.tile([0.0, scene.bounds[1, 1], 0.0], (count, 1))
    normal = np.tile([0.0, 1.0, 0.0], (count, 1))
    ends = follow(
        bodies(scene)[0],
        0,
        position,
        normal,
        cosine_directions(rng, normal),
        walk_keys(np.arange(count), 1, seed)[:, 0],
    )
    barycentric = np.stack([1.0 - ends.u - ends.v, ends.u, ends.v], axis=1)
    return ends, np.einsum("nc,ncd->nd", barycentric, scene.mesh.triangles[ends.face])


def deviations(hits: np.ndarray, expected: float) -> float:
    """By how many standard deviations of a binomial the share of true entries misses what is expected."""
    return float((hits.mean() - expected) / np.sqrt(expected * (1.0 - expected) / len(hits)))


def half_space_albedo(albedo: float, nodes: int = 200) -> float:
    """Reflectance of a half-space of isotropic scatterers for diffuse light, through Chandrasekhar's H-function.

    1 / H(μ) = √(1 − ϖ) + ϖ/2 ∫ μ' H(μ') / (μ + μ') dμ', and A = 1 − 2 √(1 − ϖ) ∫ H μ dμ ("Radiative Transfer", §§ 37–38).
    """
    node, weight = np.polynomial.legendre.leggauss(nodes)
    mu, weight = 0.5 * (node + 1.0), 0.5 * weight
    h, change = np.ones(nodes), 1.0
    while change > 1e-12:
        inverse = np.sqrt(1.0 - albedo) + 0.5 * albedo * np.sum(mu * h * weight / (mu[:, None] + mu), axis=1)
        change = np.abs(1.0 / inverse - h).max()
        h = 0.5 * (h + 1.0 / inverse)
    return float(1.0 - 2.0 * np.sqrt(1.0 - albedo) * np.sum(mu * h * weight))


@pytest.mark.parametrize("albedo", [0.5, 0.9, 0.99])
def test_a_half_space_reflects_what_chandrasekhar_says(albedo: float) -> None:
    medium = Subsurface.of_albedo((albedo,) * 3, (1.0,) * 3, 0.0, 1.0)
    ends, at = from_the_middle(slab(medium, 100.0, 200.0), 20000)
    escaped = ends.fate == Fate.ESCAPED
    assert np.all(at[escaped, 1] > 49)  # it is deep enough
    assert abs(deviations(escaped, half_space_albedo(albedo))) < 4
    assert abs(deviations(escaped, half_space_albedo(0.9 * albedo))) > 4  # and a tenth less would show


def test_forward_scattering_obeys_similarity_deep_in() -> None:
    """A strongly scattering medium looks as if isotropic with σ_s (1 − g): the similarity relation of diffusion theory."""
    narrow, wide = grey(40.0, 0.1, 0.9), grey(4.0, 0.1)
    shares = [
        np.mean(from_the_middle(slab(medium, 20.0, 60.0), 3000)[0].fate == Fate.ESCAPED) for medium in (narrow, wide)
    ]
    assert shares[0] == pytest.approx(shares[1], abs=0.03)
    assert (
        abs(np.mean(from_the_middle(slab(grey(40.0, 0.1), 20.0, 60.0), 3000)[0].fate == Fate.ESCAPED) - shares[1]) > 0.1
    )


@pytest.mark.parametrize("depth", [3.0, 10.0])
def test_a_slab_passes_what_diffusion_theory_says(depth: float) -> None:
    """T = (4/3) / (τ + 2 · 0.7104) for diffuse light on a slab that does not absorb (Milne's extrapolation length)."""
    _, at = from_the_middle(slab(grey(1.0, 0.0), depth, 100.0 * depth), 10000)
    passed = at[:, 1] < 0
    assert abs(deviations(passed, 4.0 / 3.0 / (depth + 2 * 0.71045))) < 4
    assert abs(deviations(passed, 4.0 / 3.0 / depth)) > 4.5  # without the extrapolation


def test_the_searchlight_profile_is_the_dipole_beyond_its_source() -> None:
    """Light from one point leaves around it as the dipole says, within 10 %, from 2 to 14 mean free paths away.

    Jensen et al. 2001, "A Practical Model for Subsurface Light Transport", eqs. 3 and 4; its approximation fails nearer.
    """
    medium = grey(1.0, 0.01, 0.0, 1.3)
    count = 40000
    ends, at = from_the_middle(slab(medium, 60.0, 120.0), count)
    found = np.histogram(np.hypot(*at[ends.fate == Fate.ESCAPED][:, [0, 2]].T), [2, 4, 6, 9, 14])[0]
    extinction, diffusion = 1.01, 1.0 / (3.0 * 1.01)
    internal = -1.440 / 1.3**2 + 0.710 / 1.3 + 0.668 + 0.0636 * 1.3
    depth = 1.0 / extinction
    above = depth * (1.0 + 4.0 / 3.0 * (1.0 + internal) / (1.0 - internal))
    effective = np.sqrt(0.01 / diffusion)

    def share(first: float, last: float) -> float:
        r = np.linspace(first, last, 2001)
        profile = 0.0
        for z in (depth, above):
            d = np.hypot(r, z)
            profile = profile + z * (effective + 1.0 / d) * np.exp(-effective * d) / d**2
        return float(np.trapezoid(profile / (4.0 * np.pi * extinction) * 2.0 * np.pi * r, r))

    expected = np.array([share(a, b) for a, b in ((2, 4), (4, 6), (6, 9), (9, 14))])
    entered = count * (1.0 - diffuse_reflectance(1.3))
    np.testing.assert_allclose(found / entered / expected, 1.0, atol=0.1)


@pytest.mark.parametrize(("ior", "depth"), [(1.5, 0.5), (1.0, 0.3)])
def test_a_clear_slab_is_fresnel_and_beer(ior: float, depth: float) -> None:
    """Without scattering, what passes and what comes back is a geometric series of reflections, averaged over directions."""
    node, weight = np.polynomial.legendre.leggauss(400)
    mu, weight = 0.5 * (node + 1.0), 0.5 * weight
    reflected = fresnel(mu, ior)
    kept = np.exp(-depth / np.sqrt(1.0 - (1.0 - mu**2) / ior**2))
    through = 2 * mu * weight * (1 - reflected) ** 2 * kept / (1 - (reflected * kept) ** 2)
    ends, at = from_the_middle(slab(grey(0.0, 1.0, 0.0, ior), depth), 100000)
    escaped = ends.fate == Fate.ESCAPED
    assert abs(deviations(escaped & (at[:, 1] < 0), through.sum())) < 4
    assert abs(deviations(ends.fate == Fate.REFLECTED, max(diffuse_reflectance(ior), 1e-12))) < 4
    if ior > 1:
        assert abs(deviations(escaped & (at[:, 1] > 0), np.sum(through * reflected * kept))) < 4
        assert abs(deviations(escaped & (at[:, 1] < 0), np.exp(-2 * depth))) > 10


def test_fresnel_inside_and_outside_is_one_boundary() -> None:
    """1 − F from inside is (1 − F from outside) / n² for diffuse light, and 9.18 % is reflected at n = 1.5 (Walsh 1926)."""
    assert diffuse_reflectance(1.5) == pytest.approx(0.0918, abs=5e-5)
    mu = np.linspace(0.0, 1.0, 200001)
    inside = np.trapezoid(2 * mu * fresnel(mu, 1 / 1.5), mu)
    assert 1.0 - inside == pytest.approx((1.0 - diffuse_reflectance(1.5)) / 1.5**2, abs=1e-4)
    assert np.all(fresnel(mu, 1.0) < 1e-12)
    assert fresnel(np.array([1.0]), 1.5)[0] == pytest.approx(0.04)


@pytest.mark.parametrize("medium", [grey(10.0, 0.0), grey(20.0, 0.0, 0.7, 1.4), grey(0.5, 0.0)])
def test_the_mean_path_does_not_depend_on_the_medium(medium: Subsurface) -> None:
    """n² 4V/S in any body that does not absorb: Blanco and Fournier 2003. Collisions are its length over the free path."""
    scene = ball(medium)
    ends, *_ = walked(scene, 20000)
    path = medium.ior**2 * 4.0 * enclosed_volume(scene, 0) / scene.mesh.areas.sum()
    if medium.ior == 1:  # else encounters with the boundary count as well
        collisions = ends.events - 1.0
        error = collisions.std() / np.sqrt(len(collisions))
        assert abs(collisions.mean() - path * medium.extinction[0]) < 4 * error
        assert abs(collisions.mean() - 0.9 * path * medium.extinction[0]) > 4 * error
    bound = predicted_events(scene, 0)
    assert ends.events.mean() < 2.0 * bound  # the planner's: of the right size where walls reflect, too
    assert ends.events.mean() > 0.5 * bound


@pytest.mark.parametrize("medium", [grey(30.0, 0.3, 0.5, 1.4), grey(5.0, 0.0), grey(0.0, 2.0, 0.0, 1.5)])
def test_every_walk_has_one_fate(medium: Subsurface) -> None:
    ends, *_ = walked(ball(medium), 4000)
    counts = np.bincount(ends.fate, minlength=len(Fate))
    assert counts.sum() == 4000
    assert counts[Fate.ALIVE] == counts[Fate.LOST] == 0
    assert (counts[Fate.ABSORBED] == 0) == (medium.albedo[0] == 1)
    assert (counts[Fate.REFLECTED] == 0) == (medium.ior == 1)


def test_thick_media_lose_nothing_and_a_short_limit_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Albedo 1 at an optical depth of 60: all light comes out in the end, and what a limit cuts off is counted."""
    scene = ball(grey(60.0, 0.0))
    assert np.all(walked(scene, 1000)[0].fate == Fate.ESCAPED)
    monkeypatch.setattr(medium_walk, "LONGEST", 64)
    fate = walked(scene, 1000)[0].fate
    assert 0.1 < np.mean(fate == Fate.ALIVE) < 0.4
    assert np.all((fate == Fate.ALIVE) | (fate == Fate.ESCAPED))


def asymmetry(first: np.ndarray, last: np.ndarray, patches: np.ndarray) -> float:
    """χ² per pair of patches of the difference between walks one way and the other: 1 where they are reciprocal."""
    count = patches.max() + 1
    table = np.zeros((count, count))
    np.add.at(table, (patches[first], patches[last]), 1.0)
    above = np.triu_indices(count, 1)
    there, back = table[above], table.T[above]
    used = there + back > 10
    return float(np.mean((there - back)[used] ** 2 / (there + back)[used]))


def test_walks_are_reciprocal_on_a_box_of_unequal_sides() -> None:
    """A_i K_ij = A_j K_ji for every two patches; and not with directions that are not those of diffuse light."""
    scene = body(assemble([box((1.0, 0.2, 0.5), 0)]), grey(4.0, 0.4, 0.4, 1.4))
    patches = np.arange(12)
    ends, first, last = walked(scene, 150000)
    out = ends.fate == Fate.ESCAPED
    assert asymmetry(first[out], last[out], patches) < 1.8
    rng = np.random.default_rng(1)
    normal = scene.mesh.normals[first]
    straight = normal + 1e-3 * cosine_directions(rng, normal)
    straight /= np.linalg.norm(straight, axis=1, keepdims=True)
    position = np.einsum("nc,ncd->nd", rng.dirichlet([1, 1, 1], len(first)), scene.mesh.triangles[first])
    wrong = follow(bodies(scene)[0], 0, position, normal, straight, walk_keys(np.arange(len(first)), 1, 1)[:, 0])
    out = wrong.fate == Fate.ESCAPED
    assert asymmetry(first[out], wrong.face[out], patches) > 3


@pytest.mark.parametrize("anisotropy", [0.0, 1e-4, 0.3, 0.9, -0.7])
def test_scattering_follows_henyey_and_greenstein(anisotropy: float) -> None:
    rng = np.random.default_rng(2)
    direction = cosine_directions(rng, np.tile([0.0, 0.0, 1.0], (40000, 1)))
    turned = scattered(direction, anisotropy, rng.random(40000), rng.random(40000))
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0, atol=1e-12)
    cosine = np.einsum("nd,nd->n", direction, turned)
    assert cosine.mean() == pytest.approx(anisotropy, abs=5 * cosine.std() / 200)
    # Legendre moments are powers of g; the second shows the shape.
    second = 1.5 * cosine**2 - 0.5
    assert second.mean() == pytest.approx(anisotropy**2, abs=5 * second.std() / 200)


def test_random_numbers_are_uniform_below_one_and_steps_finite() -> None:
    keys = walk_keys(np.arange(1000), 64, 7).ravel()
    assert len(np.unique(keys)) == len(keys)
    numbers = uniform(keys, np.uint64(0))
    assert 0 <= numbers.min() < numbers.max() < 1
    assert numbers.mean() == pytest.approx(0.5, abs=5 / np.sqrt(12 * len(keys)))
    assert np.isfinite(np.log1p(-np.array([0.0, 1.0 - 2.0**-53]))).all()


def test_walks_do_not_depend_on_workers_or_company() -> None:
    scene = ball(grey(8.0, 0.1, 0.2, 1.3))
    rng = np.random.default_rng(0)
    normal = scene.mesh.normals[:200]
    position = scene.mesh.triangles[:200].mean(axis=1)
    direction, key = cosine_directions(rng, normal), walk_keys(np.arange(200), 1, 0)[:, 0]
    whole = follow(bodies(scene, workers=2)[0], 0, position, normal, direction, key)
    part = follow(bodies(scene, workers=1)[0], 0, position[50:90], normal[50:90], direction[50:90], key[50:90])
    for all_of_them, some in zip(whole, part, strict=True):
        np.testing.assert_array_equal(all_of_them[50:90], some)


@pytest.mark.parametrize("shared", [(8.0, 8.0, 8.0), (8.0, 2.0, 8.0)])
def test_channels_that_share_walks_get_what_each_gets_alone(shared: tuple[float, ...]) -> None:
    medium = Subsurface.of_albedo((0.9, 1.0, 0.0), tuple(1.0 / part for part in shared), 0.2, 1.3)  # pyright: ignore
    one = bodies(ball(medium))[0]
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(one.faces), 4000)
    normal = one.normals[face]
    at = one.tracer.nearest
    start = (ball(medium).mesh.triangles[face].mean(axis=1), normal, cosine_directions(rng, normal))
    key = walk_keys(np.arange(4000), 1, 0)[:, 0]
    together = follow_all(one, 3, *start, key)
    cost, at = one.tracer.nearest - at, one.tracer.nearest
    for channel, ends in enumerate(together):
        for ours, alone in zip(ends, follow(one, channel, *start, key), strict=True):
            np.testing.assert_array_equal(ours, alone)
    assert cost < (0.75 if shared[1] == 8.0 else 1.0) * (one.tracer.nearest - at)
    assert len({tuple(np.bincount(ends.fate, minlength=5)) for ends in together}) == 3


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_walks_are_the_same_at_every_scale(scale: float) -> None:
    scene = ball(grey(8.0, 0.1, 0.2, 1.3))
    mesh = replace(scene.mesh, vertices=scene.mesh.vertices * scale)
    scaled = body(mesh, grey(8.0 / scale, 0.1 / scale, 0.2, 1.3))
    first, second = walked(scene, 4000)[0], walked(scaled, 4000)[0]
    assert np.mean(first.fate != second.fate) < 2e-3  # rounding sends a few another way
    assert np.mean(first.face != second.face) < 5e-3


def test_open_and_reversed_meshes_are_refused() -> None:
    scene = ball(grey(1.0, 1.0))
    for faces in (scene.mesh.faces[1:], scene.mesh.faces[:, ::-1]):
        broken = replace(scene, mesh=Mesh(scene.mesh.vertices, faces, np.zeros(len(faces), int)))
        with pytest.raises(
            SceneError, match="material 'm' of scene 'body' holds a medium, but its faces do not enclose"
        ):
            prt.plan(broken)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: grey(-1.0, 1.0), "scattering"),
        (lambda: grey(float("nan"), 1.0), "scattering"),
        (lambda: grey(0.0, 0.0), "neither scatters nor absorbs"),
        (lambda: grey(1.0, 1.0, 1.0), "anisotropy 1.0"),
        (lambda: grey(1.0, 1.0, 0.0, 0.9), "ior 0.9"),
        (lambda: Subsurface.of_albedo((1.1, 1, 1), (1, 1, 1)), "albedo"),
        (lambda: Subsurface.of_albedo((1, 1, 1), (0, 1, 1)), "mean free path"),
        (lambda: Material("m", (0.5, 0.5, 0.5), subsurface=grey(1.0, 1.0)), "whose boundary reflects 0.000"),
        (lambda: Material("m", BLACK, two_sided=True, subsurface=grey(1.0, 1.0)), "two-sided and holds a medium"),
        (
            lambda: Material("m", BLACK, glossy=Glossy((0.2, 0.2, 0.2), 20.0), subsurface=grey(1, 1)),
            "keep albedo and specular together",
        ),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        make()


def test_of_albedo_gives_the_albedo_and_free_path() -> None:
    medium = Subsurface.of_albedo((0.9, 0.5, 0.0), (0.1, 0.2, 0.5))
    np.testing.assert_allclose(medium.albedo, (0.9, 0.5, 0.0))
    np.testing.assert_allclose(1.0 / medium.extinction, (0.1, 0.2, 0.5))
    assert not medium.grey
