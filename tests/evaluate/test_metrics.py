"""Error measures against numbers worked out by hand."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from twistcap.camera import Camera, look_at
from twistcap.evaluate import metrics


def test_angle_difference_is_signed_wrapped_and_in_degrees() -> None:
    estimate = np.radians([[10.0, 179.0], [0.0, -179.0]])
    reference = np.radians([[12.0, -179.0], [-1.0, 179.0]])
    np.testing.assert_allclose(metrics.angle_differences_deg(estimate, reference), [[-2, -2], [1, 2]], atol=1e-9)


def test_unknown_reference_is_left_out_but_a_missing_estimate_is_infinitely_wrong() -> None:
    difference = metrics.differences(np.array([1.0, np.nan, 1.0]), np.array([0.5, 0.0, np.nan]))
    assert difference[0] == 0.5
    assert difference[1] == np.inf
    assert np.isnan(difference[2])
    assert metrics.mean_known(difference) == math.inf


def test_offset_is_one_vector_per_joint() -> None:
    truth = np.random.default_rng(0).normal(size=(5, 2, 3))
    shifted = truth + np.array([[0.003, 0.0, 0.004], [0.0, 0.01, 0.0]])
    difference = metrics.differences(shifted, truth)
    np.testing.assert_allclose(metrics.distances_mm(difference).mean(axis=0), [5, 10])
    np.testing.assert_allclose(metrics.distances_mm(metrics.without_offset(difference)), 0, atol=1e-9)


def test_offset_of_angles_leaves_the_variation() -> None:
    difference = np.array([[1.0], [3.0], [np.nan], [np.inf]])
    np.testing.assert_allclose(metrics.without_offset(difference), [[-1], [1], [np.nan], [np.inf]])


def test_khe_averages_only_its_own_coordinates() -> None:
    names = ("knee_angle_r", "hip_rotation_r", "elbow_flex_l", "hip_adduction_l")
    difference = np.array([[1.0, 90.0, -2.0, 3.0], [1.0, 90.0, 2.0, -3.0]])
    assert metrics.khe_deg(difference, names) == pytest.approx(2.0)
    assert math.isnan(metrics.khe_deg(difference, ("a", "b", "c", "d")))


def test_percentiles_keep_infinities_apart() -> None:
    assert metrics.percentile_known(np.array([1.0, 2.0, 3.0, np.nan]), 50) == 2.0
    assert metrics.percentile_known(np.array([1.0, np.inf, np.inf]), 95) == math.inf
    assert metrics.percentile_known(np.array([1.0, 2.0, np.inf]), 50) == 2.0


def test_lost_frames_and_lost_sequence() -> None:
    errors = np.array([[10.0, 149.0], [10.0, 151.0], [np.nan, 1.0], [np.inf, 1.0]])
    assert metrics.lost_frames(errors).tolist() == [False, True, False, True]
    assert not metrics.lost_sequence(np.full((3, 2), 20.0))
    assert metrics.lost_sequence(np.full((3, 2), 20.1))


def test_iou_of_overlapping_rectangles() -> None:
    a, b = np.zeros((10, 10), bool), np.zeros((10, 10), np.uint8)
    a[:, :6], b[:, 4:] = True, 255
    assert metrics.iou(a, b) == pytest.approx(20 / 100)
    assert metrics.iou(a & False, b & 0) == 1.0


def test_silhouette_of_a_square_covers_its_pixels() -> None:
    camera = Camera("c", np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), look_at((5, 0, 0), (0, 0, 0)), (101, 81))
    corners = np.array([[0.0, -1.02, -0.98], [0, 1.02, -0.98], [0, 1.02, 0.98], [0, -1.02, 0.98]])
    mask = metrics.silhouette(camera.P, corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), camera.size)
    expected = np.zeros((81, 101), bool)
    expected[21:60, 30:71] = True  # 100 px / 5 m: half sides of 20.4 and 19.6 px about (50, 40)
    np.testing.assert_array_equal(mask, expected)


def test_z_scores_of_errors_drawn_from_the_covariance() -> None:
    rng = np.random.default_rng(1)
    factor = np.array([[0.1, 0.0], [0.3, 0.2]])
    covariance = np.broadcast_to(factor @ factor.T, (4000, 2, 2))
    error = rng.normal(size=(4000, 2)) @ factor.T
    z = metrics.z_scores(error, covariance)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.03)
    assert metrics.within_sigmas(z, 2.0) == pytest.approx(0.954, abs=0.01)
    assert metrics.within_sigmas(3 * z, 2.0) < 0.6


def test_z_score_of_a_fixed_coordinate_is_unknown() -> None:
    z = metrics.z_scores(np.array([[1.0, 0.0]]), np.array([[[4.0, 0.0], [0.0, 0.0]]]))
    assert z[0, 0] == 0.5
    assert np.isnan(z[0, 1])


def test_rows_tell_whether_the_target_holds_and_are_json() -> None:
    low = metrics.row("4 views", "KHE", 0.6, "deg", at_most=0.7, seeds=range(8), lost=0)
    high = metrics.row("real", "IoU", 0.8, "", at_least=0.83)
    bad = metrics.row("real", "joints", math.nan, "mm", at_most=30)
    assert (low["target"], low["holds"], low["seeds"]) == ("≤ 0.7", True, [0, 1, 2, 3, 4, 5, 6, 7])
    assert high["holds"] is False
    assert bad["value"] is None and bad["holds"] is False
    json.dumps([low, high, bad], allow_nan=False)
