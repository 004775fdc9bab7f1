"""Predictions from training motion: what they take over from the sample, and what they tell of themselves."""

from __future__ import annotations

import numpy as np
import pytest

from support.motion import ahead
from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.motion import FollowedMotion, FollowRule, MotionClip, MotionLibrary, PaperMotion
from twistcap.motion.following import adapted, leverage, misplaced, placed
from twistcap.motion.openloop import bridged
from twistcap.motion.paper import root_speed, transferred
from twistcap.predict import Moment
from twistcap.studio.motion import gait

BODY = humanoid("legs")
FPS = 60.0


def motion(rng: np.random.Generator) -> Float:
    return se3.exp(rng.normal(0, 1, 6))


def walking(seconds: float, speed: float, heading: float = 0.0) -> MotionClip:
    poses = gait(BODY, fps=FPS, frames=int(seconds * FPS), speed=speed, heading=heading)
    return MotionClip(
        "walk", BODY.coordinate_names, FPS, np.array([p.root for p in poses]), np.array([p.q for p in poses])
    )


def moments(clip: MotionClip) -> list[Moment]:
    return [Moment(5.0 + k / clip.rate, pose) for k, pose in enumerate(clip.poses())]


def library(*clips: MotionClip) -> MotionLibrary:
    return MotionLibrary.of(clips, FPS)


def test_the_root_moves_as_the_sample_sees_itself_move() -> None:
    """``D M = M M̃⁻¹ M̃'``, wherever the two stand."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        root, before, after = motion(rng), motion(rng), motion(rng)
        np.testing.assert_allclose(
            transferred(root, before, after, None, 0.0), root @ se3.inverse(before) @ after, atol=1e-9
        )


def test_the_twist_is_scaled_by_the_speeds() -> None:
    """A straight way is covered at the person's speed; a standing sample is taken as it is, a wild ratio is cut."""
    root, before = se3.exp(np.array([0.1, -0.2, 1.0, 3.0, 2.0, 1.0])), np.eye(4)
    after = se3.transform(np.eye(3), np.array([0.02, 0.0, 0.0]))
    moved = transferred(root, before, after, 0.03, 1e-3)
    np.testing.assert_allclose(moved[:3, 3] - root[:3, 3], root[:3, :3] @ [0.03, 0, 0], atol=1e-12)
    standing = se3.exp(np.array([0.0, 0.0, 0.01, 1e-5, 0.0, 0.0]))
    np.testing.assert_allclose(transferred(root, before, standing, 0.03, 1e-3), root @ standing, atol=1e-12)
    creeping = se3.transform(np.eye(3), np.array([0.002, 0.0, 0.0]))
    assert np.linalg.norm((transferred(root, before, creeping, 1.0, 1e-3) - root)[:3, 3]) == pytest.approx(0.008)
    assert root_speed(np.array([np.eye(4), after, after @ after])) == pytest.approx(0.02)


def test_scaled_prediction_is_eq_18_and_the_increment() -> None:
    clip = walking(3.0, 1.0)
    predictor = PaperMotion(library(clip), BODY)
    seen = moments(walking(1.0, 1.7, heading=0.7))[:40]
    expected, _ = predictor.predict(seen, seen[-1].time + 1 / FPS)
    match = expected.match
    assert match is not None and match.scale < 1.0  # the library walks slower: it is passed faster
    samples = predictor.library.angles(match.clip, np.array([match.position, match.position + 1 / match.scale]))
    np.testing.assert_allclose(expected.pose.q, seen[-1].pose.q + samples[1] - samples[0], atol=1e-9)
    speed = root_speed(np.array([m.pose.root for m in seen[-5:]]))
    assert np.linalg.norm((expected.pose.root - seen[-1].pose.root)[:3, 3]) == pytest.approx(speed, rel=1e-3)


