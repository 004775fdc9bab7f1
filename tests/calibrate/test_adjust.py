"""Cameras from what they see of a board: derivatives, truth, covariance, wrong points, clocks, chains."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from support.boards import BIG, SIZE, Filmed, carried, filmed, in_world_of, numbers_of, ring_rig, seen_by
from twistcap import se3
from twistcap.calibrate.calibrate import Calibration, Options, of_sightings
from twistcap.calibrate.lens import Kind
from twistcap.calibrate.sightings import Sighting, moving
from twistcap.calibrate.world import lying
from twistcap.camera import Rig
from twistcap.errors import InputError

KINDS: tuple[Kind, Kind] = ("brown", "fisheye")


def calibrated(made: Filmed, options: Options | None = None) -> Calibration:
    """The calibration in the world of the board at moment 0, unless asked otherwise."""
    sizes = dict.fromkeys(range(len(made.rig)), SIZE)
    asked = options or Options(kinds=("brown",), floor=0)
    return of_sightings(made.sightings, made.board, made.rig.names, sizes, asked)


def truth(made: Filmed) -> Rig:
    """The rig in the world of the board at moment 0."""
    return in_world_of(made.rig, lying(made.board) @ np.linalg.inv(made.boards[0]))


def errors(found: Calibration, true: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each camera: share of the focal length, degrees, m."""
    pairs = list(zip(found.rig, true, strict=True))
    focal = np.array([a.K[0, 0] / b.K[0, 0] - 1 for a, b in pairs])
    turns = [se3.log_rotation(a.T_cam_world[:3, :3] @ b.T_cam_world[:3, :3].T) for a, b in pairs]
    centres = [np.linalg.norm(a.centre - b.centre) for a, b in pairs]
    return np.abs(focal), np.rad2deg(np.linalg.norm(turns, axis=1)), np.array(centres)


def standardised(found: Calibration, true: Rig) -> np.ndarray:
    """Errors of all numbers of all cameras over their claimed standard deviations."""
    out = list[np.ndarray]()
    a = found.adjustment
    for c, camera in enumerate(true):
        step = se3.log(camera.T_cam_world @ se3.inverse(a.guess.places[c]))
        out.append(step / np.sqrt(np.diagonal(a.places[c])))
        out.append((numbers_of(camera)[1] - a.guess.numbers[c]) / np.sqrt(np.diagonal(a.lenses[c])))
    return np.concatenate(out)


@pytest.mark.parametrize("kind", KINDS)
def test_the_derivatives_of_a_lens(kind: Kind) -> None:
    rng = np.random.default_rng(0)
    lens, numbers = numbers_of(ring_rig(1, rng, kind)[0])
    points = rng.uniform(-1.0, 1.0, (6, 3)) + np.array([0, 0, 2.5])
    pixels, by_points, by_numbers = lens.project(numbers, points)
    for k, step in enumerate(1e-6 * np.eye(3)):
        slope = (lens.project(numbers, points + step)[0] - lens.project(numbers, points - step)[0]) / 2e-6
        np.testing.assert_allclose(by_points[:, :, k], slope, atol=1e-5)
    for k, step in enumerate(1e-6 * np.eye(len(numbers))):
        slope = (lens.project(numbers + step, points)[0] - lens.project(numbers - step, points)[0]) / 2e-6
        np.testing.assert_allclose(by_numbers[:, :, k], slope, atol=1e-5)
    np.testing.assert_allclose(lens.normalised(numbers, pixels), points[:, :2] / points[:, 2:], atol=1e-9)
    camera = lens.camera("a", numbers, np.eye(4))
    np.testing.assert_allclose(camera.project(points)[0], pixels, atol=1e-8)


def test_cameras_are_found_and_their_errors_are_those_claimed() -> None:
    """Two in a hundred points are 30 px off."""
    scores = list[np.ndarray]()
    for seed in range(3):
        made = filmed(seed)
        found, true = calibrated(made), truth(made)
        focal, turn, centre = errors(found, true)
        assert focal.max() < 2e-3 and turn.max() < 0.2 and centre.max() < 0.008, (focal, turn, centre)
        assert found.floor_known and np.all(found.adjustment.sigmas > 0.17) and np.all(found.adjustment.sigmas < 0.23)
        scores.append(standardised(found, true))
    within = np.mean(np.abs(np.concatenate(scores)) < 2.0)
    assert within > 0.90, within


@pytest.mark.parametrize("kind", KINDS)
def test_the_kind_of_lens_is_told_by_the_pictures(kind: Kind) -> None:
    made = filmed(1, cameras=3, moments=40, kind=kind)
    found = calibrated(made, Options(floor=0))
    assert [lens.kind for lens in found.adjustment.guess.lenses] == [kind] * 3
    focal, turn, centre = errors(found, truth(made))
    assert focal.max() < 8e-3 and turn.max() < 0.8 and centre.max() < 0.03


