"""What a scene calls for, decided before anything is simulated: each decision with its reason, and the predicted cost.

Most is read off the scene. What is not, rays per point for a noise and gather texels for an error, is measured on a part of the
bake where that is asked for (`data_gen.pilot`).
"""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, log
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from data_gen.atlas import check_mips, padding
from data_gen.cost import predict
from data_gen.decisions import FULL_TAIL, Cost, Decision, Plan, forced
from data_gen.effects import hair
from data_gen.effects.subsurface import media, predicted_events
from data_gen.hull import check_hull
from data_gen.pilot import MOST_RAYS, Pilot, unattainable
from data_gen.sampling import check_measurements
from data_gen.scenarios import check_scenario, sample_lightings
from data_gen.tracer import Tracer
from prt_bench.errors import SpecError
from prt_bench.scene import Scene
from prt_bench.store import data_folder

MOST_BOUNCES = 256
MeasureOn = Literal["surface", "hull"]
Auto = Literal["auto"]
HELD_OUT_LEAST = 16
"""Lightings held out for a bake's test at least."""
_GATHER_TEXELS = 256


def plan(
    scene: Scene,
    scenario: str = "spot",
    lightings: int = 128,
    texels: int = 128,
    rays: int | Auto = 256,
    measurements: int = 256,
    supersampling: int = 8,
    tolerance: float = 1e-4,
    gather_texels: int | Auto | None = None,
    ood: tuple[str, ...] = (),
    workers: int | None = None,
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
    seed: int = 0,
    out: str | Path | None = None,
) -> Plan:
    """Decide what baking `scene` needs.

    `tolerance` bounds the light that truncating the bounces leaves out, relative to the brightest direct light; `node_rays`,
    `node_tolerance`, `mips`, `texture_set`, `noise`, `gather_tolerance` and `force` are those of `bake`. With `rays` or
    `gather_texels` "auto" a part of the bake of `seed` is traced, in seconds; `out` keeps the charts, as for `bake`. Raises
    `SpecError` for settings that cannot be baked and `SceneError` for more measurement points than the surface can hold,
    or for a hull where there is no body.
    """
    for name, value, least in (("lightings", lightings, 1), ("texels", texels, 8), ("gather_texels", gather_texels, 8),
                               ("measurements", measurements, 1), ("supersampling", supersampling, 1),
                               ("workers", workers, 1), ("streamed", streamed, 0)):  # fmt: skip
        if value is not None and _number(name, value) < least:
            raise SpecError(f"{name} is {value}, but a bake needs at least {least}")
    for name in (scenario, *ood):
        check_scenario(name)
    check_measurements(scene, measurements, supersampling)
    if measure_on not in get_args(MeasureOn):
        raise SpecError(f"measure_on must be {' or '.join(map(repr, get_args(MeasureOn)))}, not {measure_on!r}")
    if measure_on == "hull":
        check_hull(scene)
    for name, value, least in (("rays", rays, 2), ("node_rays", node_rays, 0)):
        if _number(name, value) < least or _number(name, value) % 2:
            raise SpecError(
                f"{name} is {value}, but it must be an even number from {least} up: the two halves measure the noise"
            )
    for name, value in (("tolerance", tolerance), ("node_tolerance", node_tolerance), ("noise", noise),
                        ("gather_tolerance", gather_tolerance)):  # fmt: skip
        if not 0 < value < 1:
            raise SpecError(f"{name} is {value}, but it must lie between 0 and 1")

    check_mips(texels, mips)

    force = forced(force)
    convex, bodies = _convexity(scene), media(scene)
    channels = 3 if "channels" in force or not scene.achromatic else 1
    every, asked_nodes = "bounces" in force, node_rays
    node_rays = 0 if "receivers" in force else node_rays
    bounces, bounce_reason = _bounces(
        scene.largest_albedo, FULL_TAIL if every else tolerance, None if every else convex
    )
    draft = Plan(
        texels, texels, 2, bounces, tolerance, channels, convex, _effects(scene, bodies), vertices,
        (), Cost(0, 0, 0, 0, 0.0),
        node_rays, node_tolerance, mips, texture_set, force, noise if rays == "auto" else 0.0,
    )  # fmt: skip
    if scene.strands is not None:
        hair.check_hair(scene, texels, gather_texels, rays, vertices, node_rays)
        gather_texels = texels
    held_out = max(HELD_OUT_LEAST, ceil(lightings / 4))
    pilot = _Measured(scene, scenario, held_out, seed, Path(out) if out is not None else data_folder(), workers)
    gather, gather_reason = pilot.gather_texels(draft, gather_texels, gather_tolerance)
    if node_rays and gather == texels:
        raise SpecError(
            f"node_rays is {node_rays}, but at {texels}² texels the receivers are the gather samples, which are all traced;"
            " leave it out, or ask for fewer gather_texels"
        )
    draft = replace(draft, gather_texels=gather, gather_tolerance=gather_tolerance if gather < texels else 0.0)
    rays, ray_reason = pilot.rays(draft, rays, noise)
    decisions = (
        Decision("effects", ", ".join(("diffuse", *_effects(scene, bodies))), "strands grow in the scene")
        if scene.strands is not None
        else Decision("effects", "diffuse, subsurface", f"{_names(scene, bodies)} filled with a medium")
        if bodies
        else Decision(
            "effects",
            "diffuse",
            "lobes towards the eye take no part in it" if scene.glossy else "no material asks for more",
        ),
        Decision(
            "channels", str(channels), "every albedo is grey" if scene.achromatic else "albedo differs by channel"
        ),
        Decision("bounces", f"≤ {bounces}", bounce_reason),
        Decision(
            "shadow rays",
            {"outside": "none", "inside": "only for lights outside", None: "yes"}[convex],
            {
                "outside": "a lone convex body cannot shadow itself",
                "inside": "nothing stands between points of a convex room",
                None: "surfaces can occlude each other",
            }[convex],
        ),
        Decision("view dependence", "in the runtime", "materials have glossy lobes, which sh-triple shows")
        if scene.glossy
        else Decision("view dependence", "none", "every material is diffuse"),
        Decision("gather samples", f"{gather}² texels", gather_reason),
        Decision("rays per point", str(rays), ray_reason),
        Decision(
            "receivers",
            f"{node_rays} rays, at nodes",
            f"as asked: light between them is interpolated where that misses by less than {node_tolerance:.1%}",
        )
        if node_rays
        else Decision(
            "receivers",
            "all traced",
            f"forced: {asked_nodes} rays at nodes were asked for"
            if asked_nodes
            else "interpolation of smooth light was not asked for (node_rays)",
        ),
    )
    if bodies:
        walks = f"{rays} walks per point" + ("" if channels == 1 else " and channel")
        worst = max(predicted_events(scene, index) for index in bodies)
        decisions += (
            Decision("subsurface", walks, f"at most {worst:.0f} events each on average, by the bodies' size"),
        )
    if scene.strands is not None:
        decisions += (Decision(*hair.decision(scene, rays)),)
    if vertices:
        decisions += (Decision("vertices", "traced", "as asked, for transfer that is stored there"),)
    if mips:
        decisions += (Decision("mip levels", str(mips), f"as asked: charts lie {padding(mips)} texels apart"),)
    if texture_set:
        decisions += (Decision("lightmap", "a texture set", "as asked: every material has a square of its own"),)
    draft = _overruled(replace(draft, rays=rays, decisions=decisions), scene)
    count = lightings + held_out + HELD_OUT_LEAST * len(ood)
    dense = measurements * supersampling
    return replace(draft, cost=predict(draft, scene, scenario, count, dense, workers, streamed))


