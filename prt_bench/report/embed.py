"""HDR pictures inside the report: a reference as half floats, and for each method its difference to the reference.

The page inflates both to floats, so that exposure and error scale are chosen while looking. References keep 7 bits of
mantissa (0.4 %); differences keep their sign and 31 levels, evenly spaced in the square root: a pixel of an
error image is right to 3 % of the largest error in it. The OpenEXR files beside the report are exact.
"""

import base64
import hashlib
import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Integer

from prt_bench.errors import DatasetError
from prt_bench.report.pictures import read_picture

WIDEST = 640
LEVELS = 31
_DROPPED = 3  # bits of a half float's mantissa
_BYTES_PER_PIXEL = 1.2  # a first guess for an encoded picture; the true size decides


@dataclass(frozen=True)
class Encoded:
    """A picture as embedded: base64 of deflated, row-differenced planes. `peak`: the largest difference, or 0."""

    width: int
    height: int
    peak: float
    data: str


@dataclass(frozen=True)
class Pair:
    """A prediction and its reference, as paths of pictures."""

    prediction: Path
    reference: Path


def embed(rows: Iterable[Mapping[str, Pair]], budget: int) -> tuple[dict[Pair, tuple[str, str]], dict[str, Encoded]]:
    """Keys of every pair's (difference, reference), and the encoded pictures by key, at most `budget` bytes together.

    A row maps views of one frame to pairs. Light adds, so its views commonly share one difference, which is kept once.
    Raises `DatasetError` for a picture that cannot be read or does not have its reference's size.
    """
    rows = list(rows)
    paths = {path for row in rows for pair in row.values() for path in (pair.prediction, pair.reference)}
    name = {path: hashlib.sha256(path.read_bytes()).hexdigest()[:16] for path in paths}
    keys: dict[Pair, tuple[str, str]] = {}
    references: dict[str, Path] = {}
    differences: dict[str, Pair] = {}
    for row in rows:
        for view, pair in row.items():
            twin = row.get("indirect")
            source = twin if view == "final" and twin is not None and _same_difference(pair, twin) else pair
            keys[pair] = f"{name[source.prediction]}-{name[source.reference]}", name[pair.reference]
            differences[keys[pair][0]] = source
            references[keys[pair][1]] = pair.reference
    pixels = budget / (_BYTES_PER_PIXEL * max(len(differences) + len(references), 1))
    width = min(WIDEST, int(math.sqrt(pixels * 4 / 3)) + 1)
    while True:
        encoded = {key: encode_reference(shrink(read_picture(path), width)) for key, path in references.items()}
        encoded |= {key: encode_difference(_difference(pair, width)) for key, pair in differences.items()}
        total = sum(len(picture.data) for picture in encoded.values())
        if total <= budget or width == 1:
            return keys, encoded
        width = max(min(int(0.97 * width * math.sqrt(budget / total)), width - 1), 1)


def _difference(pair: Pair, width: int) -> Float[np.ndarray, "H W 3"]:
    prediction, reference = read_picture(pair.prediction), read_picture(pair.reference)
    if prediction.shape != reference.shape:
        raise DatasetError(
            f"the pictures {pair.prediction} and {pair.reference} differ in size; run again to make them anew"
        )
    return shrink(prediction - reference, width)


def _same_difference(a: Pair, b: Pair) -> bool:
    """Whether two views of a frame differ from their references alike, up to the rounding of half floats."""
    rounding = 2.0**-10 * max(float(np.abs(read_picture(pair.reference)).max()) for pair in (a, b))
    first, second = (_difference(pair, WIDEST) for pair in (a, b))
    return first.shape == second.shape and bool(np.abs(first - second).max() <= rounding)


def shrink(image: Float[np.ndarray, "H W 3"], width: int) -> Float[np.ndarray, "h w 3"]:
    """Averaged by area down to `width` pixels where it is wider; the mean stays."""
    if image.shape[1] <= width:
        return image
    rows = _overlaps(image.shape[0], max(round(image.shape[0] * width / image.shape[1]), 1))
    columns = _overlaps(image.shape[1], width)
    return np.einsum("hH,HWc,wW->hwc", rows, image, columns, optimize=True).astype(np.float32)


def _overlaps(before: int, after: int) -> Float[np.ndarray, "after before"]:
    """The share of each old pixel in each new one, along one axis."""
    edges = np.arange(after + 1)[:, None] * (before / after)
    left, right = np.arange(before), np.arange(1, before + 1)
    return np.clip(np.minimum(edges[1:], right) - np.maximum(edges[:-1], left), 0, None) * (after / before)


def encode_reference(image: Float[np.ndarray, "H W 3"]) -> Encoded:
    """Half floats as integers, rounded by `_DROPPED` bits, in planes of high and of low bytes."""
    bits = np.moveaxis(image, 2, 0).astype(np.float16).view(np.uint16).astype(np.int32)
    steps = np.diff((bits + (1 << _DROPPED >> 1)) >> _DROPPED, axis=2, prepend=0) & 0xFFFF
    return _encoded(image, 0.0, np.stack([steps >> 8, steps & 255]))


def encode_difference(difference: Float[np.ndarray, "H W 3"]) -> Encoded:
    """Signed levels of the square root of |difference| / peak, in one plane per channel."""
    peak = float(np.abs(difference).max()) or 1.0
    levels = np.round(LEVELS * np.sign(difference) * np.sqrt(np.abs(difference) / peak)).astype(np.int32)
    return _encoded(difference, peak, np.diff(np.moveaxis(levels, 2, 0), axis=2, prepend=0) & 255)


def _encoded(image: Float[np.ndarray, "H W 3"], peak: float, planes: Integer[np.ndarray, "..."]) -> Encoded:
    data = base64.b64encode(zlib.compress(planes.astype(np.uint8).tobytes(), 6)).decode()
    return Encoded(image.shape[1], image.shape[0], peak, data)
