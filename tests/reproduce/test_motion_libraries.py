"""D-6 and D-7: libraries of many motions, and the scene that is tracked with one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from reproduce.experiments.acrobatics import D7, LIBRARY, Acrobatics, joined
from reproduce.experiments.mixed import RUNNING, SAMPLES, Matched, noisy, same
from twistcap import se3
from twistcap.errors import InputError
from twistcap.motion import Match, MotionClip

NAMES = ("a", "b")


@pytest.fixture
def recorded(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWISTCAP_DATA", str(shared_data))


def clip(count: int, heading: float, place: tuple[float, float, float], value: float) -> MotionClip:
    turn = se3.exp_rotation(np.array([0.0, 0.0, heading]))
    ways = np.array(place) + np.arange(count)[:, None] * (turn @ [0.02, 0.0, 0.0])
    roots = se3.transform(np.tile(turn, (count, 1, 1)), ways)
    return MotionClip("clip", NAMES, 60.0, roots, np.full((count, 2), value))


def test_matches_are_the_same_at_one_place_and_speed() -> None:
    match = Match(0, 12.5, 0.8, 0.3)
    assert same(match, replace(match, distance=0.4))
    assert not any(same(match, replace(match, **other)) for other in ({"clip": 1}, {"position": 13.5}, {"scale": 0.9}))


def test_noise_of_angles_has_the_size_of_its_seed_and_lasts() -> None:
    still = clip(4000, 0.0, (0.0, 0.0, 1.0), 0.0)
    for seed, degrees in ((0, 0.5), (7, 1.0)):
        noise = np.degrees(noisy(still, seed).q)
        assert noise.std() == pytest.approx(degrees, rel=0.1)
        assert np.mean(noise[1:] * noise[:-1]) / noise.var() == pytest.approx(0.8, abs=0.05)
    np.testing.assert_array_equal(noisy(still, 3).q, noisy(still, 3).q)


def test_joined_motions_go_on_where_the_first_ends() -> None:
    first, second = clip(40, 0.7, (1.0, 2.0, 0.9), 0.0), clip(50, -2.0, (-3.0, 0.0, 1.0), 1.0)
    whole = joined(first, second, 10)
    assert len(whole) == 80
    np.testing.assert_array_equal(whole.roots[:30], first.roots[:30])
    np.testing.assert_array_equal(whole.q[:30], first.q[:30])
    np.testing.assert_allclose(
        np.diff(whole.roots[:, :2, 3], axis=0), np.diff(first.roots[:2, :2, 3], axis=0)[[0] * 79], atol=1e-9
    )
    assert np.abs(np.diff(whole.q, axis=0)).max() < 0.2
    assert np.abs(np.diff(whole.roots[:, 2, 3])).max() < 0.02
    np.testing.assert_allclose(whole.roots[40:, 2, 3], 1.0)  # the second one's height is its own
    np.testing.assert_array_equal(whole.q[40:], second.q[10:])
    with pytest.raises(InputError, match="cannot be joined"):
        joined(first, replace(second, rate=30.0))


@pytest.mark.usefixtures("recorded")
def test_running_is_matched_to_running_among_acrobatics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reproduce.experiments.mixed._FIRST", 260)  # the last frames only
    found = Matched.of(0)
    assert len(found.mixed) == len(RUNNING.clip(_body(), 60.0)) + SAMPLES == 760
    for pairs in found.places.values():
        assert len(pairs) > 50
        assert np.mean([same(a, b) for a, b in pairs]) >= 0.99


@pytest.mark.usefixtures("recorded")
def test_what_is_tracked_is_not_in_the_library() -> None:
    scene = Acrobatics().scene(0)
    library = Acrobatics().library(scene)
    tracked = np.array([pose.q for pose in scene.true_poses])
    assert library.names == scene.body.coordinate_names
    assert not any("mirrored" in name for name in library.clip_names) and len(library.clip_names) == len(LIBRARY)
    nearest = np.linalg.norm(tracked[60:120, None] - library.q[None], axis=2).min(axis=1)
    assert np.degrees(nearest.min()) > 5.0
    assert np.abs(np.diff(tracked, axis=0)).max() < 1.0  # the seam is no jump
    assert min(float(pose.root[2, 2]) for pose in scene.true_poses) < -0.8  # head down


def _body():
    from twistcap.studio import StudioConfig
    from twistcap.studio.scene import default_body

    return default_body(StudioConfig(seed=0))


@pytest.mark.usefixtures("recorded")
@pytest.mark.parametrize("seed", [0, 7, 40, 43, 47, 173])
def test_every_seed_films_the_whole_cartwheel_and_the_flip(seed: int) -> None:
    """Seeds begin at different frames of the run-up; a late beginning once cut the cartwheel, and the shown frame."""
    upright = np.array([pose.root[2, 2] for pose in Acrobatics().scene(seed).true_poses])
    assert upright[0] > 0.7
    assert len(upright) > D7.shown[0]
    assert np.count_nonzero(np.diff((upright < 0.0).astype(int)) == 1) == 2  # head down twice
