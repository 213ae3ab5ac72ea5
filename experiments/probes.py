"""A ball that flies through a scene, lit by probes whose light a method predicts from the light that the runtime measures.

`svd-ridge` is fitted twice, to the lightmap and to the receivers of the probes (`Probes.dataset`), and both assets run in one
frame. Prints relative errors on held-out lightings of the lightmap, of the probes' coefficients and of the irradiance that the
ball receives along its way, against probes that were simulated; the largest difference of OpenGL's coefficients from JAX's;
bytes; and milliseconds of the frame without the ball, with the ball, and with a ball under probes that are not predicted
anew. Leaves a picture: the ball at some places, by simulated and by predicted probes.

    python experiments/probes.py [--scene cornell] [--grid 6] [--basis 16] [--texels 64] [--rays 128] [--lightings 128]
        [--rounds 15]
"""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
from _frames import Row, arguments, draw, median_lighting

import prt_bench as prt
from prt_bench.assets import RuntimeAsset
from prt_bench.irradiance_volume import ProbeVolume
from prt_bench.metrics import relative_rmse
from prt_bench.runtime.runtime import Runtime
from prt_bench.scene import Mesh
from prt_bench.timing import interleaved

ALBEDO = (0.8, 0.8, 0.8)
SIZE = (320, 240)
PLACES = 4


def main() -> None:
    parser = arguments(
        __doc__, "probes.webp", scene="cornell", scenario="point", grid=6, basis=16, texels=64, rays=128, lightings=128,
        rounds=15,
    )  # fmt: skip
    chosen = parser.parse_args()
    ds = prt.bake(
        prt.load_scene(chosen.scene), chosen.scenario, chosen.lightings, chosen.texels, chosen.rays, out=chosen.data
    )
    started = time.perf_counter()
    probes = prt.probes(ds, (chosen.grid,) * 3, chosen.rays)
    lit = probes.dataset(ds)
    seconds = time.perf_counter() - started
    method, test = prt.method("svd-ridge", basis=chosen.basis, transfer="per-channel", mean=False), lit.split("test")
    with TemporaryDirectory() as folder:
        room, air = (
            method.fit(part.split("train")).export(Path(folder) / name) for name, part in (("room", ds), ("air", lit))
        )
        truth, predicted = probes.volume(test.indirect), probes.volume(air.predict(test))
        ways = poses(ds.scene.bounds)
        print(f"{chosen.scene}: {len(probes.buried)} probes, {probes.buried.sum()} of them in bodies, in {seconds:.1f} s;"
              f" {method.label}, {len(test.lightings)} held-out lightings")  # fmt: skip
        print(f"relative error: lightmap {relative_rmse(room.predict(ds.split('test')), ds.split('test').indirect):.3f},"
              f" probes {relative_rmse(flat(predicted), flat(truth)):.3f},"
              f" ball {relative_rmse(received(predicted, ways), received(truth, ways)):.3f}")  # fmt: skip
        show(ds, probes.volume, test, room, air, ways, chosen.rounds, chosen.out)


def show(
    ds: prt.LightingDataset, volume: Callable[[np.ndarray], ProbeVolume], test: prt.LightingDataset, room: RuntimeAsset,
    air: RuntimeAsset, ways: list[np.ndarray], rounds: int, out: Path,
) -> None:  # fmt: skip
    """Frames of the lighting with the median error, and what they take."""
    runtime, index = Runtime(ds, SIZE), median_lighting(room, ds.split("test"))
    lights, truth = runtime.light(test.lightings[index]), volume(test.indirect[index : index + 1])
    loaded = runtime.load(room)
    made = trimesh.creation.icosphere(subdivisions=4, radius=0.06 * ds.scene.extent)
    ball = Mesh(made.vertices, made.faces, np.zeros(len(made.faces), int))
    fixed, moving = (runtime.probes(truth, asset) for asset in (None, air))
    bodies = {"simulated": runtime.body(ball, ALBEDO, fixed), "predicted": runtime.body(ball, ALBEDO, moving)}

    expected = np.asarray(volume(air.predict(test)[index : index + 1]).coefficients[0])
    off = np.abs(moving.predict(np.asarray(test.measured[index])) - expected).max() / np.abs(expected).max()
    print(f"OpenGL against JAX: {off:.1e} of the largest coefficient; probes take {moving.bytes / 1e6:.2f} MB")

    def clock(bodies: list) -> float:
        started = time.perf_counter()
        runtime.draw(lights, loaded, bodies=bodies)
        runtime.context.finish()
        return (time.perf_counter() - started) * 1e3

    for body in bodies.values():
        body.move(ways[1])
    kinds = {"no ball": [], "ball, probes kept": [bodies["simulated"]], "ball, probes predicted": [bodies["predicted"]]}
    found = interleaved(kinds, clock, rounds, 2)
    print(f"frame, {SIZE[0]} × {SIZE[1]} pixels on {runtime.device}: "
          + ", ".join(f"{name} {stage.median:.1f} ms" for name, stage in found.items()))  # fmt: skip

    rows = []
    for name, body in bodies.items():
        frames = {}
        for place, pose in enumerate(ways):
            body.move(pose)
            frames[f"place {place + 1}"] = runtime.frame(lights, loaded, bodies=[body])
        rows.append(Row(f"{name} probes", frames, {}))
    draw(out, rows, lambda title: "place 1")


def poses(bounds: np.ndarray) -> list[np.ndarray]:
    """Where the ball is: from side to side through the air of the scene, in its front half, up and down."""
    found = []
    for step in np.linspace(0.0, 1.0, PLACES):
        pose = np.eye(4)
        share = np.array([0.2 + 0.6 * step, 0.5 + 0.25 * np.sin(2.0 * np.pi * step), 0.9])
        pose[:3, 3] = bounds[0] + share * (bounds[1] - bounds[0])
        found.append(pose)
    return found


def received(volume: ProbeVolume, ways: list[np.ndarray]) -> np.ndarray:
    """Irradiance [N, places · faces, 3] around the middles of the ball's places."""
    normal = np.asarray(trimesh.creation.icosphere(subdivisions=1).face_normals)
    place = np.repeat(np.stack([pose[:3, 3] for pose in ways]), len(normal), axis=0)
    return np.asarray(volume.irradiance(place, np.tile(normal, (len(ways), 1))))  # pyright: ignore[reportArgumentType]


def flat(volume: ProbeVolume) -> np.ndarray:
    """Coefficients [N, P · 9, 3]."""
    values = np.asarray(volume.coefficients)
    return values.reshape(len(values), -1, values.shape[-1])


if __name__ == "__main__":
    main()
