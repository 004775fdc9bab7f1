"""The person's own past as training motion."""

from __future__ import annotations

import numpy as np
import pytest

from support.motion import ahead
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.motion import FollowedMotion, FollowRule, MotionClip, MotionLibrary, RecurrenceRule
from twistcap.motion.following import OWN, recurrences
from twistcap.motion.openloop import PoseSequence
from twistcap.predict import Moment
from twistcap.studio.motion import gait

BODY = humanoid("legs")
FPS = 60.0
KNEES = [BODY.coordinate(f"knee_angle_{side}") for side in "rl"]


def walking(frames: int, speed: float) -> MotionClip:
    poses = gait(BODY, fps=FPS, frames=frames, speed=speed)
    return MotionClip(
        "walk", BODY.coordinate_names, FPS, np.array([p.root for p in poses]), np.array([p.q for p in poses])
    )


def test_the_lags_of_a_cycle_are_found() -> None:
    """Joints that swing with a period of 40 frames recur 40 and 80 frames earlier, and nowhere else."""
    t = 2 * np.pi * np.arange(130) / 40
    q = np.stack([np.sin(t), 0.5 * np.cos(t), 0.3 * np.sin(2 * t)], axis=1)
    found = recurrences(q, RecurrenceRule())
    assert sorted(match.position for match in found) == [49.0, 89.0]
    assert all(match.distance < 1e-9 for match in found)


@pytest.mark.parametrize("still", ["standing", "drifting"])
def test_what_hardly_moves_or_never_returns_does_not_recur(still: str) -> None:
    rng = np.random.default_rng(0)
    drift = np.linspace(0, 3.0, 130)[:, None] if still == "drifting" else 0.0
    assert recurrences(drift + 0.003 * rng.normal(size=(130, 3)), RecurrenceRule()) == []


def test_a_past_shorter_than_a_cycle_and_a_half_holds_nothing() -> None:
    assert recurrences(np.zeros((20, 3)), RecurrenceRule()) == []
    assert recurrences(np.zeros((0, 3)), RecurrenceRule()) == []


def test_the_own_cycle_leads_where_the_library_knows_others_only() -> None:
    """A gait that differs from the library's in its knees is followed nearer by its own last cycle."""
    clip = walking(180, 1.3)
    odd = clip.q.copy()
    odd[:, KNEES] = 0.6 * odd[:, KNEES] + np.radians(10) * np.sin(2 * np.arcsin(np.sin(clip.q[:, [0]] * 2)))
    seen = [Moment(k / FPS, pose) for k, pose in enumerate(MotionClip("odd", clip.names, FPS, clip.roots, odd).poses())]
    library = MotionLibrary.of([walking(240, 1.1)], FPS)

    def knees(lead: float) -> tuple[float, int]:
        predictor = FollowedMotion(library, BODY, FollowRule(recurrence=RecurrenceRule(lead=lead)))
        found = ahead(predictor, seen[:120], [moment.time for moment in seen[120:160]])
        wrong = [e.pose.q[KNEES] - m.pose.q[KNEES] for e, m in zip(found, seen[120:160], strict=True)]
        match = found[-1].match
        assert match is not None
        return float(np.degrees(np.abs(wrong).mean())), match.clip

    (own, source), (others, elsewhere) = knees(1.5), knees(0.0)
    assert source == OWN and elsewhere == 0
    assert own < 0.5 * others


def test_what_was_copied_does_not_pass_for_a_better_match() -> None:
    """Rolling on over cycles that it made itself, a prediction stays as unlike as its first match was."""
    predictor = FollowedMotion(MotionLibrary.of([walking(240, 1.1)], FPS), BODY)
    clip = walking(130, 1.3)
    wavering = clip.q + 0.02 * np.random.default_rng(0).normal(size=clip.q.shape)
    past = PoseSequence(wavering, clip.roots)
    first, far = predictor.next_poses(past, 5).match, predictor.roll(past, 200).match
    assert first is not None and far is not None
    assert far.distance >= first.distance > 0.01


def test_bad_rules_are_told() -> None:
    for wrong in ({"poses": 0}, {"lead": float("nan")}, {"count": 0}, {"poses": 120}):
        with pytest.raises(InputError, match=r"poses must be 1 to 119|lead is|count is|poses is"):
            RecurrenceRule(**wrong)
