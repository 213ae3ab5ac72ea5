"""What the light of blocks does beside irradiance on their faces: on surfaces that normal maps tilt, and in the air between.

Vector irradiance. A surface at a sample of a face with the normal n, tilted to m, is lit by about E(m) = E(n) + v · (m − n),
where v for light from each direction is the best for normals as they are likely (`slopes`). So flat surfaces keep the light
they have, and those that tilt a little err least. The source projects quadratic harmonics on linear ones, with no preference
among all normals of the hemisphere (Loos et al. 2011, Section 6.4 and Appendix B), and errs two to four times as much.

Irradiance volumes. Irradiance at places in a block, by the direction it falls on, in the nine harmonics of
`prt_bench.irradiance_volume` (Section 6.5).

Operators on samples carry radiance: that of faces, radiosity / π, or that of a lightfield that enters through −x.
"""

from collections.abc import Callable, Sequence
from typing import Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse import csr_array, vstack

from prt_bench.irradiance_volume import ORDER, places
from prt_bench.modular.cube import disk, frames, interpolation, meet, sample_points
from prt_bench.modular.lightfield import Grid, at_entrance
from prt_bench.spherical.harmonics import bands, evaluate
from prt_bench.spherical.zonal import cosine_lobe

HARMONICS = ORDER**2
PLACES = 4
"""Places of an irradiance volume along an edge of a block."""


class Secondary(eqx.Module):
    """From coefficients of blocks and of what arrives in them to vector irradiance and to irradiance volumes.

    For K entries with B functions and R of what enters through −x: `tilt` [K, n, 3, B] and `tilt_arriving` [n, 3, R] give v at
    the samples, `probes` [K, P, 9, B] and `probes_arriving` [P, 9, R] harmonics of irradiance at places, in a block's own axes.
    """

    tilt: Float[Array, "K n 3 B"]
    tilt_arriving: Float[Array, "n 3 R"]
    probes: Float[Array, "K P 9 B"]
    probes_arriving: Float[Array, "P 9 R"]

    @classmethod
    def of(
        cls, implicit: Sequence[Float[np.ndarray, "n B"]], lightfields: Float[np.ndarray, "s R"], side: int, grid: Grid
    ) -> Self:
        """Of the radiosity whose one bounce is each function, and of the lightfield that each of what arrives stands for."""
        lit, entered = from_faces(side), from_entrance(grid)
        surface = [tilted(side, table) for table in (lit, entered)]
        air = [probed(PLACES, table) for table in (lit, entered)]
        parts = []
        for (own, arriving), numbers in ((surface, 3), (air, HARMONICS)):
            parts.append(np.stack([(own @ each / np.pi).reshape(-1, numbers, each.shape[1]) for each in implicit]))
            parts.append((arriving @ lightfields).reshape(-1, numbers, lightfields.shape[1]))
        return cls(*(jnp.asarray(part, jnp.float32) for part in parts))

    @property
    def places(self) -> int:
        """Places of an irradiance volume along an edge of a block."""
        return round(self.probes.shape[1] ** (1 / 3))


Table = Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], csr_array]
"""From where rays start and go to a row for each: the radiance that comes along it, from that of faces or of a lightfield."""
_BATCH = 1 << 19  # rays at once
_LIKELY = 4  # power of the cosine with which tilted normals count
_NORMALS = 48  # squared: normals that slopes are the best for


def from_faces(side: int) -> Table:
    """Radiance of a cube's samples [n], as rays from within see it."""
    return lambda origin, direction: interpolation(origin, direction[:, None], side)


def from_entrance(grid: Grid) -> Table:
    """Radiance of a lightfield that enters through −x, as rays from within see it; 0 for those that meet other faces."""
    return lambda origin, direction: at_entrance(
        meet(origin, direction), -direction, np.arange(len(origin)), grid, len(origin)
    )


def tilted(side: int, table: Table, across: int = 48) -> csr_array:
    """v at all samples [3 n, ·], sample by sample in world axes, by `across`² rays from each."""
    position, normal = sample_points(side)
    local = _hemisphere(across)
    axes = frames(normal)
    return _summed(
        position, np.einsum("rk,nkc->nrc", local, axes), np.einsum("rk,nkc->nrc", slopes(local), axes), table
    )


def probed(across_block: int, table: Table, across: int = 48) -> csr_array:
    """Coefficients of irradiance [9 P, ·], place by place, at P = `across_block`³ places in the cube, each in the middle of an
    equal cell; by 2 `across`² rays from each."""
    position = places(np.full(3, -0.5), np.full(3, 0.5), (across_block,) * 3)
    half = _hemisphere(across)
    direction = np.concatenate([half, -half])
    lobe = np.asarray(cosine_lobe(ORDER))[bands(ORDER)]
    weight = 2.0 * np.asarray(evaluate(direction, ORDER)) * lobe
    count = len(position)
    return _summed(
        position, np.broadcast_to(direction, (count, *direction.shape)), np.broadcast_to(weight, (count, *weight.shape)),
        table,
    )  # fmt: skip


def slopes(direction: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R 3"]:
    """v about the normal z, for light from unit directions before it: the minimum over v of
    ∫ (m · z)^`_LIKELY` (max(0, m · ω) − ω · z − v · (m − z))² over all unit m before z."""
    normal = _hemisphere(_NORMALS)
    away = normal - np.array([0.0, 0.0, 1.0])
    likely = away * normal[:, 2:] ** _LIKELY
    rest = np.maximum(0.0, normal @ direction.T) - direction[:, 2]
    return np.linalg.solve(likely.T @ away, likely.T @ rest).T


def _hemisphere(across: int) -> Float[np.ndarray, "R 3"]:
    """Directions above z = 0, the middles of `across`² equal parts of it."""
    middles = (np.arange(across) + 0.5) / across
    x, y = (part.ravel() for part in disk(*np.meshgrid(middles, middles)))
    square = x * x + y * y
    stretch = np.sqrt(2.0 - square)
    return np.stack([x * stretch, y * stretch, 1.0 - square], axis=1)


def _summed(
    position: Float[np.ndarray, "P 3"], direction: Float[np.ndarray, "P R 3"], weight: Float[np.ndarray, "P R q"],
    table: Table,
) -> csr_array:  # fmt: skip
    """∫ weight · radiance over the hemisphere that R rays sample evenly, from each point: [P q, ·]."""
    rays, numbers = weight.shape[1:]
    step, parts = max(_BATCH // rays, 1), []
    for at in range(0, len(position), step):
        rows = slice(at, at + step)
        count = len(position[rows])
        seen = table(np.repeat(position[rows], rays, axis=0), direction[rows].reshape(-1, 3))
        columns = np.arange(count * rays).reshape(count, 1, rays)
        start = np.arange(count * numbers + 1) * rays
        values = 2.0 * np.pi / rays * np.swapaxes(weight[rows], 1, 2)
        index = np.broadcast_to(columns, (count, numbers, rays)).ravel()
        parts.append(csr_array((values.ravel(), index, start), shape=(count * numbers, count * rays)) @ seen)
    return csr_array(vstack(parts))
