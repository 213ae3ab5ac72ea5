"""The project's glossy reflection as a mitsuba plugin, written for mitsuba's own frames and samplers.

mitsuba has no Phong lobe of its own: the formula here is the oracle's only part that is not a third party's.
"""

from typing import Any

from prt_bench.scene import Material

_NAME = "diffuse_and_lobe"


def glossy_bsdf(material: Material) -> dict[str, Any]:
    """What `mi.load_dict` makes the material's reflection from: ρ/π + k (s + 1)/(2π) max(cos α, 0)^s, black from behind."""
    import mitsuba as mi

    lobe = material.glossy
    assert lobe is not None
    if lobe.roughness_image is not None:
        raise TypeError("the mitsuba oracle knows one exponent per material only")
    if not getattr(mi, "_has_diffuse_and_lobe", False):
        mi.register_bsdf(_NAME, _plugin())
        mi._has_diffuse_and_lobe = True  # pyright: ignore
    colours = {"albedo": material.albedo, "specular": lobe.specular}
    return {
        "type": _NAME,
        "exponent": float(lobe.exponent),
        **{f"{name}_{i}": float(value) for name, colour in colours.items() for i, value in enumerate(colour)},
    }


def _plugin() -> Any:
    """The class, made once a variant is chosen."""
    import drjit as dr
    import mitsuba as mi

    class DiffuseAndLobe(mi.BSDF):
        """Samples the lobe or the cosine, by halves."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.albedo, self.specular = (
                mi.Color3f(*[props[f"{name}_{i}"] for i in range(3)]) for name in ("albedo", "specular")
            )
            self.exponent = mi.Float(props["exponent"])
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            both = active & (mi.Frame3f.cos_theta(si.wi) > 0) & (mi.Frame3f.cos_theta(wo) > 0)
            aligned = dr.dot(mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z), wo)
            lobe = dr.select(aligned > 0, dr.power(dr.maximum(aligned, 1e-20), self.exponent), 0.0)
            lobe *= (self.exponent + 1.0) * dr.inv_two_pi
            cosine = mi.Frame3f.cos_theta(wo)
            value = (self.albedo * dr.inv_pi + self.specular * lobe) * cosine
            return value & both, dr.select(both, 0.5 * (lobe + cosine * dr.inv_pi), 0.0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            height = dr.power(sample2.x, 1.0 / (self.exponent + 1.0))
            ring = dr.safe_sqrt(1.0 - height * height)
            sine, cosine = dr.sincos(dr.two_pi * sample2.y)
            around = mi.Frame3f(mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z))
            lobe = around.to_world(mi.Vector3f(ring * cosine, ring * sine, height))
            chosen = mi.BSDFSample3f()
            chosen.wo = dr.select(sample1 < 0.5, lobe, mi.warp.square_to_cosine_hemisphere(sample2))
            value, density = self.eval_pdf(ctx, si, chosen.wo, active)
            chosen.pdf, chosen.eta = density, 1.0
            chosen.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            chosen.sampled_component = mi.UInt32(0)
            return chosen, dr.select(density > 0, value / density, 0.0)

        def traverse(self, callback: Any) -> None:
            """Nothing is differentiated."""

        def to_string(self) -> str:
            return _NAME

    return DiffuseAndLobe
