"""Glossy transfer in every pixel: the triple product generated, dense, and with the light fixed (transfer textures, Table 1).

Prints the arithmetic of each way, the milliseconds of their draw passes in interleaved rounds, and how far glossy radiance is
from a path tracer's, by exponent and order: direct light through the lobe at points the camera sees, root mean square over
points and channels relative to that of the reference; K × K is Sloan's matrix in every texel. A last table has the
inter-reflections of fixed light: how far all that points reflect is from the path tracer's light of all bounces. The picture
shows frames by exponent beside the reference's.

    python experiments/triple_products.py [--scenes room objects plants] [--data DIR] [--paths 256] [--size 1920 1080]

Frames larger than 640 × 480 leave the dense product out, which takes 60 times as long as the generated one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from tempfile import TemporaryDirectory

import jax.numpy as jnp
import numpy as np
from _frames import Row, arguments, draw, table

import prt_bench as prt
from data_gen.glossy_reference import reference_radiance
from data_gen.reference_image import reference_image
from data_gen.tracer import Tracer
from prt_bench.glossy import Surface, TripleModel, mirrored
from prt_bench.methods.interreflection import fix_light
from prt_bench.points import SurfacePoints
from prt_bench.runtime.generate import operations
from prt_bench.runtime.glossy import GlossyAsset
from prt_bench.runtime.runtime import Runtime
from prt_bench.runtime.timing import time_assets
from prt_bench.scene import Glossy, Scene
from prt_bench.store import data_folder
from prt_bench.visibility import transfer_matrices

EXPONENTS = (5.0, 20.0, 80.0, 320.0)
ORDERS = (3, 5, 8)
MATRIX = 5
BOUNCES = (0, 1, 2, 3)
POINTS = 300
TIMED = [640, 480]
DRAWN = (240, 180)
TRACED = f"path traced, exponent {EXPONENTS[2]:g}"
_PAPER = {"room": "352 / 2433 to 84 / 568", "plants": "363 / 2598 to 6.7 / 168"}


def main() -> None:
    settings = arguments(
        __doc__,
        "triple_products.webp",
        scenes=["room", "objects", "plants"],
        texels=128,
        paths=256,
        rounds=7,
        size=TIMED,
    ).parse_args()
    costs, errors, lit, pictures = [], [], [], []
    for name in settings.scenes:
        scene = prt.load_scene(name)
        ds = prt.bake(scene, "environment", 4, settings.texels, 256, seed=0, out=settings.data or data_folder())
        test = ds.split("test")
        costs += list(cost(ds, test.lightings[0], settings.rounds, tuple(settings.size)))
        errors += list(accuracy(ds, test.lightings[:4], settings.paths))
        lit += list(reflections(ds, test.lightings[:4], settings.paths))
        pictures.append(picture(ds, test.lightings[0], settings.paths))
    table(("order", "dense", "generated", "share"), [(o, *_counts(o)) for o in (2, 3, 4, 5, 6)])
    print()
    table(("scene", "triangles", "way", "draw ms", "transfer ms", "against generated"), costs)
    print("\npaper, frames per second at 1080p on an RTX 3090, TP / TPFL, vertices to texture:", _PAPER)
    print()
    table(("scene", "exponent", *(f"order {o}" for o in ORDERS), f"K × K, order {MATRIX}", "reference's noise"), errors)
    print()
    table(("scene", *(f"{count} bounces" for count in BOUNCES)), lit)
    draw(settings.out, pictures, lambda title: TRACED)


def _counts(order: int) -> tuple[int, int, float]:
    found = operations(order)
    return found["dense"], found["sparse"], found["sparse"] / found["dense"]


def shiny(ds: prt.LightingDataset, exponent: float) -> prt.LightingDataset:
    """The same bake with a lobe of this exponent on every material; lobes are no part of diffuse transport."""
    return replace(ds, transport=replace(ds.transport, scene=coated(ds.scene, exponent)))


def coated(scene: Scene, exponent: float) -> Scene:
    """Diffuse albedo at 0.7 and a lobe over it."""
    materials = [
        replace(m, albedo=tuple(0.7 * value for value in m.albedo), glossy=Glossy((0.25, 0.25, 0.25), exponent))
        for m in scene.materials
    ]
    return replace(scene, materials=tuple(materials))


def cost(
    ds: prt.LightingDataset, lighting: prt.Lighting, rounds: int, size: tuple[int, int]
) -> Iterator[Sequence[object]]:
    """Draw passes of all ways on one runtime, in interleaved rounds; every pixel has a lobe."""
    coat = shiny(ds, EXPONENTS[1])
    runtime = Runtime(coat, size)
    with TemporaryDirectory() as folder:
        free, fixed = (
            prt.method(name).fit(coat).export(f"{folder}/{name}") for name in ("sh-triple", "sh-triple-fixed")
        )
        diffuse = prt.method("sh-texture").fit(coat).export(f"{folder}/diffuse")
        ways = {
            "diffuse alone": runtime.load(diffuse),
            "generated": runtime.load(free),
            "light fixed": runtime.load(fixed),
        }
        if np.prod(size) <= np.prod(TIMED):
            ways["dense"] = GlossyAsset(runtime, free, dense=True)
        timings = {way: found[0].stages for way, found in time_assets(ways, lighting, rounds).items()}
    base = timings["generated"]["draw"].median
    for way, stages in timings.items():
        milliseconds = stages["draw"].median
        yield ds.scene.name, len(ds.scene.mesh.faces), way, milliseconds, stages["transfer"].median, milliseconds / base


def accuracy(ds: prt.LightingDataset, lightings: Sequence[prt.Lighting], paths: int) -> Iterator[Sequence[object]]:
    """Relative error of the lobe's radiance at receivers that the camera sees."""
    eye = np.asarray(ds.scene.camera.position, float)
    place = seen(ds, eye)
    points = ds.points[place]
    dull = replace(points, albedo=np.zeros_like(points.albedo))  # the lobe alone
    towards = eye - points.position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    mirror = np.asarray(mirrored(towards, points.normal))
    models = [prt.method("sh-triple", order=order, interreflection=False).fit(ds) for order in ORDERS]
    lit = prt.light(ds, lightings)
    matrices = matrices_at(ds, place)
    for exponent in EXPONENTS:
        black = replace(ds.scene, materials=tuple(replace(m, albedo=(0.0, 0.0, 0.0), image=None,
                        glossy=Glossy((1.0, 1.0, 1.0), exponent)) for m in ds.scene.materials))  # fmt: skip
        wanted = [reference_radiance(black, each, dull, towards, paths, 0) for each in lightings]
        reference = np.stack([estimate.mean for estimate in wanted])
        noise = np.stack([estimate.halves[0] - estimate.halves[1] for estimate in wanted]) / 2.0
        size = np.linalg.norm(reference)
        row = []
        for model in models:
            only = type(model)(model.basis[place], model.centre)
            found = only.gloss(jnp.asarray(model.measure(lit)), mirror, np.full(len(place), exponent))
            row.append(float(np.linalg.norm(np.maximum(found, 0.0) - reference) / size))
        row.append(
            float(
                np.linalg.norm(np.maximum(by_matrix(models, matrices, lit, mirror, exponent), 0.0) - reference) / size
            )
        )
        yield ds.scene.name, exponent, *row, float(np.linalg.norm(noise) / size)


