"""Environment maps as an axis of difficulty: how much of each is a sun, and what that costs classical transfer.

For each vendored map: the share of its energy that comes from its brightest 0.1, 1 and 10 %, by solid angle; the share
of ∫ L² dω that 3, 5 and 8 bands of spherical harmonics keep; and the error of all light under that map, upright, of
`sh-texture` of those orders, against the bake's light from the same map. Energy and shares are of luminance. The projection
of a map is that of its texels, exactly; both the bake and the method light with its 64 directions.

    python experiments/environments.py [--scenes room suzanne] [--orders 3 5 8] [--texels 128] [--rays 256] [--data DIR]
"""

import numpy as np
from _frames import arguments, table

import prt_bench as prt
from data_gen.assets import environment_maps
from prt_bench.environment import LUMINANCE, EnvironmentMap, texel_directions
from prt_bench.metrics import relative_norm
from prt_bench.spherical import project_environment
from prt_bench.store import data_folder

BRIGHTEST = (1e-3, 1e-2, 1e-1)


def main() -> None:
    parser = arguments(__doc__, None, scenes=["room", "suzanne"], orders=[3, 5, 8], texels=128, rays=256, window="none")
    settings = parser.parse_args()
    maps = {name: EnvironmentMap.read(path) for name, path in environment_maps().items()}
    errors = {}
    for scene in settings.scenes:
        size = {"lightings": 2, "texels": settings.texels, "rays": settings.rays, "measurements": 16}
        ds = prt.bake(prt.load_scene(scene), "environment", **size, out=settings.data or data_folder())
        lit = prt.light(ds, [prt.Lighting([prt.EnvironmentLight(item)]) for item in maps.values()])
        whole = lit.direct + lit.indirect
        for order in settings.orders:
            model = prt.method("sh-texture", order=order, window=settings.window).fit(ds)
            found = np.asarray(model.predict(lit))
            errors[scene, order] = dict(zip(maps, relative_norm(found - whole, whole), strict=True))
    head = (
        "map",
        *(f"brightest {part:.1%}" for part in BRIGHTEST),
        *(f"{order} bands keep" for order in settings.orders),
        *(f"{scene}: order {order}" for scene, order in errors),
    )
    lines = {
        name: (*(brightest(item, part) for part in BRIGHTEST), *(share(item, order) for order in settings.orders))
        for name, item in maps.items()
    }
    names = sorted(lines, key=lambda name: lines[name][0])
    table(
        head,
        [
            (name, *(f"{cell:.1%}" for cell in lines[name]), *(float(e[name]) for e in errors.values()))
            for name in names
        ],
    )
    for (scene, order), found in errors.items():
        rank = np.argsort(np.argsort([found[name] for name in names]))
        print(
            f"rank correlation of sun and error, {scene}, order {order}: {np.corrcoef(range(len(names)), rank)[0, 1]:.2f}"
        )


def brightest(item: EnvironmentMap, part: float) -> float:
    """Share of the energy that comes from the brightest `part` of the sphere; a texel that crosses the limit counts in part."""
    luminance = item.radiance.astype(float) @ LUMINANCE
    solid_angle = np.broadcast_to(texel_directions(*luminance.shape)[1], luminance.shape)
    order = np.argsort(-luminance, axis=None)
    angle = np.cumsum(solid_angle.ravel()[order])
    energy = np.cumsum((luminance * solid_angle).ravel()[order])
    return float(np.interp(part * angle[-1], np.append(0.0, angle), np.append(0.0, energy)) / energy[-1])


def share(item: EnvironmentMap, order: int) -> float:
    """Share of ∫ L² dω in the first bands, of luminance."""
    luminance = (item.radiance.astype(float) @ LUMINANCE)[..., None]
    square = float(np.sum(luminance[..., 0] ** 2 * texel_directions(*luminance.shape[:2])[1]))
    return float(np.sum(np.square(project_environment(luminance, order)))) / square


if __name__ == "__main__":
    main()
