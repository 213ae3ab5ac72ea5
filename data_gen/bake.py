"""The bake: plan → trace once → light → dataset.

Two stores result, both named by a hash of everything they depend on: the transport (geometry and rays, shared by all
scenarios of a scene) and the dataset (lightings). Each is written chunk by chunk and resumes after an interruption to the
same bits.
"""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from data_gen.cost import comparison, spent
from data_gen.decisions import Plan
from data_gen.hull import hull_scene, measuring_scene
from data_gen.journal import begun, content_key, create_array, resumable
from data_gen.light import LightPass
from data_gen.plan import HELD_OUT_LEAST, Auto, MeasureOn, plan, with_more_rays
from data_gen.sampling import measurement_points, on_pose
from data_gen.scenarios import check_lightings, sample_lightings
from data_gen.stream import write_streamed
from data_gen.trace import CHUNK, trace, transport_key
from data_gen.tracer import Tracer
from prt_bench.dataset import LightingDataset
from prt_bench.errors import SceneError, SpecError
from prt_bench.lights import EnvironmentLight, Lighting, emitters
from prt_bench.progress import say, track
from prt_bench.scene import Scene
from prt_bench.store import FORMAT, data_folder, write_array, write_points

_VERSION = 2  # raise when the same inputs would give other numbers


def bake(
    scene: Scene,
    scenario: str = "spot",
    lightings: int = 128,
    texels: int = 128,
    rays: int | Auto = 256,
    measurements: int = 256,
    seed: int = 0,
    out: str | Path | None = None,
    workers: int | None = None,
    supersampling: int = 8,
    ood: Sequence[str] = (),
    tolerance: float = 1e-4,
    gather_texels: int | Auto | None = None,
    layout: LightingDataset | None = None,
    streamed: int = 0,
    measure_on: MeasureOn = "surface",
    vertices: bool = False,
    node_rays: int = 0,
    node_tolerance: float = 0.02,
    mips: int = 0,
    texture_set: bool = False,
    noise: float = 0.02,
    gather_tolerance: float = 0.05,
    force: Sequence[str] = (),
) -> LightingDataset:
    """Bake direct and indirect light of `scene` under lightings drawn from `scenario`.

    `texels`: side of the square lightmap; `lightings`: training lightings, with a quarter as many (at least 16) held out as
    "test" and 16 for each out-of-scenario split "ood-<name>" in `ood` (`scenario` itself is left out there); `rays` per
    point; `measurements` points, each the mean of `supersampling` samples. `out` is the folder for both stores (default:
    `data_folder()`). Equal arguments give equal hashes for any number of `workers`, and an existing dataset is opened
    instead of baked.

    `layout` is a dataset of another pose of the same mesh: texels and measurement points keep its places on the surface, so
    that one model can serve both (`bake_animation` does this for a sequence of poses).

    `streamed` more lightings of the scenario are kept as direct light alone (`LightingDataset.streamed`), for methods that
    learn from thousands of lightings through the traced operator.

    Direct light is measured on the surface, or, with `measure_on` "hull", around the bodies (see `hull_scene`).

    With `vertices` the mesh's vertices are traced too, for methods that store transfer there.

    With `node_rays` receivers are traced where they are needed, by so many rays each, and interpolated between where the
    operator is smooth: where that misses by no more than `node_tolerance` of what is seen (`data_gen.nodes`). Direct light
    is computed everywhere, and gather samples keep `rays`. It pays on large lightmaps of large faces, not on curved meshes,
    each of whose faces is refined on its own.

    `mips` levels of the lightmap can be halved for frames seen from afar, which takes texels from between charts; in a
    `texture_set` every material has a square of the lightmap, all of one size (`data_gen.atlas`).

    Raises `SpecError`, `SceneError`, `LightError` or `DatasetError` for what the user can mend.
    """
    started = time.perf_counter()
    if seed < 0:
        raise SpecError(f"seed is {seed}, but must not be negative")
    ood = tuple(name for name in dict.fromkeys(ood) if name != scenario)
    settings = plan(
        scene,
        scenario,
        lightings,
        texels,
        rays,
        measurements,
        supersampling,
        tolerance,
        gather_texels,
        ood,
        workers,
        streamed,
        measure_on,
        vertices,
        node_rays,
        node_tolerance,
        mips,
        texture_set,
        noise,
        gather_tolerance,
        force,
        seed,
        out,
    )
    if layout is not None and scene.strands is not None:
        raise SpecError(f"scene '{scene.name}' has hair, whose texels do not keep their places in other poses")
    if layout is not None:
        if "hull" in (measure_on, layout.metadata.get("measure_on")):
            raise SpecError("a hull has no places that another pose could keep; measure poses on the surface")
        shared = {"texels": texels, "measurements": measurements, "supersampling": supersampling}
        _check_layout(scene, layout, {**shared, "mips": mips, "texture_set": texture_set})
    asked = {
        **({} if layout is None else {"layout": layout.hash}),
        "camera": vars(scene.camera),
        "scenario": scenario,
        "lightings": lightings,
        **({"streamed": streamed} if streamed else {}),
        **({} if measure_on == "surface" else {"measure_on": measure_on}),
        "measurements": measurements,
        "supersampling": supersampling,
        "ood": list(ood),
        "tolerance": tolerance,
        "seed": seed,
        **({"force": list(settings.force)} if settings.force else {}),
        **({"noise": noise} if settings.noise else {}),
    }
    planned = time.perf_counter() - started
    while True:
        ds = _bake(scene, settings, asked, layout, Path(out) if out is not None else data_folder(), workers, planned)
        floor = ds.split("test").noise_floor if settings.noise else 0.0
        if floor <= settings.noise:
            return ds
        settings = with_more_rays(settings, scene, floor)
        say(f"{scene.name}: noise {floor:.2%} where {noise:.2%} was asked for; {settings.rays} rays per point")


