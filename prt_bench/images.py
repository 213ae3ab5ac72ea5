"""Frames to files: the display transform, PNG for looking and EXR for measuring."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from prt_bench.environment import LUMINANCE


def tone_map(radiance: Float[np.ndarray, "H W 3"], exposure: float = 0.0) -> UInt8[np.ndarray, "H W 3"]:
    """Linear radiance · 2^exposure through the sRGB transfer function (IEC 61966-2-1), clipped to 8 bits.

    The same operator as `shaders/tonemap.frag`.
    """
    value = np.clip(np.asarray(radiance, np.float64) * 2.0**exposure, 0.0, 1.0)
    encoded = np.where(value > 0.0031308, 1.055 * value ** (1 / 2.4) - 0.055, 12.92 * value)
    return np.round(encoded * 255.0).astype(np.uint8)


def exposure_for(radiance: Float[np.ndarray, "H W 3"], quantile: float = 0.98) -> float:
    """The exposure in stops that brings a quantile of the lit pixels' luminance to white; 0 for a black frame."""
    luminance = np.asarray(radiance, np.float64) @ LUMINANCE
    lit = luminance[luminance > 0]
    return float(-np.log2(np.quantile(lit, quantile))) if lit.size else 0.0


def write_png(path: Path, picture: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write an 8-bit picture, top row first."""
    from PIL import Image

    Image.fromarray(picture).save(path)


def write_exr(path: Path, radiance: Float[np.ndarray, "H W 3"]) -> None:
    """Write linear radiance as float32 RGB, top row first."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": np.ascontiguousarray(radiance, np.float32)}) as file:
        file.write(str(path))
