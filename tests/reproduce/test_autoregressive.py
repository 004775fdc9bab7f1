"""Linear prediction: what it learns of motion that is linear, what it leaves out, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from reproduce.autoregressive import AutoregressiveMotion
from twistcap import se3
from twistcap.arrays import Float
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.motion import MotionClip, MotionLibrary
from twistcap.motion.openloop import PoseSequence

BODY = humanoid("legs")
J = len(BODY.coordinate_names)


def swinging(count: int, phase: float, turn: float = 0.0) -> MotionClip:
    """Joints that swing as sines of one frequency, a root that goes straight on: exactly an autoregression."""
    t = np.arange(count)[:, None]
    q = 0.4 * np.sin(2 * np.pi * t / 55 + phase + np.linspace(0, 3, J))
    roots = se3.exp(np.array([0.0, 0.0, turn, 0.0, 0.0, 0.0])) @ se3.exp(t * np.array([0, 0, 0, 0.02, 0, 0]))
    return MotionClip("swing", BODY.coordinate_names, 60.0, roots, q)


def library(*clips: MotionClip) -> MotionLibrary:
    return MotionLibrary.of(clips, 60.0, BODY.coordinate_names)


def rolled(predictor: AutoregressiveMotion, clip: MotionClip, seen: int, count: int) -> PoseSequence:
    return predictor.roll(PoseSequence(clip.q[:seen], clip.roots[:seen]), count)


def test_a_linear_motion_is_predicted_wherever_it_stands_and_heads() -> None:
    predictor = AutoregressiveMotion(library(swinging(200, 0.0)), BODY, ridge=1e-9)
    clip = swinging(100, 1.3, turn=2.0)
    found = rolled(predictor, clip, 40, 45)
    np.testing.assert_allclose(found.q, clip.q[40:85], atol=1e-3)
    np.testing.assert_allclose(found.roots, clip.roots[40:85], atol=1e-3)


def test_the_ridge_is_that_of_the_normal_equations_of_augmented_rows() -> None:
    """The same coefficients as least squares with one more row for each coefficient."""
    predictor = AutoregressiveMotion(library(swinging(90, 0.0), swinging(90, 1.0)), BODY, order=2, ridge=1e-2)
    x, y = predictor._x, predictor._y
    diagonal = np.sum(x * x, axis=0)
    rows = np.diag(np.sqrt(1e-2 * np.maximum(diagonal, 1e-3 * diagonal.max())))
    whole = np.concatenate([x, rows]), np.concatenate([y, np.zeros((len(rows), y.shape[1]))])
    np.testing.assert_allclose(predictor._coefficients, np.linalg.lstsq(*whole, rcond=None)[0], atol=1e-7)


def test_barred_stretches_are_not_learnt_from() -> None:
    """What the rest of the library says, as if the excluded clip were not there."""
    slow, fast = swinging(150, 0.0), MotionClip("other", BODY.coordinate_names, 60.0, *_faster(150))
    both, alone = (AutoregressiveMotion(library(*clips), BODY) for clips in ((slow, fast), (slow,)))
    past = PoseSequence(slow.q[:40], slow.roots[:40])
    excluded = both.roll(past, 20, [(1, -1.0, 150.0)])
    np.testing.assert_allclose(excluded.q, alone.roll(past, 20).q, atol=1e-6)
    assert np.abs(both.roll(past, 20).q - excluded.q).max() > 1e-3


def _faster(count: int) -> tuple[Float, Float]:
    clip = swinging(2 * count, 0.4)
    return clip.roots[::2], clip.q[::2]


def test_it_stays_within_what_the_library_has() -> None:
    predictor = AutoregressiveMotion(library(swinging(120, 0.0)), BODY)
    wild = swinging(60, 0.0)
    found = predictor.roll(PoseSequence(wild.q * 0.5 + np.linspace(0, 0.3, 60)[:, None], wild.roots), 300)
    assert np.abs(found.q).max() < 0.4 + 0.2 + 1e-6


def test_a_short_history_goes_on_as_before() -> None:
    predictor, clip = AutoregressiveMotion(library(swinging(120, 0.0)), BODY), swinging(3, 0.0)
    found = predictor.next_poses(PoseSequence(clip.q, clip.roots), 1)
    np.testing.assert_allclose(found.q[0], clip.q[-1] + np.diff(clip.q, axis=0).mean(axis=0))


def test_it_learns_its_own_spread() -> None:
    predictor = AutoregressiveMotion(library(swinging(300, 0.0)), BODY)
    turn, shift, joints = predictor.spread.variances(8.0)
    assert 0 < turn < 0.1 and 0 < shift < 0.1 and np.all((joints > 0) & (joints < 0.1))


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="order and a stride"):
        AutoregressiveMotion(library(swinging(100, 0.0)), BODY, order=0)
    with pytest.raises(InputError, match="positive ridge"):
        AutoregressiveMotion(library(swinging(100, 0.0)), BODY, ridge=0.0)
    with pytest.raises(InputError, match="every clip is shorter"):
        AutoregressiveMotion(library(swinging(10, 0.0)), BODY)