def test_standard_prediction_goes_on_as_before() -> None:
    twist, rate = np.array([0.0, 0.0, 0.02, 0.01, 0.0, 0.005]), np.linspace(-0.02, 0.02, len(BODY.coordinate_names))
    seen = [Moment(k / FPS, Pose(se3.exp(k * twist), k * rate)) for k in range(8)]
    predictor = PaperMotion(library(walking(2.0, 1.2)), BODY, "standard")
    expected, _ = predictor.predict(seen, 17 / FPS)
    np.testing.assert_allclose(expected.pose.q, 17 * rate, atol=1e-9)
    np.testing.assert_allclose(expected.pose.root, se3.exp(17 * twist), atol=1e-9)


@pytest.mark.parametrize("speed", [1.0, 1.5])
def test_followed_motion_carries_on_at_another_speed_and_heading(speed: float) -> None:
    """Half a second without any image: knees, place and heading stay right, the paper's form is worse."""
    training, clip = library(walking(4.0, 1.25)), walking(2.5, speed, heading=2.0)
    seen, last = moments(clip), 70
    truth = seen[last + 30]
    found, _ = FollowedMotion(training, BODY).predict(seen[: last + 1], truth.time)
    knees = [BODY.coordinate(f"knee_angle_{side}") for side in "rl"]
    assert np.degrees(np.abs(found.pose.q - truth.pose.q)[knees]).max() < 3.0
    assert np.linalg.norm(found.pose.root[:3, 3] - truth.pose.root[:3, 3]) < 0.05
    assert np.degrees(np.linalg.norm(se3.log_rotation(found.pose.root[:3, :3] @ truth.pose.root[:3, :3].T))) < 3.0
    paper, _ = PaperMotion(training, BODY).predict(seen[: last + 1], truth.time)
    assert np.abs(found.pose.q - truth.pose.q)[knees].mean() < np.abs(paper.pose.q - truth.pose.q)[knees].mean()


def test_a_gap_may_be_crossed_in_steps_or_at_once() -> None:
    training, seen = library(walking(1.2, 1.25)), moments(walking(1.2, 1.2))[:60]
    for make in (FollowedMotion, PaperMotion):
        predictor = make(training, BODY)
        steps = ahead(predictor, seen, [seen[-1].time + k / FPS for k in range(1, 91)])  # farther than any clip goes on
        whole, _ = predictor.predict(seen, seen[-1].time + 90 / FPS)
        assert all(np.isfinite(e.pose.q).all() and np.isfinite(e.pose.root).all() for e in steps)
        if make is PaperMotion:
            np.testing.assert_allclose(steps[-1].pose.q, whole.pose.q, atol=1e-9)
        spread = np.array([np.diag(e.covariance) for e in steps])
        assert np.all(np.diff(spread[:, 6:], axis=0) >= -1e-15) and np.all(spread[60, 6:] > spread[0, 6:])
        np.testing.assert_allclose(whole.covariance @ whole.information, np.eye(BODY.dof), atol=1e-6)


def test_the_covariance_is_learnt_from_the_library() -> None:
    """Two people who walk unlike each other make less sure than one who walks like a clock."""
    rng = np.random.default_rng(0)
    clock, other = walking(4.0, 1.25), walking(4.0, 1.25)
    drift = np.cumsum(rng.normal(0, 0.01, other.q.shape), axis=0)
    wavering = MotionClip("other", other.names, FPS, other.roots, other.q + drift - drift.mean(axis=0))
    sure, unsure = FollowedMotion(library(clock), BODY).spread, FollowedMotion(library(wavering), BODY).spread
    assert np.all(sure.deviations[-1, 2:] < np.radians(3.0))
    assert np.mean(unsure.deviations[-1, 2:]) > 1.5 * np.mean(sure.deviations[-1, 2:])
    close, far = sure.variances(10.0, sure.usual), sure.variances(10.0, 3.0 * sure.usual)
    np.testing.assert_allclose(far[2], 9.0 * close[2])