def with_more_rays(settings: Plan, scene: Scene, left: float) -> Plan:
    """Twice the rays, where the bake had more noise `left` than it was asked for. Raises `SpecError` at `MOST_RAYS`."""
    if 2 * settings.rays > MOST_RAYS:
        raise unattainable(scene, settings.noise, settings.rays, left)
    why = f"{settings.rays} left {left:.1%} between their halves; asked for {settings.noise:.1%}"
    rays = 2 * settings.rays
    cost = replace(settings.cost, gather_rays=2 * settings.cost.gather_rays, seconds=2 * settings.cost.seconds)
    return replace(settings, rays=rays, cost=cost).decided("rays per point", str(rays), why)


class _Measured(NamedTuple):
    """Settings that may be "auto", and why they are what they are."""

    scene: Scene
    scenario: str
    held_out: int
    seed: int
    folder: Path
    workers: int | None

    def rays(self, draft: Plan, asked: int | Auto, noise: float) -> tuple[int, str]:
        """Rays per point of the bake that `draft` describes."""
        if asked != "auto":
            return asked, "as asked; the noise is measured from their two halves"
        if draft.node_rays:
            raise SpecError(
                'rays is "auto", but receivers have the rays of node_rays; give rays a number, or drop node_rays'
            )
        count, found = self._pilot(draft).rays(noise)
        fewer = f", {found[-2][0]} by {found[-2][1]:.1%}" if len(found) > 1 else ""
        return count, f"their halves differ by {found[-1][1]:.1%} on some receivers{fewer}; asked for {noise:.1%}"

    def gather_texels(self, draft: Plan, asked: int | Auto | None, tolerance: float) -> tuple[int, str]:
        """Side of the gather lightmap."""
        themselves = "the receivers themselves"
        if "gather samples" in draft.force:
            return draft.texels, f"forced: {themselves}"
        if asked != "auto":
            side = min(draft.texels, asked or _GATHER_TEXELS)
            carried = "bounced light is smooth: a coarser lightmap carries it"
            return side, themselves if side == draft.texels else carried
        if draft.effects:
            return draft.texels, f"{themselves}: light also enters media, whose smoothness is not measured"
        side, error = self._pilot(draft).gather_texels(tolerance)
        if side == draft.texels:
            return side, f"{themselves}: every coarser lightmap misses more than {tolerance:.1%} of light bounced once"
        return side, f"light bounced once is off by {error:.1%} on some receivers; asked for {tolerance:.1%}"

    def _pilot(self, draft: Plan) -> Pilot:
        tracer = Tracer(self.scene, self.workers)
        lightings = sample_lightings(self.scene, self.scenario, self.held_out, [self.seed, 1], tracer)
        return Pilot(self.scene, draft, lightings, self.seed, self.folder, tracer)


