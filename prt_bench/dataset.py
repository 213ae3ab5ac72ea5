"""A lighting dataset: pairs of direct and indirect light for many lightings of one scene.

Reads what `data_gen.bake` wrote, or holds arrays in memory. Large arrays stay on disk until asked for.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int

from prt_bench.environment import EnvironmentMap
from prt_bench.errors import DatasetError
from prt_bench.hemisphere import SAMPLER, HemisphereSampler
from prt_bench.lights import Lighting, light_from_json
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Scene
from prt_bench.store import camera_from_json, member, open_group, read_lightmap, read_points, read_scene
from prt_bench.transport import GatherOperator, Scattering
from prt_bench.walks import Walks, WalkTable, half_columns, read_walks

_ARRAYS = ("measured", "direct", "indirect", "indirect_half", "noise")
_STREAMED = ("streamed_direct", "streamed_measured")


@dataclass(frozen=True, eq=False)
class Transport:
    """The traced operator of a scene: receivers, gather samples and the hit tables between them.

    `receiver_hits` [T, R] and `sample_hits` [S, R] index samples; S marks a ray that carries nothing, S + 1 one that
    escaped, along the direction that `sampler` gives for it. Both halves of the
    rays are estimates of their own, and their difference is the noise floor. `buried` [T] marks receivers whose point lies
    inside another body that stands on their texel; no light reaches them, and pictures fill them from their neighbours.

    With `walks` light crosses translucent bodies too, from samples to receivers and to samples.

    With `nodes` only some receivers were traced: `receiver_hits` [J, R'] has their rows, see `traced` and `spread`.
    """

    scene: Scene
    lightmap: Lightmap
    receivers: SurfacePoints
    buried: Bool[np.ndarray, " T"]
    samples: SurfacePoints
    receiver_hits: Int[np.ndarray, "T R"] | zarr.Array
    sample_hits: Int[np.ndarray, "S R"] | zarr.Array
    bounces: int
    key: str
    sampler: HemisphereSampler | None = None
    vertices: "Vertices | None" = None
    nodes: "Nodes | None" = None
    walks: Walks | None = None

    @classmethod
    def open(cls, path: Path) -> "Transport":
        """Open a transport store that `data_gen.bake` wrote."""
        group = open_group(path, "transport")
        receiver_hits, samples = member(group, "receiver_hits"), str(group.attrs["sample_hits"])
        scene = read_scene(group)
        return cls(
            scene,
            read_lightmap(group, "lightmap"),
            read_points(group, "receivers"),
            np.asarray(member(group, "buried")[...]),
            read_points(group, "samples"),
            receiver_hits,
            receiver_hits if samples == "receiver_hits" else member(group, samples),
            int(group.attrs["bounces"]),
            str(group.attrs["key"]),
            _read_sampler(group),
            _read_vertices(group),
            _read_nodes(group),
            read_walks(group, scene),
        )

    def at_vertices(self) -> "tuple[Transport, Int[np.ndarray, 'F 3']]":
        """The same transport with the mesh's vertices as receivers, and the vertex of each face corner.

        Raises `DatasetError` when they were not traced.
        """
        if self.vertices is None:
            raise DatasetError(f"the vertices of '{self.scene.name}' were not traced; bake it with vertices = true")
        points, corner, hits = self.vertices
        exposed = np.zeros(len(points), bool)
        walks = self.walks and self.walks._replace(receivers=self.walks.vertices)
        return replace(self, receivers=points, buried=exposed, receiver_hits=hits, nodes=None, walks=walks), corner

    @property
    def traced(self) -> "Transport":
        """The same transport with the points that rays left from as receivers: itself, or its J nodes."""
        if self.nodes is None:
            return self
        exposed = np.zeros(len(self.nodes.points), bool)
        return replace(self, receivers=self.nodes.points, buried=exposed, sampler=self.nodes.sampler, nodes=None)

    def spread(self, values: Float[np.ndarray, "J *rest"], rows: slice = slice(None)) -> Float[np.ndarray, "t *rest"]:  # noqa: F821  (names of dimensions)
        """Values at the receivers `rows` from those at the receivers of `traced`; where every receiver was traced, its own."""
        if self.nodes is None:
            return values[rows]
        corner, weight = self.nodes.corner[rows], self.nodes.weight[rows]
        mixed = values[corner[:, 0]] * weight[:, 0].reshape(-1, *[1] * (values.ndim - 1))
        for end in (1, 2, 3):
            mixed += values[corner[:, end]] * weight[:, end].reshape(-1, *[1] * (values.ndim - 1))
        return mixed

    def sample_gather(self, half: int | None = None, differentiable: bool = False) -> GatherOperator:
        """The operator from samples to samples; `half` 0 or 1 takes one half of the rays, None all of them."""
        return self._operator(self.sample_hits, slice(None), half, differentiable)

    def receiver_gather(
        self, rows: slice = slice(None), half: int | None = None, differentiable: bool = False
    ) -> GatherOperator:
        """The operator from samples to some of the receivers; of `traced`, where not all of them were."""
        return self._operator(self.receiver_hits, rows, half, differentiable)

    def sample_scattering(self, half: int | None = None, differentiable: bool = False) -> Scattering | None:
        """What translucent bodies pass from samples to samples; None without such bodies."""
        return self.walks and self._scattering(self.walks.samples, slice(None), half, differentiable)

    def receiver_scattering(
        self, rows: slice = slice(None), half: int | None = None, differentiable: bool = False
    ) -> Scattering | None:
        """The same to some of the receivers; to all of them, where not all were traced."""
        return self.walks and self._scattering(self.walks.receivers, rows, half, differentiable)

    def _scattering(self, table: WalkTable | None, rows: slice, half: int | None, differentiable: bool) -> Scattering:
        assert table is not None, "walks are traced from every set of points"
        assert self.walks is not None
        return table.scattering(len(self.samples), self.walks.colour, rows, half, differentiable)

    def _operator(self, table: Any, rows: slice, half: int | None, differentiable: bool) -> GatherOperator:
        hits = np.asarray(table[rows, half_columns(table.shape[1], half)], np.int32)
        return GatherOperator.from_hits(hits, len(self.samples), differentiable)


def display_albedo(transport: Transport) -> Float[np.ndarray, "T 3"]:
    """What makes direct light at the receivers comparable with indirect: albedo over colour at translucent ones, else 1."""
    face = transport.receivers.face
    if transport.walks is None:
        return np.ones((len(face), 3), np.float32)
    own = transport.receivers.albedo / transport.walks.colour[transport.scene.mesh.material[face]]
    return np.where(transport.scene.translucent_at(face)[:, None], own, 1.0).astype(np.float32)


class Vertices(NamedTuple):
    """The V vertices of the mesh as receivers of their own: `hits` [V, R] as in the other tables, `corner` [F, 3] the vertex
    of each face corner."""

    points: SurfacePoints
    corner: Int[np.ndarray, "F 3"]
    hits: Int[np.ndarray, "V R"] | zarr.Array


class Nodes(NamedTuple):
    """The J receivers that rays were traced from, along the directions of `sampler`, where the others lie between them: values
    at receiver t are those at the nodes `corner` [T, 4] with the shares `weight` [T, 4]."""

    points: SurfacePoints
    sampler: HemisphereSampler
    corner: Int[np.ndarray, "T 4"]
    weight: Float[np.ndarray, "T 4"]


class Streamed(NamedTuple):
    """Direct light, and nothing else, of n further lightings of the training scenario: grey irradiance in W/m².

    `measured` [n, M] at the measurement points; `direct` [n, S] at the gather samples, on disk until sliced.
    """

    measured: Float[np.ndarray, "n M"]
    direct: Float[np.ndarray, "n S"] | zarr.Array


@dataclass(frozen=True, eq=False)
class LightingDataset:
    """N lighting configurations of one scene with their direct and indirect light.

    Values are irradiance in W/m². `measured` [N, M, C] is direct light at the measurement points, `direct` and `indirect`
    [N, T, C] are at the receivers `points`, texels of `lightmap`. `groups` [M, s] lists, for each measurement point, the
    dense points whose direct light is averaged into it. `metadata` says how it was baked; `splits` names ranges of lightings.
    """

    transport: Transport
    measurement_points: SurfacePoints
    dense_points: SurfacePoints
    groups: Int[np.ndarray, "M s"]
    all_lightings: tuple[Lighting, ...]
    arrays: Mapping[str, Any]
    splits: Mapping[str, tuple[int, int]]
    metadata: Mapping[str, Any]
    rows: tuple[int, int]
    path: Path | None = None

    @classmethod
    def open(cls, path: str | Path) -> "LightingDataset":
        """Open a finished dataset. Raises `DatasetError` when it is missing, damaged, or its transport is not beside it."""
        path = Path(path)
        group = open_group(path, "dataset")
        metadata = json.loads(str(group.attrs["metadata"]))
        transport = Transport.open(path.parent / metadata["transport"])
        # The transport may have been traced for another view of the same geometry.
        scene = replace(transport.scene, camera=camera_from_json(metadata["camera"]))
        maps = {}
        if "environments" in group:
            for name in group["environments"].array_keys():
                array = group["environments"][name]
                environment = EnvironmentMap(str(array.attrs["name"]), np.asarray(array[...]))
                maps[environment.hash] = environment
        lightings = tuple(
            Lighting(tuple(light_from_json(light, maps) for light in lights))
            for lights in json.loads(str(group.attrs["lightings"]))
        )
        splits = {name: tuple(rows) for name, rows in metadata["splits"].items()}
        return cls(
            replace(transport, scene=scene),
            read_points(group, "measurement_points"),
            read_points(group, "dense_points"),
            np.asarray(member(group, "groups")[...]),
            lightings,
            {name: member(group, name) for name in (*_ARRAYS, *(_STREAMED if "streamed_direct" in group else ()))},
            splits,
            metadata,
            (0, len(lightings)),
            path,
        )

    def split(self, name: str) -> "LightingDataset":
        """The lightings of one split: "train", "test" or "ood-<scenario>". Shares the arrays."""
        if name not in self.splits:
            raise DatasetError(f"dataset of '{self.scene.name}' has no split '{name}'; it has {', '.join(self.splits)}")
        return replace(self, rows=self.splits[name])

    @property
    def scene(self) -> Scene:
        """The scene that was baked."""
        return self.transport.scene

    @property
    def points(self) -> SurfacePoints:
        """The T receivers."""
        return self.transport.receivers

    @property
    def lightmap(self) -> Lightmap:
        """Where the receivers lie in the lightmap image."""
        return self.transport.lightmap

    @property
    def lightings(self) -> tuple[Lighting, ...]:
        """The N lighting configurations of this split."""
        return self.all_lightings[slice(*self.rows)]

    @property
    def hash(self) -> str:
        """SHA-256 of the whole dataset's content, the same for any number of workers."""
        return str(self.metadata["hash"])

    @cached_property
    def measured(self) -> Float[np.ndarray, "N M C"]:
        """Direct irradiance at the measurement points, in W/m²."""
        return self._load("measured")

    @cached_property
    def direct(self) -> Float[np.ndarray, "N T C"]:
        """Direct irradiance at the receivers, in W/m²."""
        return self._load("direct")

    @cached_property
    def indirect(self) -> Float[np.ndarray, "N T C"]:
        """Indirect irradiance at the receivers, all bounces, in W/m²; at translucent ones what leaves them, over their body's
        colour (`prt_bench.transport.shown`)."""
        return self._load("indirect")

    @property
    def shown_direct(self) -> Float[np.ndarray, "N T C"]:
        """Direct light in the measure of `indirect`: irradiance, but ρ E_dir over the body's colour at translucent receivers.
        Their sum is all light."""
        if self.transport.walks is None:
            return self.direct
        return self.direct * display_albedo(self.transport)[:, : self.direct.shape[2]]

    def indirect_at(self, first: int, last: int) -> Float[np.ndarray, "N t C"]:
        """`indirect` at the receivers from `first` up to `last`; nothing else of it is read from disk, and nothing kept."""
        if "indirect" in vars(self):  # loaded already
            return self.indirect[:, first:last]
        return np.asarray(self.arrays["indirect"][slice(*self.rows), first:last])

    @cached_property
    def indirect_half(self) -> Float[np.ndarray, "N T C"]:
        """Indirect irradiance from the first half of the rays alone; kept for held-out lightings only."""
        first, last = (row - self.metadata["held_out"] for row in self.rows)
        if first < 0:
            raise DatasetError("half-ray estimates are kept for held-out lightings only; take split('test') first")
        return np.asarray(self.arrays["indirect_half"][first:last])

    @cached_property
    def streamed(self) -> Streamed:
        """The streamed lightings, the same for every split. Raises `DatasetError` when it was baked without any."""
        if "streamed_direct" not in self.arrays:
            raise DatasetError(
                f"the dataset of '{self.scene.name}' has no streamed lightings; bake it with streamed = 2048, say"
            )
        return Streamed(np.asarray(self.arrays["streamed_measured"][:]), self.arrays["streamed_direct"])

    @cached_property
    def noise(self) -> Float[np.ndarray, " N"]:
        """Relative standard error of `indirect` per lighting, from the difference of the two halves of the rays."""
        return self._load("noise")

    @property
    def noise_floor(self) -> float:
        """Root mean square of `noise` over the lightings that are not black."""
        lit = self.noise[self.noise > 0]
        return float(np.sqrt(np.mean(lit**2))) if lit.size else 0.0

    def __len__(self) -> int:
        return self.rows[1] - self.rows[0]

    def _load(self, name: str) -> np.ndarray:
        return np.asarray(self.arrays[name][slice(*self.rows)])


def _read_vertices(group: Any) -> Vertices | None:
    if "vertex_hits" not in group:
        return None
    return Vertices(
        read_points(group, "vertices"), np.asarray(member(group, "corner")[...]), member(group, "vertex_hits")
    )


def _read_nodes(group: Any) -> Nodes | None:
    if "nodes" not in group:
        return None
    corner, weight = (np.asarray(member(group, f"nodes/{name}")[...]) for name in ("corner", "weight"))
    return Nodes(read_points(group, "nodes"), _read_sampler(group, "nodes/"), corner, weight)


def _read_sampler(group: Any, folder: str = "") -> HemisphereSampler:
    local, jitter = (np.asarray(member(group, folder + name)[...]) for name in SAMPLER)
    return HemisphereSampler.stored(local, jitter, int(group.attrs["seed"]))