@pytest.mark.parametrize(("late", "looks"), [(1.3, range(-3, 3)), (0.8, range(-1, 2)), (2.4, range(-1, 2))])
def test_a_clock_that_is_late_is_found_with_the_cameras(late: float, looks: range) -> None:
    """The second camera shows later moments than the others; a long recording is looked at in few frames only."""
    rng = np.random.default_rng(5)
    rig = ring_rig(3, rng, distance=2.5, arc=1.6)
    bases = [carried(rng, 0.4) for _ in range(16)]
    twists = [np.r_[0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3)] for _ in bases]

    def board(time: float) -> np.ndarray:
        k = min(max(round(time / 10), 0), len(bases) - 1)
        u = time - 10 * k
        return se3.exp((u + 0.03 * u * u) * twists[k]) @ bases[k]

    def look(c: int, frames: Iterable[int]) -> list[Sighting]:
        out = list[Sighting]()
        for frame in frames:
            ids, pixels = seen_by(rig[c], board(frame - 100 + (late if c == 1 else 0.0)), BIG)
            if len(ids):
                out.append(Sighting(c, frame, ids, pixels + 0.1 * rng.normal(size=pixels.shape), 2.0))
        return moving(out)

    def more(c: int, frames: Sequence[int]) -> list[Sighting]:
        return [s for s in look(c, sorted({f + d for f in frames for d in (-1, 0, 1)})) if s.motion is not None]

    seen = [s for c in range(3) for s in look(c, [100 + 10 * k + d for k in range(16) for d in looks])]
    found = of_sightings(seen, BIG, rig.names, dict.fromkeys(range(3), SIZE), Options(kinds=("brown",)), more=more)
    assert found.late[0] == pytest.approx([0.0, late, 0.0], abs=0.02)
    relative = rig[1].T_cam_world @ se3.inverse(rig[0].T_cam_world)
    reached = found.rig[1].T_cam_world @ se3.inverse(found.rig[0].T_cam_world)
    off = se3.log(relative @ se3.inverse(reached))
    assert np.rad2deg(np.linalg.norm(off[:3])) < 0.2


def test_cameras_that_share_no_view_are_chained_or_told() -> None:
    made = filmed(3, cameras=4, moments=60)

    def without(*pairs: tuple[int, int]) -> list[Sighting]:
        apart = [set(pair) for pair in pairs]
        moments = dict[int, set[int]]()
        for s in made.sightings:
            moments.setdefault(s.moment, set()).add(s.camera)
        return [s for s in made.sightings if not any(pair <= moments[s.moment] for pair in apart) or s.moment == 0]

    joined = calibrated(replace(made, sightings=[s for s in without((0, 2), (1, 3)) if s.moment]), Options(("brown",)))
    for a, b in ((0, 2), (1, 3)):
        true = made.rig[b].T_cam_world @ se3.inverse(made.rig[a].T_cam_world)
        reached = joined.rig[b].T_cam_world @ se3.inverse(joined.rig[a].T_cam_world)
        assert np.rad2deg(np.linalg.norm(se3.log(true @ se3.inverse(reached))[:3])) < 0.5
    alone = [s for s in without((0, 3), (1, 3), (2, 3)) if s.moment]
    with pytest.raises(InputError, match=r"cam3 together with .*film it where both see it"):
        calibrated(replace(made, sightings=alone), Options(("brown",)))


def test_a_board_that_was_printed_too_high_is_told_and_allowed_for() -> None:
    made = filmed(2, noise=0.1)
    rng, taller, stretched = np.random.default_rng(0), made.board.points * [1.0, 1.01, 1.0], list[Sighting]()
    for m, T in made.boards.items():
        for c, camera in enumerate(made.rig):
            ids, _ = seen_by(camera, T, made.board)
            if len(ids):
                pixels = camera.project(se3.apply(T, taller[ids]))[0]
                stretched.append(Sighting(c, m, ids, pixels + 0.1 * rng.normal(size=pixels.shape), 2.0))
    found = calibrated(replace(made, sightings=stretched))
    assert found.adjustment.shapes["board"][0] == pytest.approx(0.01, abs=1e-3)


def test_a_camera_that_saw_too_little_is_told() -> None:
    made = filmed(0, cameras=2, moments=40)
    few = [s for s in made.sightings if s.camera == 0 or s.moment == 0]
    with pytest.raises(InputError, match=r"camera cam1: the board was found in [01] of its pictures"):
        calibrated(replace(made, sightings=few))
