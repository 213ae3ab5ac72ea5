"""Transfer at vertices or in a texture, on coarse and fine meshes of the same surfaces: error, frame time and memory.

`sh-vertex` and `sh-texture` of one order on each mesh: relative RMSE of all light on held-out environment maps, time of a frame
in the OpenGL runtime (both assets of a scene in interleaved rounds; scenes one after the other), and memory in the runtime,
with a transfer vector for each colour channel. A second table computes what the same counts would take as the source paper
stores them, floats of one channel: a vector of K or a matrix of K × K at every vertex, or in every texel of a 1024² map.

Draws the floor under the table of `room` under one directional light, with both ways of storage on both meshes.

    python experiments/vertex_or_texture.py [--scenes room room-fine …] [--order 5] [--rounds 15] [--size 640 480] [--data DIR]
"""

from tempfile import TemporaryDirectory

from _frames import SIZE, Row, arguments, draw, ship, table

import prt_bench as prt
from data_gen.fetch import MESHES
from prt_bench.assets import RuntimeAsset
from prt_bench.evaluate import errors
from prt_bench.metrics import relative_norm
from prt_bench.runtime.runtime import Runtime
from prt_bench.runtime.timing import time_assets
from prt_bench.store import data_folder

MAP = 1024
SHADOW = prt.Camera((0.5, 1.75, 2.0), (0.02, 0.0, 0.05), fov_y=37.0)
"""Over the table's top down to the floor beside and under it."""
LIGHT = prt.DirectionalLight((-0.6, -1.0, -0.25), (3.0, 2.9, 2.7))
PAPER = {
    "Room": (21_000, 2433, 568, "2.5 MB, 64 MB", "100 MB, 2.5 GB"),
    "Plants": (18_000, 2598, 168, "2.5 MB, 64 MB", None),
    "Dragon": (1_300_000, 41, 151, "215.8 MB, 5.2 GB", None),
    "TRM": (441_000, 116, 203, "139.3 MB, 2.3 GB", None),
}
"""Triangles, frames per second with vertices and with a texture (glossy, fixed light; RTX 3090, 1080p), and memory of K and
K × K floats at vertices and in a texture."""


def main() -> None:
    parser = arguments(
        __doc__,
        "vertex_or_texture.webp",
        scenes=["room", "room-fine", "objects", "objects-fine", "plants", "plants-fine", "bunny-coarse", "bunny"],
        order=5,
        texels=128,
        rays=256,
        rounds=15,
        size=[640, 480],
    )
    settings = parser.parse_args()
    names = [name for name in settings.scenes if not name.startswith("bunny") or MESHES["bunny"].intact]
    lines, sizes, rows, device = [], [], [], ""
    for name in names:
        ds = prt.bake(
            prt.load_scene(name), "environment", 2, settings.texels, settings.rays, 16, seed=0, vertices=True,
            out=settings.data or data_folder(),
        )  # fmt: skip
        runtime = Runtime(ds, tuple(settings.size))
        device = f"{runtime.device}, {runtime.size[0]} × {runtime.size[1]} pixels, medians of {settings.rounds} rounds"
        with TemporaryDirectory() as folder:
            methods = {kind: prt.method(f"sh-{kind}", order=settings.order) for kind in ("vertex", "texture")}
            assets = ship(methods, ds, folder)
            lines.append(study(ds, runtime, assets, settings.rounds))
            if name in ("room", "room-fine"):
                rows.append(shadow(ds, assets))
        sizes.append(memory(ds, settings.order))
        print(f"{name} done", flush=True)
    print(f"\n{device}; {settings.texels}² texels, order {settings.order}\n")
    table(("scene", "triangles", "vertices", "error at vertices", "in a texture", "ms at vertices", "in a texture",
           "texture over vertices", "MB at vertices", "in a texture"), lines)  # fmt: skip
    print("\nthe paper, frames per second and their ratio:\n")
    table(("scene", "triangles", "at vertices", "in a texture", "vertices over texture"),
          [(name, *row[:3], row[1] / row[2]) for name, row in PAPER.items()])  # fmt: skip
    print(f"\nfloats of one channel, MiB; K = {settings.order**2}\n")
    table(("scene", "vertices, K", "vertices, K × K", "1024² texels, K", "1024² texels, K × K"), sizes)
    table(("paper's scene", "vertices, K and K × K", "1024² texels, K and K × K"),
          [(name, *row[3:]) for name, row in PAPER.items()])  # fmt: skip
    if rows:
        draw(settings.out, rows)


def study(ds: prt.LightingDataset, runtime: Runtime, assets: dict[str, RuntimeAsset], rounds: int) -> list:
    """The line of one scene."""
    test = ds.split("test")
    loaded = {kind: runtime.load(asset) for kind, asset in assets.items()}
    timings = time_assets(loaded, test.lightings[0], rounds)
    milliseconds = {kind: timing[-1].stages["frame"].median for kind, timing in timings.items()}
    return [
        ds.scene.name, len(ds.scene.mesh.faces), runtime.mesh_vertices,
        *(errors(None, test, asset).total for asset in assets.values()),
        *(f"{value:.1f}" for value in milliseconds.values()), milliseconds["texture"] / milliseconds["vertex"],
        *(f"{asset.bytes / 1e6:.2f}" for asset in loaded.values()),
    ]  # fmt: skip


def memory(ds: prt.LightingDataset, order: int) -> list:
    """What one channel takes in float32, in MiB: at the scene's vertices and in every texel of a large map."""
    vertices = ds.transport.vertices
    assert vertices is not None
    values = (4.0 * count * size / 2**20 for count in (len(vertices.points), MAP**2) for size in (order**2, order**4))
    return [ds.scene.name, *(f"{value:.1f}" for value in values)]


def shadow(ds: prt.LightingDataset, assets: dict[str, RuntimeAsset]) -> Row:
    """The table's shadow by each asset beside the traced reference; captions are errors of all light on the whole scene."""
    lit = prt.light(ds, [prt.Lighting([LIGHT])])
    whole = lit.direct + lit.indirect
    runtime = Runtime(ds, SIZE, camera=SHADOW)
    frames = {"reference": runtime.frame(lit.lightings[0], runtime.lightmap(lit.indirect[0]))}
    captions = {}
    for kind, asset in assets.items():
        title = {"vertex": "sh-vertex", "texture": "sh-texture"}[kind]
        frames[title] = runtime.frame(lit.lightings[0], runtime.load(asset))
        captions[title] = f"error of all light {relative_norm(asset.predict(lit) - whole, whole)[0]:.1%}"
    return Row(f"{ds.scene.name}: {len(ds.scene.mesh.faces):,} triangles", frames, captions)


if __name__ == "__main__":
    main()
