"""What errors are called and how they are computed: on lightmaps in W/m², and on rendered frames.

Lightmap figures are taken per lighting and then averaged, so that they can be gathered in chunks and every lighting
weighs the same. A lighting whose reference is black has no relative figures (NaN) and is left out of their averages.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

Figures = Mapping[str, Float[np.ndarray, " N"]]


def lightmap_figures(prediction: Float[np.ndarray, "N T C"], reference: Float[np.ndarray, "N T C"]) -> Figures:
    """Figures of each lighting: `square` [W²/m⁴], `relative` ‖e‖/‖r‖, `psnr` [dB], `negative` share, `energy` bias."""
    prediction, reference = np.asarray(prediction, np.float64), np.asarray(reference, np.float64)
    square = np.mean((prediction - reference) ** 2, axis=(1, 2))
    with np.errstate(divide="ignore"):
        psnr = 20.0 * np.log10(_or_nan(np.max(reference, axis=(1, 2)))) - 10.0 * np.log10(square)
    return {
        "square": square,
        "relative": relative_norm(prediction - reference, reference),
        "psnr": psnr,
        "negative": np.mean(prediction < 0, axis=(1, 2)),
        "energy": np.mean(prediction, axis=(1, 2)) / _or_nan(np.mean(reference, axis=(1, 2))) - 1.0,
    }


def relative_norm(error: Float[np.ndarray, "N T C"], reference: Float[np.ndarray, "N T C"]) -> Float[np.ndarray, " N"]:
    """‖error‖ / ‖reference‖ of each lighting; NaN where the reference is black."""
    return np.sqrt(np.sum(np.square(error, dtype=np.float64), axis=(1, 2))) / _or_nan(
        np.sqrt(np.sum(np.square(reference, dtype=np.float64), axis=(1, 2)))
    )


def root_mean_square(values: Float[np.ndarray, " N"]) -> float | None:
    """Root mean square over the lightings that have the figure; None when none has."""
    found = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(found**2))) if found.size else None


def mean(values: Float[np.ndarray, " N"]) -> float | None:
    """Mean over the lightings that have a finite figure (the PSNR of an exact prediction is infinite); None when none has."""
    found = values[np.isfinite(values)]
    return float(np.mean(found)) if found.size else None


def rmse(prediction: Float[np.ndarray, "N T C"], reference: Float[np.ndarray, "N T C"]) -> float:
    """Root mean square error over all lightings, points and channels, in W/m²."""
    return float(np.sqrt(np.mean(np.square(np.subtract(prediction, reference, dtype=np.float64)))))


def relative_rmse(prediction: Float[np.ndarray, "N T C"], reference: Float[np.ndarray, "N T C"]) -> float | None:
    """Root mean square over lit lightings of ‖error‖ / ‖reference‖; None when all are black."""
    return root_mean_square(lightmap_figures(prediction, reference)["relative"])


def psnr(prediction: Float[np.ndarray, "N T C"], reference: Float[np.ndarray, "N T C"]) -> float | None:
    """Mean over lit lightings of the peak signal-to-noise ratio in dB, the peak being each lighting's largest value."""
    return mean(lightmap_figures(prediction, reference)["psnr"])


def negative_share(prediction: Float[np.ndarray, "N T C"]) -> float:
    """Share of predicted values that are below zero, which no light is."""
    return float(np.mean(np.asarray(prediction) < 0))


def energy_bias(prediction: Float[np.ndarray, "N T C"], reference: Float[np.ndarray, "N T C"]) -> float | None:
    """Mean over lit lightings of the relative error of the mean irradiance, signed."""
    return mean(lightmap_figures(prediction, reference)["energy"])


def temporal_error(prediction: Float[np.ndarray, "F T C"], reference: Float[np.ndarray, "F T C"]) -> float | None:
    """‖Δprediction − Δreference‖ / ‖Δreference‖ over all changes Δ between consecutive frames; None when nothing changes.

    For frames under a slowly moving light. A constant error cancels; what jumps where the light moves smoothly, or stays
    where it should move, counts: 0 is motion as it should be, 1 a prediction that stands still, more a flicker stronger
    than the motion. Second differences would see flicker alone, but depend on the frame rate even where both are smooth.
    """
    motion = np.diff(np.asarray(reference, np.float64), axis=0)
    size = np.linalg.norm(motion)
    return float(np.linalg.norm(np.diff(np.asarray(prediction, np.float64), axis=0) - motion) / size) if size else None


def flip(frame: Float[np.ndarray, "H W 3"], reference: Float[np.ndarray, "H W 3"]) -> float:
    """Mean LDR-FLIP (Andersson et al. 2020) of sRGB frames in [0, 1], at 67 pixels per degree; 0 is identical."""
    import flip_evaluator

    target, picture = (np.ascontiguousarray(image, np.float32) for image in (reference, frame))
    return float(flip_evaluator.evaluate(target, picture, "LDR", applyMagma=False)[1])


def ssim(frame: Float[np.ndarray, "H W 3"], reference: Float[np.ndarray, "H W 3"]) -> float:
    """Structural similarity (Wang et al. 2004, Gaussian windows) of sRGB frames in [0, 1]; 1 is identical."""
    from skimage.metrics import structural_similarity

    frame, reference = np.asarray(frame, np.float64), np.asarray(reference, np.float64)
    return float(
        structural_similarity(
            reference,
            frame,
            channel_axis=-1,
            data_range=1.0,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )


def _or_nan(values: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    return np.where(values > 0, values, np.nan)