def _bake(
    scene: Scene,
    settings: Plan,
    asked: Mapping[str, Any],
    layout: LightingDataset | None,
    folder: Path,
    workers: int | None,
    planned: float,
) -> LightingDataset:
    """Trace and light what `settings` decided and `asked` says, which names the store; `planned` seconds came before."""
    started = time.perf_counter()
    scenario, lightings, seed = asked["scenario"], asked["lightings"], asked["seed"]
    measurements, supersampling = asked["measurements"], asked["supersampling"]
    streamed, measure_on = asked.get("streamed", 0), asked.get("measure_on", "surface")
    atlas = None if layout is None else layout.transport
    key = transport_key(scene, settings, seed, atlas)
    about = {"version": _VERSION, "format": FORMAT, "transport": key, **asked}
    path = folder / f"dataset-{scene.name}-{scenario}-{content_key(about)}.zarr"
    tracer = Tracer(scene, workers)
    if path.is_dir():
        trace(scene, settings, seed, folder, tracer, atlas)  # there already, unless someone took it away
        return LightingDataset.open(path)

    # What may be refused comes before the rays.
    lights, splits = _draw(scene, scenario, lightings, asked["ood"], seed, tracer)
    further = sample_lightings(scene, scenario, streamed, [seed, 2], tracer) if streamed else ()
    if layout is None:
        place = hull_scene(scene, tracer) if measure_on == "hull" else measuring_scene(scene, tracer)
        points = measurement_points(place, measurements, supersampling, seed, tracer)
    else:
        points = (on_pose(scene, layout.measurement_points), on_pose(scene, layout.dense_points), layout.groups)
    store = folder / f"transport-{scene.name}-{key}.zarr"
    before = {"traced_before": store.is_dir(), "resumed": begun(store) or begun(path)}
    tracing, cast = time.perf_counter(), (tracer.nearest, tracer.shadow)
    transport = trace(scene, settings, seed, folder, tracer, atlas)
    traced, gather_rays = time.perf_counter() - tracing, tracer.nearest - cast[0]
    light = LightPass(transport, tracer, emitters(lights), settings)
    columns = len(lights) * light.channels
    needed = 4 * len(transport.receivers) * columns * 2.25 + 4 * streamed * (len(transport.samples) + measurements)
    with resumable(path, int(1.1 * needed)) as (partial, journal):
        group = zarr.open_group(partial, mode="a")
        arrays = _create(group, light, splits["train"][1], len(transport.receivers))
        chunks = [slice(at, at + CHUNK) for at in range(0, len(transport.receivers), CHUNK)]
        missing = [(i, rows) for i, rows in enumerate(chunks) if i not in journal.done]
        for index, rows in track(missing, f"light {scene.name} ({scenario})"):
            result = light.receive(rows)
            held_out = result.half[splits["train"][1] :]
            for name, values in (("direct", result.direct), ("indirect", result.indirect), ("indirect_half", held_out)):
                arrays[name][:, rows] = values
            digest = hashlib.sha256(result.direct.tobytes() + result.indirect.tobytes()).hexdigest()
            journal.add(index, digest=digest, squares=result.squares.tolist())
        squares = np.sum([journal.done[i]["squares"] for i in range(len(chunks))], axis=0)
        measured = light.measured(*points[1:])
        digests = [journal.done[i]["digest"] for i in range(len(chunks))]
        if further:
            digests += write_streamed(group, journal, further, transport, tracer, settings, *points[1:])
        for name, values in (("measured", measured), ("noise", _relative(squares)), ("groups", points[2])):
            write_array(group, name, values)
        write_points(group, "measurement_points", points[0])
        write_points(group, "dense_points", points[1])
        _write_lightings(group, lights)
        seconds = time.perf_counter() - started
        metadata = {
            **about,
            "scene": scene.name,
            "transport": store.name,
            "splits": splits,
            "held_out": splits["train"][1],
            "channels": light.channels,
            "texels": settings.texels,
            "gather_texels": settings.gather_texels,
            "rays": settings.rays,
            **(
                {"node_rays": settings.node_rays, "node_tolerance": settings.node_tolerance}
                if settings.node_rays
                else {}
            ),
            **({"gather_tolerance": settings.gather_tolerance} if settings.gather_tolerance else {}),
            **({"mips": settings.mips} if settings.mips else {}),
            **({"texture_set": True} if settings.texture_set else {}),
            "bounces": transport.bounces,
            "effects": list(settings.effects),
            "plan": settings.to_json(),
            "predicted": vars(settings.cost),
            "actual": {**spent(gather_rays, tracer.shadow - cast[1], (partial, store), seconds), **before},
            "seconds": {"plan": planned, "trace": traced, "light": seconds - traced},
            "hash": hashlib.sha256(("".join(digests) + _digest(measured)).encode()).hexdigest(),
        }
        group.attrs.update({"kind": "dataset", "format": FORMAT, "metadata": json.dumps(metadata)})
    say(f"baked {scene.name} ({scenario}): {len(lights)} lightings in {planned + seconds:.1f} s")
    say(comparison(metadata["predicted"], metadata["actual"]))
    return LightingDataset.open(path)


