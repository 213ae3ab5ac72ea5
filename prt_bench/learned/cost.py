"""What a frame with a learned model costs, counted from its shapes: multiplications and bytes, before anything is timed."""

from typing import NamedTuple

import numpy as np

from prt_bench.assets import RuntimeAsset

_CHANNELS = 3


class Cost(NamedTuple):
    """Multiplications of the transfer of one frame and of one fragment, and the bytes that each of them reads."""

    transfer_operations: int
    transfer_bytes: int
    fragment_operations: int
    fragment_bytes: int


def cost_of(asset: RuntimeAsset) -> Cost:
    """Counts for an asset that measures direct light: matrices for three channels, a texture or a field for each fragment.

    A matrix of the transfer meets all channels; a field is evaluated once for all of them, its functions then meet the
    coefficients of each. A bilinear lookup reads four texels.
    """
    sizes = {name: (array.size, array.nbytes) for name, array in asset.arrays.items()}

    def total(*beginnings: str) -> tuple[int, int]:
        found = [size for name, size in sizes.items() if name.startswith(beginnings)]
        return (int(np.sum([each[0] for each in found])), int(np.sum([each[1] for each in found])))

    functions = asset.arrays["weights"].shape[1]
    linear = _CHANNELS // len(asset.arrays["weights"])
    transfer, read = sizes["weights"]
    transfer *= linear
    if asset.kernels["reconstruct"] == "field":
        products, held = total("matrix", "bias", "head")
        levels = sum(name.startswith("grid") for name in sizes)
        nodes = 8 * levels * (asset.arrays["grid0"].shape[1] if levels else 0)
        width = asset.arrays["head"].dtype.itemsize
        return Cost(transfer, read, products + nodes + _CHANNELS * functions, held + nodes * width)
    if "head" in sizes:
        matrices, held = total("matrix", "bias")
        head, of_head = sizes["head"]
        transfer += _CHANNELS * matrices + head * _CHANNELS // len(asset.arrays["head"])
        read += held + of_head
    texel = asset.arrays["basis"].dtype.itemsize
    return Cost(transfer, read, _CHANNELS * functions, 4 * 4 * -(-functions // 4) * texel)
