"""Limbs that slip off the images are searched for in the same frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from support.oracle import BODY, Oracle
from twistcap.arrays import Bool
from twistcap.body import Pose, Posed
from twistcap.body.limbs import limbs
from twistcap.build import build
from twistcap.camera import Rig
from twistcap.cues.observation import Agreement
from twistcap.errors import InputError
from twistcap.search.judge import JudgeRule
from twistcap.search.slipped import LimbAgreement, SlippedLimbs
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import track

PARTS = len(BODY.segment_names)
ARM = ("arm_flex_r", "elbow_flex_r")


def _arm(limb: Bool) -> bool:
    return bool(limb[6 + BODY.coordinate(ARM[0])])


def test_limbs_are_branches_that_end_in_one_place() -> None:
    found = limbs(BODY)
    assert len(found) == 5  # head, arms and legs; the trunk carries more than one end
    assert not any(limb[:6].any() or limb[6 + BODY.coordinate("lumbar_bending")] for limb in found)
    assert [limb[6 + BODY.coordinate("elbow_flex_r")] for limb in found if _arm(limb)] == [True]


def _agreement(fraction: float, arm: float, points: int = 20) -> Agreement:
    """These fractions of the points of the right arm and of all else agree."""
    seen = np.full(PARTS, points, np.int32)
    moved = BODY.chain[:, BODY.coordinate("arm_flex_r")]
    agreeing = np.where(moved, arm, fraction) * seen
    return Agreement(seen, agreeing, agreeing)


def _judged(
    search: SlippedLimbs, *fractions: tuple[float, float], memory: LimbAgreement | None = None
) -> LimbAgreement:
    """After frames in which these fractions of all and of the right arm agreed."""
    memory = memory or search.start(BODY, Rig(()))
    for fraction in fractions:
        memory = search.judged(memory, _agreement(*fraction))
    return memory


def test_a_limb_slips_when_it_agrees_much_less_than_usual() -> None:
    search = SlippedLimbs()
    memory = search.start(BODY, Rig(()))
    for _ in range(30):  # one that never agreed better than by six tenths has not slipped
        memory = _judged(search, (0.9, 0.6), memory=memory)
        assert memory.slipped == ()
    for _ in range(10):  # what is not found is searched for again
        memory = _judged(search, (0.9, 0.3), memory=memory)
        (i,) = memory.slipped
        assert _arm(limbs(BODY)[i])
    memory = _judged(search, *[(0.9, 0.3)] * 101, memory=memory)
    assert memory.slipped == ()
    assert len(_judged(search, (0.0, 0.3), memory=memory).slipped) == 4
    assert search.judged(memory, _agreement(0.0, 0.0, points=1)).slipped == ()


def _slipped(search: SlippedLimbs) -> LimbAgreement:
    """The right arm has just slipped."""
    return _judged(search, (0.9, 0.9), (0.9, 0.9), (0.9, 0.1))


def test_a_forearm_that_folded_over_is_found_with_any_draws() -> None:
    truth = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    q = truth.q.copy()
    q[BODY.coordinate("elbow_flex_r")] = np.deg2rad(145.0)
    folded = Pose(truth.root, q)
    for seed in range(8):
        judge, search = Oracle(JudgeRule(), BODY, (), folded, truth), SlippedLimbs(seed=seed)
        found, (arm,) = search.found(_slipped(search), judge, folded, [folded])
        assert judge.evidence(found) > 0.9 * judge.evidence(truth)
        others = ~limbs(BODY)[arm][6:]
        np.testing.assert_array_equal(found.q[others], folded.q[others])
        assert np.all((found.q >= BODY.limits[:, 0]) & (found.q <= BODY.limits[:, 1]))


def test_little_gain_finds_nothing() -> None:
    truth = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    judge, search = Oracle(JudgeRule(), BODY, (), truth, truth), SlippedLimbs(draws=8)
    assert search.found(_slipped(search), judge, truth, [truth]) == (truth, [])


def test_joints_without_limits_are_drawn_within_half_a_turn() -> None:
    free = replace(BODY, limits=np.full_like(BODY.limits, np.inf) * [-1.0, 1.0])
    start = Pose(np.eye(4), np.full(BODY.dof - 6, 10.0))
    judge = Oracle(JudgeRule(), free, (), start, Pose(start.root, start.q + 0.8))
    search = SlippedLimbs(near=(0.1,))
    pose, found = search.found(_slipped(search), judge, start, [start])
    assert len(found) == 1
    assert np.all(np.abs(pose.q - start.q) < np.pi + 1.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: SlippedLimbs(draws=0), "draws is 0"),
        (lambda: SlippedLimbs(near=()), "near is empty"),
        (lambda: SlippedLimbs(memory=1.5), "memory is 1.5"),
        (lambda: SlippedLimbs(gain=float("nan")), "gain is nan"),
    ],
)
def test_settings_that_cannot_be_are_refused(wrong: Callable[[], SlippedLimbs], message: str) -> None:
    with pytest.raises(InputError, match=message):
        wrong()


def _swung() -> Capture:
    """A body at rest whose right arm is thrown forward, 35° from frame to frame, elbow bent on the way."""
    still = capture(StudioConfig(seed=0, views=3, frames=1), BODY).first_pose
    poses = []
    for k in range(12):
        q = still.q.copy()
        turned = np.clip(k - 5, 0, 4)
        q[BODY.coordinate("arm_flex_r")] += np.deg2rad(35.0) * turned
        q[BODY.coordinate("elbow_flex_r")] += np.deg2rad(15.0) * turned
        poses.append(Pose(still.root, q))
    return capture(StudioConfig(seed=0, views=3, frames=len(poses)), BODY, poses)


def test_an_arm_thrown_faster_than_a_contour_reaches_is_kept() -> None:
    scene = _swung()
    model = build(scene.body, scene.rig)

    def off(*searches: SlippedLimbs) -> float:
        """m by which the right hand is off at the end."""
        last = list(track(scene.frames(), replace(model, searches=searches), scene.first_pose))[-1]
        middles = [Posed(BODY, pose).segment_middles for pose in (last.pose, scene.true_poses[last.index])]
        return float(np.linalg.norm(np.subtract(*middles)[BODY.chain[:, BODY.coordinate(ARM[1])]][-1]))

    assert off() > 0.15
    assert [off(SlippedLimbs(seed=seed)) < 0.03 for seed in range(3)] == [True] * 3
