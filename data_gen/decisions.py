"""A plan: what the planner decided for a scene, each decision with its reason, and what may be overruled.

Decisions are made in `data_gen.plan` and costs predicted in `data_gen.cost`; tracing and lighting read them here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float

from prt_bench.emitters import Emitters
from prt_bench.errors import SpecError
from prt_bench.scene import Scene

FORCIBLE = ("subsurface", "channels", "bounces", "shadow rays", "gather samples", "receivers")
"""What can be simulated in full where the planner would leave it out: names of effects and of decisions."""
EVERYTHING = "all"
FULL_TAIL = 2.0**-24
"""What forced bounces may leave out, relative to the brightest direct light: half a unit in the last place of float32."""


@dataclass(frozen=True)
class Decision:
    """One choice of the planner, and why."""

    what: str
    decision: str
    why: str


@dataclass(frozen=True)
class Cost:
    """Predicted cost of a bake: rays of each kind, bytes on disk, peak bytes in memory, seconds."""

    gather_rays: int
    shadow_rays: int
    disk_bytes: int
    memory_bytes: int
    seconds: float


@dataclass(frozen=True)
class Plan:
    """The settings of a bake and what the scene needs.

    `texels` and `gather_texels` are the sides of the receivers' and the gather samples' lightmaps, `rays` is per point,
    `bounces` an upper bound that the traced operator lowers, `channels` 1 for achromatic scenes, `convex` "outside" (a lone
    convex body), "inside" (a convex room) or None. `force` names what is simulated in full all the same. `noise` is the
    split-half noise that `rays` were chosen for, 0 where they were given; `gather_tolerance` the error that coarser gather
    samples may have, 0 where the receivers serve.
    """

    texels: int
    gather_texels: int
    rays: int
    bounces: int
    tolerance: float
    channels: int
    convex: str | None
    effects: tuple[str, ...]
    vertices: bool
    decisions: tuple[Decision, ...]
    cost: Cost
    node_rays: int = 0
    node_tolerance: float = 0.0
    mips: int = 0
    texture_set: bool = False
    force: tuple[str, ...] = ()
    noise: float = 0.0
    gather_tolerance: float = 0.0

    @property
    def tail(self) -> float:
        """Light that truncated bounces may leave out, relative to the brightest direct light."""
        return FULL_TAIL if "bounces" in self.force else self.tolerance

    def needs_shadow_rays(self, scene: Scene, emitters: Emitters) -> bool:
        """False only where nothing can stand between these emitters and a surface they face, and they are not forced."""
        if "shadow rays" in self.force:
            return True
        if self.convex == "outside":
            return False
        if self.convex == "inside":
            place = np.asarray(emitters.position).reshape(-1, 4)
            place = place[np.asarray(emitters.intensity).reshape(-1, 3).max(axis=1) > 0]
            return bool(np.any(place[:, 3] == 0)) or not _in_front_of_all(scene, place[:, :3])
        return True

    def decided(self, what: str, decision: str, why: str) -> Self:
        """The same plan with another decision on one question."""
        other = Decision(what, decision, why)
        return replace(self, decisions=tuple(other if d.what == what else d for d in self.decisions))

    def table(self) -> str:
        """The decisions and the predicted cost as aligned text."""
        rows = [(d.what, d.decision, d.why) for d in self.decisions]
        cost = self.cost
        rows.append(
            (
                "predicted cost",
                f"{cost.seconds:.1f} s",
                f"{cost.gather_rays / 1e6:.1f} M gather rays, {cost.shadow_rays / 1e6:.1f} M shadow rays at most, "
                f"{cost.disk_bytes / 1e6:.0f} MB on disk, {cost.memory_bytes / 1e6:.0f} MB in memory",
            )
        )
        first, second = (max(len(row[i]) for row in rows) for i in (0, 1))
        return "\n".join(f"{a:<{first}}  {b:<{second}}  {c}" for a, b, c in rows)

    def to_json(self) -> list[dict[str, str]]:
        """The decisions as rows for records and reports."""
        return [vars(decision).copy() for decision in self.decisions]


def forced(names: Sequence[str]) -> tuple[str, ...]:
    """What is to be simulated in full, each once and in the order of `FORCIBLE`. Raises `SpecError` for anything else."""
    for name in names:
        if name not in (*FORCIBLE, EVERYTHING):
            raise SpecError(f"'{name}' cannot be forced; valid are {', '.join(FORCIBLE)} and {EVERYTHING}")
    return tuple(name for name in FORCIBLE if name in names or EVERYTHING in names)


def _in_front_of_all(scene: Scene, points: Float[np.ndarray, "P 3"]) -> bool:
    normals, corners = scene.mesh.normals, scene.mesh.triangles[:, 0]
    return bool(np.all(points @ normals.T >= np.sum(normals * corners, axis=1)))
