"""Inside of a grey sphere: every surface sees every other alike, so indirect light has a closed form.

In a sphere the form factor between any two points is 1 / area. One bounce therefore spreads ρ·mean(E_dir) evenly, and
all bounces sum to a geometric series (Sillion and Puech 1994, §2.3).
"""

import trimesh

from data_gen.geometry import Part, assemble
from prt_bench.scene import Camera, Material, Scene

ALBEDO = 0.5
SUBDIVISIONS = 4


def build() -> Scene:
    """An icosphere of radius 1 m, 5,120 faces, normals inward."""
    sphere = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS, radius=1.0)
    part = Part(sphere.vertices.copy(), sphere.faces[:, ::-1].copy(), 0)
    material = Material("grey", (ALBEDO, ALBEDO, ALBEDO))
    return Scene("furnace", assemble([part]), (material,), Camera((0.0, 0.0, 0.9), (0.0, 0.0, 0.0), fov_y=75.0))


def indirect_irradiance(mean_direct: float, albedo: float = ALBEDO) -> float:
    """Indirect irradiance in W/m², the same everywhere: E_ind = ρ / (1 − ρ) · mean(E_dir), the mean taken over area."""
    return albedo / (1.0 - albedo) * mean_direct