def test_coordinates_that_the_library_lacks_are_held() -> None:
    names = [n for n in BODY.coordinate_names if not n.startswith("subtalar")]
    predictor = FollowedMotion(MotionLibrary.of([walking(3.0, 1.25)], FPS, names), BODY)
    seen = moments(walking(1.5, 1.2))[:60]
    (expected, _), column = predictor.predict(seen, seen[-1].time + 0.2), BODY.coordinate("subtalar_angle_r")
    assert expected.pose.q[column] == seen[-1].pose.q[column]
    assert expected.covariance[6 + column, 6 + column] > 0.1


def test_whole_turns_of_the_tracked_joints_stay() -> None:
    predictor, seen = FollowedMotion(library(walking(3.0, 1.25)), BODY), moments(walking(1.5, 1.2))[:60]
    plain = predictor.predict(seen, seen[-1].time + 0.2)[0].pose.q
    turned = [Moment(m.time, Pose(m.pose.root, m.pose.q + 2 * np.pi)) for m in seen]
    np.testing.assert_allclose(predictor.predict(turned, seen[-1].time + 0.2)[0].pose.q, plain + 2 * np.pi, atol=1e-6)


def test_a_match_is_placed_between_poses_and_scales() -> None:
    clip = walking(3.0, 1.25).q.astype(np.float32)
    where = 100.37 - 1.083 * np.arange(30)[::-1]
    query = np.stack([np.interp(where, np.arange(len(clip)), column) for column in clip.T], axis=1)
    position, step = placed(clip, query + 0.02, 100.0, 1.1)  # a constant offset mostly does not count
    assert (position, step) == (pytest.approx(100.37, abs=0.05), pytest.approx(1.083, abs=0.004))
    assert misplaced(clip, query, position, step) < misplaced(clip, query, 100.0, 1.1)
    assert misplaced(clip, query, 10.0, 1.1) == np.inf


def test_offset_and_range_are_learnt_where_there_is_swing() -> None:
    t = np.arange(120)
    sample = np.stack([0.6 * np.sin(0.1 * t), 1e-3 * np.sin(0.1 * t)], axis=1)
    gain, offset = adapted(1.2 * sample + [0.1, 0.0], sample, 0.3, 1.0)
    np.testing.assert_allclose(gain, [1.2, 1.0], atol=0.01)
    np.testing.assert_allclose(offset, [0.1, 0.0], atol=0.01)
    doubted, _ = adapted(1.2 * sample, sample, 0.3, 0.5)
    assert doubted[0] == pytest.approx(1.1, abs=0.01)


def test_bad_input_is_refused() -> None:
    training = library(walking(1.0, 1.2))
    with pytest.raises(InputError, match="has none of its coordinates"):
        PaperMotion(MotionLibrary.of([MotionClip("a", ("x",), FPS, np.eye(4)[None], np.zeros((1, 1)))], FPS), BODY)
    with pytest.raises(InputError, match="take 2 or more"):
        PaperMotion(training, BODY, poses=1)
    with pytest.raises(InputError, match="at least one moment"):
        PaperMotion(training, BODY).predict([], 1.0)
    with pytest.raises(InputError, match="fading in"):
        FollowRule(fading=1.0)


def test_leverage_is_the_way_of_the_surface_by_a_small_turn() -> None:
    body, step = humanoid(), 1e-6
    q = np.random.default_rng(0).uniform(-0.3, 0.3, len(body.coordinate_names))
    found, still = leverage(body, q[None]), Posed(body, Pose(np.eye(4), q)).vertices
    for name in ("hip_flexion_r", "knee_angle_l", "pro_sup_r"):
        k = body.coordinate(name)
        moved = Posed(body, Pose(np.eye(4), q + step * (np.arange(len(q)) == k))).vertices
        ways = np.linalg.norm(moved - still, axis=1) / step
        assert found[k] == pytest.approx(np.sqrt(np.mean(ways**2)), rel=0.05)  # of some of its points
    assert found[body.coordinate("pro_sup_r")] < 0.1 * found[body.coordinate("hip_flexion_r")]
    both = np.square([found, leverage(body, -q[None])]).mean(axis=0)
    np.testing.assert_allclose(np.square(leverage(body, np.array([q, -q]))), both)


