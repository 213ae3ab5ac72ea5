"""Metrics against closed forms."""

import numpy as np
import pytest

from prt_bench import metrics

RNG = np.random.default_rng(0)
REFERENCE = RNG.uniform(0.5, 2.0, (5, 40, 3))


def test_uniform_scaling_has_closed_forms():
    """A prediction that is 10 % too bright everywhere."""
    prediction = 1.1 * REFERENCE
    assert metrics.relative_rmse(prediction, REFERENCE) == pytest.approx(0.1)
    assert metrics.energy_bias(prediction, REFERENCE) == pytest.approx(0.1)
    assert metrics.rmse(prediction, REFERENCE) == pytest.approx(0.1 * np.sqrt(np.mean(REFERENCE**2)))
    peaks = REFERENCE.max(axis=(1, 2)) / np.sqrt(np.mean((0.1 * REFERENCE) ** 2, axis=(1, 2)))
    assert metrics.psnr(prediction, REFERENCE) == pytest.approx(np.mean(20 * np.log10(peaks)))


def test_every_lighting_weighs_the_same_in_relative_figures():
    scale = np.array([1e-6, 1e-3, 1.0, 1e3, 1e6])[:, None, None]
    prediction = REFERENCE * (1 + np.array([0.1, 0.2, 0.3, 0.4, 0.5]))[:, None, None]
    expected = np.sqrt(np.mean(np.array([0.1, 0.2, 0.3, 0.4, 0.5]) ** 2))
    assert metrics.relative_rmse(scale * prediction, scale * REFERENCE) == pytest.approx(expected)


def test_black_lightings_are_left_out_of_relative_figures():
    black = np.concatenate([REFERENCE, np.zeros((1, 40, 3))])
    predicted = np.concatenate([1.1 * REFERENCE, np.ones((1, 40, 3))])
    assert metrics.relative_rmse(predicted, black) == pytest.approx(0.1)
    assert metrics.relative_rmse(predicted[-1:], black[-1:]) is None
    assert metrics.rmse(predicted[-1:], black[-1:]) == 1.0


def test_temporal_error_has_closed_forms():
    """A light that brightens evenly: errors that stay, scale, stand still, and flicker by ± d."""
    motion = np.arange(7.0)[:, None, None] * REFERENCE[0] + 5.0
    assert metrics.temporal_error(motion + REFERENCE[1], motion) == pytest.approx(0.0, abs=1e-12)
    assert metrics.temporal_error(1.3 * motion, motion) == pytest.approx(0.3)
    assert metrics.temporal_error(0.0 * motion, motion) == pytest.approx(1.0)
    flicker = 0.2 * REFERENCE[2] * (-1.0) ** np.arange(7)[:, None, None]
    expected = 0.4 * np.linalg.norm(REFERENCE[2]) / np.linalg.norm(REFERENCE[0])
    assert metrics.temporal_error(motion + flicker, motion) == pytest.approx(expected)
    assert metrics.temporal_error(REFERENCE, np.ones_like(REFERENCE)) is None


def test_negative_share_counts_values():
    values = np.ones((2, 5, 1))
    values[0, :2] = -1e-9
    assert metrics.negative_share(values) == pytest.approx(0.2)


def test_rmse_of_the_figures_is_the_rmse_of_the_whole():
    prediction = REFERENCE + RNG.normal(size=REFERENCE.shape)
    squares = metrics.lightmap_figures(prediction, REFERENCE)["square"]
    assert metrics.root_mean_square(np.sqrt(squares)) == pytest.approx(metrics.rmse(prediction, REFERENCE))


def test_float32_input_is_summed_in_float64():
    reference = np.full((1, 1 << 20, 3), 0.1, np.float32)
    assert metrics.relative_rmse(reference * np.float32(1.5), reference) == pytest.approx(0.5, abs=1e-7)


def test_frame_metrics_at_their_ends():
    frame = np.clip(RNG.uniform(0, 1, (64, 64, 3)), 0, 1)
    assert metrics.flip(frame, frame) == pytest.approx(0.0, abs=1e-6)
    assert metrics.ssim(frame, frame) == pytest.approx(1.0)
    black, white = np.zeros((64, 64, 3)), np.ones((64, 64, 3))
    assert metrics.flip(black, white) > 0.9
    assert metrics.ssim(black, white) < 0.01


def test_frame_metrics_grow_with_the_error():
    frame = np.tile(np.linspace(0.2, 0.8, 64)[None, :, None], (64, 1, 3))
    noise = RNG.normal(size=frame.shape)
    noisy = [np.clip(frame + scale * noise, 0, 1) for scale in (0.01, 0.05, 0.2)]
    flips, ssims = ([metric(picture, frame) for picture in noisy] for metric in (metrics.flip, metrics.ssim))
    assert flips == sorted(flips)
    assert ssims == sorted(ssims, reverse=True)