def _overruled(draft: Plan, scene: Scene) -> Plan:
    """The plan with what was forced and would have been left out."""
    if "subsurface" in draft.force and "subsurface" not in draft.effects:
        why = "forced: no material asks for it"
        walks = Decision("subsurface", "walks from 0 points", why)
        draft = replace(draft, effects=("subsurface", *draft.effects), decisions=(*draft.decisions, walks))
        draft = draft.decided("effects", ", ".join(("diffuse", *draft.effects)), why)
    if "channels" in draft.force and scene.achromatic:
        draft = draft.decided("channels", "3", "forced: every albedo is grey")
    if "bounces" in draft.force:
        draft = draft.decided("bounces", f"≤ {draft.bounces}", "forced: all that float32 can tell apart")
    if "shadow rays" in draft.force and draft.convex:
        draft = draft.decided("shadow rays", "yes", "forced: nothing can stand between points of a convex scene")
    return draft


def _effects(scene: Scene, bodies: list[int]) -> tuple[str, ...]:
    """What materials call for beyond diffuse reflection."""
    return ("subsurface",) * bool(bodies) + ("hair",) * (scene.strands is not None)


def _names(scene: Scene, indices: list[int]) -> str:
    """Materials as the subject of a sentence."""
    names = [f"'{scene.materials[index].name}'" for index in indices]
    return f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'}"


def _bounces(albedo: float, tolerance: float, convex: str | None) -> tuple[int, str]:
    """Bounces after which the geometric tail ρ^k / (1 − ρ) is under the tolerance; one where no surface sees another."""
    if convex == "outside":
        return 1, "a lone convex body sees no surface; one gather shows that it is black"
    if albedo <= 0:
        return 1, "every surface is black"
    if albedo >= 1:
        return MOST_BOUNCES, "albedo 1 gives no bound; the traced operator must show that light escapes"
    bound = ceil(log(tolerance * (1 - albedo)) / log(albedo))
    if bound > MOST_BOUNCES:
        return MOST_BOUNCES, f"albedo {albedo:.3f} would need {bound}; the traced operator must show that fewer do"
    return max(bound, 1), f"largest albedo {albedo:.3f} leaves less than {tolerance:g} after that; tracing lowers it"


def _convexity(scene: Scene) -> str | None:
    """ "outside" when every vertex lies behind every face, "inside" when in front of every face, None otherwise."""
    slack = 1e-6 * scene.extent
    behind = in_front = True
    normals, corners = scene.mesh.normals, scene.mesh.triangles[:, 0]
    for start in range(0, len(normals), 16):
        part = slice(start, start + 16)
        height = normals[part] @ scene.mesh.vertices.T - np.sum(normals[part] * corners[part], axis=1)[:, None]
        behind &= bool(np.all(height <= slack))
        in_front &= bool(np.all(height >= -slack))
        if not (behind or in_front):
            return None
    if behind and in_front:
        return None  # flat
    return "outside" if behind else "inside"


def _number(name: str, value: int | str) -> int:
    """The value of a setting, or one that passes every check where it is to be measured. Raises `SpecError` for words."""
    automatic = name in ("rays", "gather_texels")
    if value == "auto" and automatic:
        return 1 << 10
    if isinstance(value, str):
        raise SpecError(f"{name} is '{value}', but must be a number" + " or 'auto'" * automatic)
    return value
