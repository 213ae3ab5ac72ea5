"""Tables of walks through translucent bodies and of paths among strands, as a transport keeps them beside its hit tables.

Tracing them is left to `data_gen/effects/subsurface.py` and `hair.py`, applying them to `prt_bench.transport.Scattering`.
"""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import zarr
from jaxtyping import Float, Int

from prt_bench.scene import Scene
from prt_bench.store import member
from prt_bench.transport import GatherOperator, Scattering


class WalkTable(NamedTuple):
    """Where walks from the translucent ones of some points, `rows` [p], left the body: `ends` [p, D, W] samples, or S for none.
    D is 1 for grey media, otherwise one for each channel. `material` [p] is that of the body, or of the strand.

    Where there are strands, each half of the walks is a row of its own, with the `scale` [p, D, 2] of `Scattering`."""

    rows: Int[np.ndarray, " p"]
    material: Int[np.ndarray, " p"]
    ends: Int[np.ndarray, "p D W"] | zarr.Array
    scale: Float[np.ndarray, "p D 2"] | None = None

    def scattering(
        self,
        samples: int,
        colour: Float[np.ndarray, "materials 3"],
        among: slice = slice(None),
        half: int | None = None,
        differentiable: bool = False,
    ) -> Scattering:
        """The operator to some `among` the points; `half` 0 or 1 takes one half of the walks."""
        start, stop, _ = among.indices(int(np.iinfo(np.int32).max))
        first, last = np.searchsorted(self.rows, (start, stop))
        ends = np.asarray(self.ends[first:last, :, half_columns(self.ends.shape[2], half)], np.int32)
        scale = None
        if self.scale is not None:
            found = self.scale[first:last] if half is None else self.scale[first:last, :, half : half + 1]
            scale, (points, media, rows), width = jnp.asarray(found), found.shape, ends.shape[2]
            by_row = np.moveaxis(ends.reshape(points, media, rows, width // rows), 2, 1)
            ends = by_row.reshape(points * rows, media, width // rows)
        walks = [GatherOperator.from_hits(medium, samples, differentiable) for medium in np.moveaxis(ends, 1, 0)]
        tints = jnp.asarray(colour[self.material[first:last]])
        return Scattering(jnp.asarray(self.rows[first:last] - start), tuple(walks), tints, scale)


class Walks(NamedTuple):
    """Walks from all points of a transport, and what became of them.

    `colour` [materials, 3] is the share that a translucent body returns of light that is the same everywhere, the mean over its
    receivers, and 1 for other materials; that of strands is the albedo of their fibres. `fates` counts walks by material, fate
    and channel, and those of all strands together as "hair".
    """

    receivers: WalkTable | None
    samples: WalkTable
    vertices: WalkTable | None
    colour: Float[np.ndarray, "materials 3"]
    fates: Mapping[str, Mapping[str, list[int]]]


def half_columns(rays: int, half: int | None) -> slice:
    """All rays of a table, or one half of them."""
    return slice(None) if half is None else slice(half * rays // 2, (half + 1) * rays // 2)


def read_walks(group: Any, scene: Scene) -> Walks | None:
    """The walks of a transport store, None where there are neither translucent bodies nor strands."""
    bodies = _read_bodies(group)
    return bodies if "strands" not in group else _with_strands(group, scene, bodies)


def _with_strands(group: Any, scene: Scene, bodies: Walks | None) -> Walks:
    """The paths of strands, beside walks through bodies."""
    rows, material, ends, scale = (
        np.asarray(member(group, f"strands/receivers/{part}")[...]) for part in ("rows", "material", "ends", "scale")
    )
    colour = np.ones((len(scene.materials), 3), np.float32) if bodies is None else bodies.colour.copy()
    for index in np.unique(material):
        albedo = np.asarray(scene.materials[index].albedo, np.float32)
        colour[index] = np.where(albedo > 0, albedo, 1.0)
    fates = {**(bodies.fates if bodies else {}), "hair": json.loads(str(group["strands"].attrs["fates"]))}
    table = WalkTable(rows, material, ends, scale)
    if bodies is not None:
        table = _joined(bodies.samples, table)
    return Walks(table, table, None, colour, fates)


def _joined(bodies: WalkTable, strands: WalkTable) -> WalkTable:
    """One table for both; strands come after surfaces, and all rows are in ascending order."""
    assert strands.scale is not None
    channels = max(bodies.ends.shape[1], strands.ends.shape[1])
    ends = [
        np.broadcast_to(part, (len(part), channels, part.shape[2]))
        for part in (np.asarray(bodies.ends[:]), np.asarray(strands.ends[:]))
    ]
    scale = np.broadcast_to(strands.scale, (len(strands.rows), channels, 2))
    return WalkTable(
        np.concatenate([bodies.rows, strands.rows]),
        np.concatenate([bodies.material, strands.material]),
        np.concatenate(ends),
        np.concatenate([np.ones((len(bodies.rows), channels, 2), np.float32), scale]),
    )


def _read_bodies(group: Any) -> Walks | None:
    """The walks through translucent bodies."""
    if "walks" not in group:
        return None
    tables: dict[str, WalkTable | None] = {}
    for name in ("receivers", "samples", "vertices"):
        place = f"walks/{name}"
        tables[name] = None
        if place in group:
            rows, material = (np.asarray(member(group, f"{place}/{part}")[...]) for part in ("rows", "material"))
            tables[name] = WalkTable(rows, material, member(group, f"{place}/ends"))
    samples = tables["samples"] or tables["receivers"]
    assert samples is not None
    fates = json.loads(str(group["walks"].attrs["fates"]))
    colour = np.asarray(member(group, "walks/colour")[...])
    return Walks(tables["receivers"], samples, tables["vertices"], colour, fates)


def no_walks(rays: int, materials: int) -> Walks:
    """The walks of a scene without translucent bodies, where they are simulated all the same: tables of no rows."""
    nowhere = np.zeros(0, np.int32)
    table = WalkTable(nowhere, nowhere, np.zeros((0, 1, rays), np.int32))
    return Walks(table, table, table, np.ones((materials, 3), np.float32), {})