def test_motion_of_another_kind_in_the_library_does_not_change_how_angles_are_weighed() -> None:
    run, other = walking(1.0, 1.2), walking(0.7, 0.2)
    alone, mixed = (FollowedMotion(library(*clips), BODY) for clips in ((run,), (run, other)))
    np.testing.assert_array_equal(alone._weights, mixed._weights)


def test_angles_that_images_hardly_tell_do_not_mislead_a_match() -> None:
    """Subtalar joints and hip rotations 15° off, as two views leave them: the knees are predicted as without that."""
    training, clip = library(walking(4.0, 1.25)), walking(2.0, 1.4)
    rng, last = np.random.default_rng(0), 60
    q = clip.q.copy()
    hidden = [BODY.coordinate(f"{name}_{side}") for name in ("subtalar_angle", "hip_rotation") for side in "rl"]
    q[:, hidden] += np.radians(15.0) * np.sin(np.arange(len(q))[:, None] * rng.uniform(0.1, 0.25, 4))
    seen = [Moment(k / FPS, Pose(root, pose)) for k, (root, pose) in enumerate(zip(clip.roots, q, strict=True))]
    knees = [BODY.coordinate(f"knee_angle_{side}") for side in "rl"]

    def error(lever: float) -> float:
        predictor = FollowedMotion(training, BODY, FollowRule(lever=lever))
        found = [e.pose.q[knees] for e in ahead(predictor, seen[: last + 1], [(last + k) / FPS for k in range(1, 26)])]
        return float(np.degrees(np.abs(found - clip.q[last + 1 : last + 26][:, knees])).mean())

    assert error(0.1) < 2.0
    assert error(0.1) < 0.7 * error(1e-9)


def test_a_prediction_that_drifted_is_drawn_to_what_is_seen_afterwards() -> None:
    """Drift that grows evenly is taken out exactly; what was seen stays, what follows the last seen moment goes."""
    twist, rate = np.array([0.0, 0.0, 0.02, 0.01, 0.0, 0.005]), np.linspace(-0.02, 0.02, len(BODY.coordinate_names))
    truth = [Pose(se3.exp(k * twist), k * rate) for k in range(16)]
    drift, turn = np.linspace(0.03, -0.01, len(rate)), np.array([0.0, 0.0, 0.01, 0.0, 0.002, 0.0])
    blind = range(5, 12)
    history = [Moment(k / FPS, pose) for k, pose in enumerate(truth)]
    for k in blind:
        away = Pose(truth[k].root @ se3.exp((k - 4) * turn), truth[k].q + (k - 4) * drift)
        history[k] = Moment(k / FPS, away, seen=False)
    found = bridged([*history, Moment(16 / FPS, truth[0], seen=False)])
    assert len(found) == 16
    for k, moment in enumerate(found):
        np.testing.assert_allclose(moment.pose.q, truth[k].q, atol=1e-9)
        np.testing.assert_allclose(moment.pose.root[:3, 3], truth[k].root[:3, 3], atol=3e-3)
        assert moment.seen == (k not in blind)
    assert found[3] is history[3]


def test_a_match_after_a_gap_sees_through_it() -> None:
    """Soon after a gap the motion goes on as if there had been none; a straight line across it would match nothing."""
    training, clip = library(walking(4.0, 1.25)), walking(3.0, 1.4)
    predictor, history, memory = FollowedMotion(training, BODY), moments(clip)[:60], None
    for k in range(60, 90):
        expected, memory = predictor.predict(history, 5.0 + k / FPS, memory)
        history.append(Moment(5.0 + k / FPS, expected.pose, seen=False))
    history += moments(clip)[90:100]
    truth = moments(clip)[119]
    found, _ = predictor.predict(history, truth.time)
    knees = [BODY.coordinate(f"knee_angle_{side}") for side in "rl"]
    assert np.degrees(np.abs(found.pose.q - truth.pose.q)[knees]).max() < 3.0
