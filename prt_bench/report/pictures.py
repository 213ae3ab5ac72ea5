"""Pictures of a run on disk: linear HDR as half-float OpenEXR. How the report embeds them is in `embed.py`."""

from pathlib import Path

import numpy as np
import OpenEXR
from jaxtyping import Float

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