def light(ds: LightingDataset, lightings: Sequence[Lighting], workers: int | None = None) -> LightingDataset:
    """Light a baked scene anew: a dataset in memory with direct and indirect light of `lightings`, as its "test" split.

    Uses the traced operator; only shadow rays are traced. Raises `LightError` for lights inside the geometry.
    """
    lights = tuple(lightings)
    if not lights:
        raise SpecError("there is no lighting to light the scene with; give at least one prt.Lighting")
    tracer = Tracer(ds.scene, workers)
    check_lightings(ds.scene, lights, tracer)
    settings = plan(
        ds.scene,
        texels=ds.metadata["texels"],
        rays=ds.metadata["rays"],
        tolerance=ds.metadata["tolerance"],
        force=ds.metadata.get("force", ()),
    )
    passes = LightPass(ds.transport, tracer, emitters(lights), settings)
    parts = [passes.receive(slice(at, at + CHUNK)) for at in range(0, len(ds.points), CHUNK)]
    arrays = {
        "measured": passes.measured(ds.dense_points, ds.groups),
        "direct": np.concatenate([part.direct for part in parts], axis=1),
        "indirect": np.concatenate([part.indirect for part in parts], axis=1),
        "indirect_half": np.concatenate([part.half for part in parts], axis=1),
        "noise": _relative(np.sum([part.squares for part in parts], axis=0)),
    }
    digest = _digest(*(arrays[name] for name in sorted(arrays)))
    metadata = {**ds.metadata, "scenario": "custom", "held_out": 0, "channels": passes.channels, "hash": digest}
    splits = {"test": (0, len(lights))}
    return LightingDataset(
        ds.transport,
        ds.measurement_points,
        ds.dense_points,
        ds.groups,
        lights,
        arrays,
        splits,
        metadata,
        (0, len(lights)),
    )


