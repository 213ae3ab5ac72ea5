"""Pictures of a run: linear HDR on disk as half-float OpenEXR, and in the report as what a browser can decode exactly.

In the report a picture is its half-float bits, differenced along rows, split into planes of bytes and deflated:
lossless, and about a third of the raw size, since lightmapped surfaces are smooth.
"""

import base64
import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from jaxtyping import Float, UInt8
from skimage.transform import resize_local_mean

from prt_bench.errors import DatasetError

HALF_MAX = float(np.finfo(np.float16).max)


def write_picture(path: Path, image: Float[np.ndarray, "H W 3"]) -> Path:
    """Write linear radiance [H, W, 3] as half-float OpenEXR; folders are made, values beyond the half range clipped.

    Raises `ValueError` when the image has another shape or holds NaN: a picture that lies is worse than none.
    """
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise ValueError(f"{path.name}: a picture is [H, W, 3], not {list(image.shape)}")
    if np.isnan(image).any():
        raise ValueError(f"{path.name}: the picture holds NaN")
    half = np.clip(image, -HALF_MAX, HALF_MAX).astype(np.float16)
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(half)}).write(str(path))
    return path


def read_picture(path: Path) -> Float[np.ndarray, "H W 3"]:
    """The picture as float32. Raises `DatasetError` when it cannot be read."""
    try:
        with OpenEXR.File(str(path)) as file:
            return np.asarray(file.channels()["RGB"].pixels, dtype=np.float32)
    except (RuntimeError, KeyError, OSError, TypeError) as error:
        raise DatasetError(f"the picture {path} cannot be read as an RGB OpenEXR; run again to make it anew") from error


@dataclass(frozen=True)
class Encoded:
    """A picture as the report embeds it: size in pixels, and base64 of the deflated planes."""

    width: int
    height: int
    data: str


def encode_within(images: dict[str, Float[np.ndarray, "H W 3"]], budget: int, width: int = 640) -> dict[str, Encoded]:
    """Encode pictures at the same width, at most `width` pixels, shrunk further until all fit in `budget` bytes."""
    while True:
        encoded = {name: encode(image, width) for name, image in images.items()}
        total = sum(len(picture.data) for picture in encoded.values())
        if total <= budget or width == 1:
            return encoded
        widest = max(picture.width for picture in encoded.values())
        width = max(int(0.97 * widest * math.sqrt(budget / total)), 1)


def encode(image: Float[np.ndarray, "H W 3"], width: int) -> Encoded:
    """Encode for the report, averaged down to `width` pixels where it is wider."""
    if image.shape[1] > width:
        height = max(round(image.shape[0] * width / image.shape[1]), 1)
        image = resize_local_mean(image, (height, width))
    planes = byte_planes(image.astype(np.float16))
    return Encoded(image.shape[1], image.shape[0], base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode())


def byte_planes(half: Float[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "2 3 H W"]:
    """The bits of R, G, B as 16-bit integers, less their left neighbours modulo 2¹⁶: high bytes, then low ones."""
    bits = np.moveaxis(half, 2, 0).copy().view(np.uint16)
    steps = np.diff(bits, axis=2, prepend=np.uint16(0))
    return np.stack([steps >> 8, steps & 255]).astype(np.uint8)
