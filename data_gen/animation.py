"""Baking an animation: every keyframe is traced once and lit by lightings of its own, at points that move with the surface."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from data_gen.bake import bake
from prt_bench.clip import Clip
from prt_bench.dataset import LightingDataset
from prt_bench.errors import SpecError
from prt_bench.scene import Scene


def keyframe_times(count: int, seed: int = 0) -> Float[np.ndarray, " keyframes"]:
    """`count` random times in [0, 1), one in each of as many equal intervals, ascending."""
    if count < 1:
        raise SpecError(f"{count} keyframes were asked for, but an animation has at least 1")
    return (np.arange(count) + np.random.default_rng(seed).random(count)) / count


def bake_animation(
    keyframes: Sequence[Scene],
    scenario: str = "spot",
    lightings: int = 32,
    seed: int = 0,
    layout: LightingDataset | None = None,
    **settings: Any,
) -> Clip:
    """Bake poses of one mesh, as `prt.bake` does each, and return them as a clip.

    Every keyframe has `lightings` training lightings and as many held-out ones as `bake` gives, none shared with another
    keyframe. Texels and measurement points keep the places on the surface that they have on `layout`, by default the first
    keyframe; give a keyframe of an earlier clip to bake poses that its models are to serve. `settings` are those of `bake`.
    Raises what `bake` raises, and `SpecError` when there is no keyframe.
    """
    if not keyframes:
        raise SpecError("there is no keyframe to bake; give at least one scene")
    baked: list[LightingDataset] = []
    for index, scene in enumerate(keyframes):
        own_seed = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
        home = layout if layout is not None or not baked else baked[0]
        baked.append(bake(scene, scenario, lightings, seed=own_seed, layout=home, **settings))
    return Clip(tuple(baked))
