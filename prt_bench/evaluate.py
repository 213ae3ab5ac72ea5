"""Accuracy of a fitted model on held-out lightings, as one record: how large the error is and where it comes from.

Errors are those of the asset that ships, loaded back from disk. Timings and rendered frames are added by whoever runs them.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.dataset import LightingDataset
from prt_bench.errors import DatasetError
from prt_bench.linalg import orthonormal
from prt_bench.methods.base import Method
from prt_bench.metrics import lightmap_figures, mean, relative_norm, root_mean_square
from prt_bench.models import Model
from prt_bench.records import Errors, Record, provenance

_CHUNK_BYTES = 256 * 2**20


def evaluate(
    model: Model | RuntimeAsset,
    ds: LightingDataset,
    asset: RuntimeAsset | None = None,
    method: Method | None = None,
    label: str | None = None,
    seconds: Mapping[str, float] | None = None,
) -> Record:
    """Compare a model with the light of `ds`, a split of held-out lightings, and return a record without timings.

    `asset` is what `model.export` returned; without one the model is exported to a temporary folder, as float32. An asset
    alone has no storage error, as there is nothing to compare it with. Oracles, which have no asset, are compared
    directly. `method` fills in the record's name, settings and role; `seconds` joins the dataset's bake time. Raises
    `DatasetError` for a split without lightings.
    """
    if len(ds) == 0:
        raise DatasetError(f"the split '{split_name(ds)}' of '{ds.scene.name}' has no lightings to evaluate on")
    label = label or (method.label if method else type(model).__name__)
    fitted, asset = (None, model) if isinstance(model, RuntimeAsset) else (model, asset)
    if asset is None and fitted is not None and fitted.kernels:
        with tempfile.TemporaryDirectory() as folder:
            return evaluate(fitted, ds, fitted.export(Path(folder) / "asset"), method, label, seconds)
    spectrum = None if fitted is None else fitted.spectrum
    return replace(
        describe(ds, method, label, seconds),
        status="ok" if asset else "oracle",
        reason=None if asset else "it needs the answer to predict it",
        errors=errors(fitted, ds, asset),
        bytes=_sizes(asset) if asset else {},
        curves={
            **({} if spectrum is None else {"singular_values": np.asarray(spectrum).tolist()}),
            **({} if fitted is None else {name: np.asarray(curve).tolist() for name, curve in fitted.history.items()}),
        },
        asset={"sha256": asset.sha256, "dtype": asset.dtype} if asset else {},
    )


def describe(
    ds: LightingDataset, method: Method | None, label: str, seconds: Mapping[str, float] | None = None
) -> Record:
    """A record that says what was run on what, before anything is measured: its status is "failed" until then."""
    return Record(
        scene=ds.scene.name,
        scenario=str(ds.metadata["scenario"]),
        split=split_name(ds),
        method=method.name if method else label,
        label=label,
        settings=asdict(method) if method else {},
        role=method.role if method else "method",
        status="failed",
        seconds={"bake": float(sum(ds.metadata.get("seconds", {}).values())), **(seconds or {})},
        dataset=_about(ds),
        provenance=provenance(),
    )


def errors(fitted: Model | None, ds: LightingDataset, asset: RuntimeAsset | None = None) -> Errors:
    """All error figures that need neither a renderer nor a clock, of the asset where there is one.

    The storage error needs both the fitted model and the asset. Lightings go through in chunks of bounded memory.
    """
    model = fitted if asset is None else asset.model()
    if model is None:
        raise ValueError("give errors() a fitted model, an asset, or both")
    span = None if model.span is None else np.asarray(orthonormal(jnp.asarray(model.span, jnp.float64)))
    parts = [_chunk_figures(fitted, asset, part, span) for part in _chunks(ds)]
    figures = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Errors(
        rmse=root_mean_square(np.sqrt(figures["square"])),
        relative_rmse=root_mean_square(figures["relative"]),
        psnr=mean(figures["psnr"]),
        negative_share=mean(figures["negative"]),
        energy_bias=mean(figures["energy"]),
        total=root_mean_square(figures["total"]),
        noise_floor=ds.noise_floor,
        projection=root_mean_square(figures["projection"]) if "projection" in figures else None,
        coefficient=root_mean_square(figures["coefficient"]) if "coefficient" in figures else None,
        storage=root_mean_square(figures["storage"]) if "storage" in figures else None,
        black_lightings=int(np.sum(np.isnan(figures["relative"]))),
    )


def split_name(ds: LightingDataset) -> str:
    """Which split of its dataset `ds` is; "all" when it is the whole."""
    return next((name for name, rows in ds.splits.items() if tuple(rows) == tuple(ds.rows)), "all")


def _chunk_figures(
    fitted: Model | None, asset: RuntimeAsset | None, ds: LightingDataset, span: Float[np.ndarray, "T B"] | None
) -> dict[str, Float[np.ndarray, " N"]]:
    reference, direct = np.asarray(ds.indirect, np.float64), np.asarray(ds.shown_direct, np.float64)
    sources = [source for source in (asset, fitted) if source is not None]
    # Where a method replaces direct light as well, its errors there count: for all others the direct light is exact.
    predictions = [np.asarray(source.predict(ds), np.float64) - source.includes_direct * direct for source in sources]
    prediction = predictions[0]
    figures = dict(lightmap_figures(prediction, reference))
    figures["total"] = relative_norm(prediction - reference, reference + direct)
    if sources[0].includes_direct:
        figures["negative"] = np.mean(prediction + direct < 0, axis=(1, 2))
    if len(predictions) == 2:
        figures["storage"] = relative_norm(prediction - predictions[1], reference)
    if span is not None:  # prediction − r splits into parts within and across the span, which are orthogonal
        columns = reference.reshape(len(reference), len(span), -1)  # channels apart, or interleaved like the span's
        best = np.einsum("tb,nbc->ntc", span, np.einsum("tb,ntc->nbc", span, columns, optimize=True), optimize=True)
        best = best.reshape(reference.shape)
        figures["projection"] = relative_norm(reference - best, reference)
        figures["coefficient"] = relative_norm(prediction - best, reference)
    return figures


def _chunks(ds: LightingDataset) -> list[LightingDataset]:
    """Consecutive lightings, few enough that their lightmaps in float64 stay within the budget."""
    first, last = ds.rows
    channels = ds.measured.shape[2]
    step = max(1, _CHUNK_BYTES // (8 * len(ds.points) * channels))
    return [replace(ds, rows=(row, min(row + step, last))) for row in range(first, last, step)]


def _sizes(asset: RuntimeAsset) -> dict[str, int]:
    basis = asset.bytes.get("basis", 0)
    return {"asset": sum(asset.bytes.values()), "basis": basis, "transfer": sum(asset.bytes.values()) - basis}


def _about(ds: LightingDataset) -> dict[str, Any]:
    keys = (
        "hash",
        "texels",
        "gather_texels",
        "streamed",
        "rays",
        "bounces",
        "measurements",
        "lightings",
        "channels",
        "effects",
        "noise",
        "force",
        "plan",
        "predicted",
        "actual",
    )
    return {key: ds.metadata[key] for key in keys if key in ds.metadata}