def _draw(
    scene: Scene, scenario: str, count: int, ood: Sequence[str], seed: int, tracer: Tracer
) -> tuple[tuple[Lighting, ...], dict[str, tuple[int, int]]]:
    """Training, test and out-of-scenario lightings in one sequence, and where each split lies in it."""
    wanted = [("train", scenario, count), ("test", scenario, max(HELD_OUT_LEAST, ceil(count / 4)))]
    wanted += [(f"ood-{name}", name, HELD_OUT_LEAST) for name in ood]
    lights: list[Lighting] = []
    splits = {}
    for split, kind, number in wanted:
        splits[split] = (len(lights), len(lights) + number)
        lights += sample_lightings(scene, kind, number, [seed, int(split != "train")], tracer)
    return tuple(lights), splits


def _check_layout(scene: Scene, layout: LightingDataset, settings: Mapping[str, int]) -> None:
    """Raise `SceneError` or `SpecError` unless `layout` is of another pose of this mesh, with these settings."""
    same = ((mesh.faces, mesh.material) for mesh in (scene.mesh, layout.scene.mesh))
    if not all(np.array_equal(ours, theirs) for ours, theirs in zip(*same, strict=True)):
        raise SceneError(
            f"scene '{scene.name}' is not a pose of the layout's mesh: their faces differ; give every keyframe the same faces"
        )
    for name, value in settings.items():
        kept = layout.metadata.get(name, 0)
        if kept != value:
            raise SpecError(f"{name} is {value}, but the layout has {kept}; all keyframes share them")


def _create(group: zarr.Group, light: LightPass, training: int, receivers: int) -> dict[str, zarr.Array]:
    count, channels = len(light), light.channels
    rows = {"direct": count, "indirect": count, "indirect_half": count - training}
    return {
        name: create_array(group, name, (n, receivers, channels), (n, min(CHUNK, receivers), channels), np.float32)
        for name, n in rows.items()
    }


def _write_lightings(group: zarr.Group, lights: Sequence[Lighting]) -> None:
    maps = {part.map.hash: part.map for item in lights for part in item.lights if isinstance(part, EnvironmentLight)}
    for index, environment in enumerate(maps.values()):
        write_array(group.require_group("environments"), str(index), environment.radiance, name=environment.name)
    group.attrs["lightings"] = json.dumps([[part.to_json() for part in item.lights] for item in lights])


def _relative(squares: np.ndarray) -> np.ndarray:
    """Noise over signal per lighting from sums of squares; 0 for a black lighting."""
    noise, signal = squares
    return np.sqrt(np.divide(noise, signal, out=np.zeros_like(noise), where=signal > 0))


def _digest(*arrays: np.ndarray) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