def reflections(ds: prt.LightingDataset, lightings: Sequence[prt.Lighting], paths: int) -> Iterator[Sequence[object]]:
    """Relative error of what points reflect towards the camera, by bounces, of a scene whose materials all have a lobe."""
    eye = np.asarray(ds.scene.camera.position, float)
    place = seen(ds, eye)
    coat = shiny(ds, EXPONENTS[1])
    points = dulled(ds.points[place])
    towards = eye - points.position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    surface = Surface(points.normal, points.albedo, *coat.scene.glossy_at(points.face, points.barycentric))
    coat = replace(coat, transport=replace(coat.transport, samples=dulled(ds.transport.samples)))
    wanted = np.stack([reference_radiance(coat.scene, each, points, towards, paths).mean for each in lightings])
    row = []
    for bounces in BOUNCES:
        found = []
        for index, lighting in enumerate(lightings):
            model = fix_light(coat, lighting, 5, max(bounces, 1))
            basis = model.basis[place] if bounces else model.basis[place].at[:, 1:].set(0.0)
            u = model.measure(prt.light(ds, lightings))[index : index + 1]
            found.append(np.asarray(type(model)(basis, model.centre).radiance(u, surface, towards))[0])
        row.append(float(np.linalg.norm(np.stack(found) - wanted) / np.linalg.norm(wanted)))
    yield ds.scene.name, *row


def dulled(points: SurfacePoints) -> SurfacePoints:
    """With the albedo that is left under the lobe of `coated`."""
    return replace(points, albedo=0.7 * points.albedo)


def matrices_at(ds: prt.LightingDataset, place: np.ndarray) -> np.ndarray:
    """Sloan's matrix at some receivers, from the same rays."""
    transport = ds.transport
    escaped = np.asarray(transport.receiver_hits) == len(transport.samples) + 1
    return transfer_matrices(escaped, transport.sampler, 0, ds.points.normal, MATRIX)[place]


def by_matrix(
    models: Sequence[TripleModel], matrices: np.ndarray, lit: prt.LightingDataset, mirror: np.ndarray, exponent: float
) -> np.ndarray:
    """What the lobes reflect with a matrix in every texel, which leaves products uncut."""
    model = models[ORDERS.index(MATRIX)]
    lobe = model.lobe(mirror, np.full(len(mirror), exponent))
    return np.einsum("tk,tkj,njc->ntc", lobe, matrices, model.measure(lit), optimize=True)


def seen(ds: prt.LightingDataset, eye: np.ndarray) -> np.ndarray:
    """Some receivers that nothing hides from the eye, chosen at random."""
    order = np.random.default_rng(0).permutation(len(ds.points))
    points, tracer = ds.points[order], Tracer(ds.scene)
    start = points.position + tracer.offset * points.normal
    faces = np.sum((eye - points.position) * points.normal, axis=1) > 0.05 * np.linalg.norm(
        eye - points.position, axis=1
    )
    clear = ~tracer.occluded(start, eye - start)
    return order[faces & clear & ~ds.transport.buried[order]][:POINTS]


def picture(ds: prt.LightingDataset, lighting: prt.Lighting, paths: int) -> Row:
    """Frames of order 5 by exponent, and a path-traced one of the last but one."""
    frames = {}
    with TemporaryDirectory() as folder:
        for exponent in EXPONENTS[:3]:
            coat = shiny(ds, exponent)
            runtime = Runtime(coat, DRAWN)
            asset = prt.method("sh-triple").fit(coat).export(f"{folder}/{exponent:g}")
            frames[f"order 5, exponent {exponent:g}"] = runtime.frame(lighting, runtime.load(asset))
        traced = reference_image(coat.scene, lighting, DRAWN[1], DRAWN[0], paths)
    frames[f"path traced, exponent {EXPONENTS[2]:g}"] = traced.mean
    return Row(ds.scene.name, frames, dict.fromkeys(frames, ""))


if __name__ == "__main__":
    main()
