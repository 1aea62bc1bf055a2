"""Pairs of cameras that contradict each other about the surface."""

import numpy as np
from measurement_cases import RATE

from wavefield.measurement import measure
from wavefield.measurement.outliers import inconsistent_scores
from wavefield.variables import Quality

SHAPE = 60, 80


def scores_of_pairs(shift: float, rng: np.random.Generator) -> list[list[np.ndarray]]:
    """Scores, Hessians and lengths of two pairs; in the left half the second pair has z elsewhere."""
    length = np.full(SHAPE, 400.0, np.float32)  # px per metre
    hessian = np.square(length) * rng.uniform(0.0, 600.0, SHAPE).astype(np.float32)
    noise = [np.sqrt(hessian) * rng.standard_normal(SHAPE).astype(np.float32) for _ in range(2)]
    noise[1][:, :40] += (hessian * shift / length)[:, :40]
    return [noise, [hessian, hessian], [length, length]]


def test_pairs_that_place_the_surface_elsewhere_are_found_where_they_do():
    apart = inconsistent_scores(*scores_of_pairs(1.3, np.random.default_rng(1)))
    assert apart[:, :36].all()
    assert not apart[:, 48:].any()


def test_a_camera_moved_by_one_pixel_in_half_its_picture_is_left_out_there(series, geometry, model):
    frames = series.block(1)
    half = frames["cam1"][0].shape[1] // 2
    moved = [np.hstack([np.roll(image, 1, axis=1)[:, :half], image[:, half:]]) for image in frames["cam1"]]
    out = measure(frames | {"cam1": moved}, geometry, RATE, model)
    measured = (out["quality"][0] & Quality.MEASURED) > 0
    wrong = np.abs(out["z"][0] - series.truth[1]["z"]) > 5 * out["z_std"][0]
    assert 0.3 < measured[series.inside].mean() < 0.7
    assert (wrong & measured)[series.inside].mean() < 0.01
    assert wrong[series.inside].mean() > 0.2  # it does harm where it is not measured
