"""Runtime assets: what a fitted model ships, and the one thing accuracy and speed are both measured from.

An asset is a folder of `weights.safetensors` and `manifest.json` (kernels of the three stages, dtypes, shapes, SHA-256).
Methods write it, the runtime and `evaluate` read it; nothing else passes between them.
"""

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.numpy import load, save

from prt_bench.clustered import ClusteredModel
from prt_bench.errors import AssetError
from prt_bench.gamma import GammaCoupledModel, GammaLinearModel
from prt_bench.glossy import BouncedTripleModel, FixedTripleModel, TripleModel
from prt_bench.harmonic import HarmonicIndirectModel, HarmonicModel, VertexHarmonicModel
from prt_bench.learned.fields import FieldModel
from prt_bench.learned.models import ResidualModel
from prt_bench.learned.transfer import HarmonicFieldModel
from prt_bench.models import CoupledModel, LinearModel, Model, NearestModel

FORMAT = "prt-bench runtime asset"
VERSION = 1
_MODELS: tuple[type[Model], ...] = (
    LinearModel,
    CoupledModel,
    ClusteredModel,
    GammaLinearModel,
    GammaCoupledModel,
    NearestModel,
    ResidualModel,
    FieldModel,
    HarmonicFieldModel,
    HarmonicModel,
    HarmonicIndirectModel,
    VertexHarmonicModel,
    TripleModel,
    FixedTripleModel,
    BouncedTripleModel,
)
DTYPES = ("float32", "float16")
"""What a basis can be stored in."""


@dataclass(frozen=True, eq=False)
class RuntimeAsset:
    """Weights and kernels of one model, as loaded from disk.

    `arrays` are the stored (quantised) weights, `kernels` names the runtime kernel of each stage, `sha256` is the hash of
    the weights file, `bytes` the size of each array.
    """

    path: Path
    kernels: dict[str, str]
    arrays: dict[str, np.ndarray]
    dtype: str
    sha256: str

    @property
    def bytes(self) -> dict[str, int]:
        """Bytes of each stored array that a runtime needs."""
        left_out = _model_class(self.kernels).compared
        return {name: array.nbytes for name, array in self.arrays.items() if name not in left_out}

    @property
    def includes_direct(self) -> bool:
        """Whether it replaces direct light too, so that the runtime draws none and no shadow maps."""
        return self.kernels.get("direct") == "included"

    def model(self) -> Model:
        """The model with the weights as stored, computing in float32: what the runtime is compared with."""
        weights = {name: jnp.asarray(array, jnp.float32) for name, array in self.arrays.items()}
        return _model_class(self.kernels).from_arrays(weights)

    def predict(self, ds: object) -> Float[np.ndarray, "N T C"]:
        """Indirect irradiance from the stored weights, in float32; with the direct where the asset includes it."""
        model = self.model()
        x = jnp.asarray(model.measure(ds), jnp.float32)  # pyright: ignore[reportArgumentType]
        return np.asarray(model.reconstruct(model.transfer(x)))


def write_asset(model: Model, path: Path, dtype: str = "float32") -> RuntimeAsset:
    """Write `model` to the folder `path` in one step (a half-written asset is never visible) and load it back.

    The basis, and the matrices of networks, are stored in `dtype`; a linear transfer stays float32. Raises `AssetError` for
    weights that are not finite or overflow `dtype`.
    """
    if dtype not in DTYPES:
        raise AssetError(f"assets store {' or '.join(DTYPES)}, not '{dtype}'")
    if not model.kernels:
        raise AssetError(
            f"{type(model).__name__} is an oracle: it needs the answer to predict it, so it has no runtime asset"
        )
    with np.errstate(over="ignore"):  # an overflow is refused below, with its name
        stored = {
            name: np.ascontiguousarray(array, dtype if name.startswith(model.narrow) else "float32")
            for name, array in model.arrays().items()
        }
    for name, array in stored.items():
        if not np.all(np.isfinite(array)):
            raise AssetError(
                f"weights '{name}' are not finite in {array.dtype}; store them in a wider dtype or rescale the light"
            )
    payload = save(stored)
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "kernels": model.kernels,
        "dtype": dtype,
        "arrays": {name: {"shape": list(a.shape), "dtype": str(a.dtype)} for name, a in stored.items()},
        "sha256": hashlib.sha256(payload).hexdigest(),
    }
    if path.exists() and not (path / "manifest.json").is_file():
        raise AssetError(f"{path} exists and is not a runtime asset; choose another folder")
    partial = path.with_name(path.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        (partial / "weights.safetensors").write_bytes(payload)
        (partial / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    except OSError:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    shutil.rmtree(path, ignore_errors=True)
    partial.rename(path)
    return load_asset(path)


def load_asset(path: str | Path) -> RuntimeAsset:
    """Load an asset. Raises `AssetError` when it is missing, truncated, altered, or of a version this code cannot read."""
    path = Path(path)
    try:
        manifest = json.loads((path / "manifest.json").read_text(encoding="utf-8"))
        payload = (path / "weights.safetensors").read_bytes()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise AssetError(f"{path} is not a runtime asset: {Path(error.filename).name} is missing") from error
    except ValueError as error:
        raise AssetError(f"{path / 'manifest.json'} is not valid JSON; export the model again") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise AssetError(f"{path / 'manifest.json'} is not the manifest of a runtime asset")
    if manifest.get("version") != VERSION:
        raise AssetError(
            f"{path} is a runtime asset of version {manifest.get('version')}, but this prt-bench reads version {VERSION}"
        )
    missing = [key for key in ("kernels", "dtype", "sha256") if key not in manifest]
    if missing:
        raise AssetError(f"the manifest {path / 'manifest.json'} lacks {', '.join(missing)}; export the model again")
    found = hashlib.sha256(payload).hexdigest()
    if found != manifest["sha256"]:
        raise AssetError(f"{path / 'weights.safetensors'} is truncated or altered: its SHA-256 is not the manifest's")
    try:
        arrays = load(payload)
    except SafetensorError as error:
        raise AssetError(f"{path / 'weights.safetensors'} cannot be read ({error}); export the model again") from error
    _model_class(manifest["kernels"])
    return RuntimeAsset(path, manifest["kernels"], arrays, manifest["dtype"], found)


def _model_class(kernels: dict[str, str]) -> type[Model]:
    for model in _MODELS:
        if model.kernels == kernels:
            return model
    raise AssetError(f"no model of this version has the kernels {kernels}")
