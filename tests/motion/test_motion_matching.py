"""Matching of pose histories to training motion: exact, at all speeds, within clips."""

from __future__ import annotations

import numpy as np
import pytest

from twistcap.arrays import Float
from twistcap.errors import InputError
from twistcap.motion import Match, Matcher, MotionClip, MotionLibrary


def clip(q: Float, rate: float = 60.0, name: str = "clip") -> MotionClip:
    roots = np.tile(np.eye(4), (len(q), 1, 1))
    return MotionClip(name, tuple(f"joint_{k}" for k in range(q.shape[1])), rate, roots, q)


def library(*motions: Float) -> MotionLibrary:
    return MotionLibrary.of([clip(q, name=str(k)) for k, q in enumerate(motions)], 60.0)


def smooth(rng: np.random.Generator, count: int, joints: int) -> Float:
    """A motion of a few sines."""
    t = np.arange(count)[:, None, None]
    speed, phase = rng.uniform(0.01, 0.1, (3, joints)), rng.uniform(0, 6, (3, joints))
    return (rng.uniform(0.1, 0.5, (3, joints)) * np.sin(t * speed + phase)).sum(axis=1)


def rough(rng: np.random.Generator, count: int, joints: int) -> Float:
    return rng.normal(0, 0.4, (count, joints))


def brute(
    motions: MotionLibrary, query: Float, scales: tuple[float, ...], ahead: float = 1.0, weights: Float | None = None
) -> list[Match]:
    """All places, the best first: the resampled motions of the paper, and every pose of theirs tried."""
    found: list[Match] = []
    m, factor = len(query), 1.0 if weights is None else np.sqrt(weights)
    for c, length in enumerate(motions.lengths):
        for s in scales:
            poses = motions.angles(c, np.arange(int(np.floor((length - 1) * s + 1e-6)) + 1) / s)
            for j in range(m - 1, len(poses)):
                if (j + ahead) / s <= length - 1 + 1e-6:
                    norms = np.linalg.norm((poses[j - m + 1 : j + 1] - query) * factor, axis=1)
                    found.append(Match(c, j / s, s, float(norms.sum())))
    return sorted(found, key=lambda match: match.distance)


@pytest.mark.parametrize("make", [smooth, rough])
@pytest.mark.parametrize("seed", range(6))
def test_the_same_answer_as_trying_every_place(make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, joints = int(rng.integers(1, 12)), int(rng.integers(1, 9))
    motions = library(*(make(rng, int(n), joints) for n in rng.integers(3, 150, 5)))
    weights = rng.uniform(0.2, 3.0, joints) if seed % 2 else None
    scales = tuple(np.round(np.arange(0.5, 2.01, 0.1), 1))
    matcher = Matcher(motions, weights=weights, ahead=float(seed))
    for query in (
        make(rng, m, joints),
        make(rng, 400, joints)[-m:],
        motions.q[40 : 40 + m] + rng.normal(0, 0.01, (m, joints)),
    ):
        truth, found = brute(motions, query, scales, float(seed), weights)[0], matcher.best(query)
        assert found is not None
        assert found.distance == pytest.approx(truth.distance, abs=1e-5)
        assert (found.clip, found.position, found.scale) == pytest.approx((truth.clip, truth.position, truth.scale))


@pytest.mark.parametrize("m", [1, 5, 30])
def test_the_same_answer_in_clips_of_many_tiles(m: int) -> None:
    rng = np.random.default_rng(m)
    motions = library(*(smooth(rng, int(n), 6) for n in rng.integers(20, 1300, 9)), rough(rng, 300, 6))
    matcher, scales = Matcher(motions, scales=(0.5, 0.9, 1.7)), (0.5, 0.9, 1.7)
    for k in range(6):
        query = smooth(rng, m, 6) if k % 2 else motions.angles(k, 60 + np.arange(m) / 1.3) + rng.normal(0, 0.05, (m, 6))
        truth, found = brute(motions, query, scales)[0], matcher.best(query)
        assert found is not None
        assert (found.clip, found.position, found.scale) == pytest.approx((truth.clip, truth.position, truth.scale))
        assert matcher.best(query, found.after(-1.3)) == found  # less than half a step from where that goes on


def test_the_next_best_ones_are_apart() -> None:
    rng = np.random.default_rng(3)
    motions, query = library(*(smooth(rng, 300, 4) for _ in range(3))), smooth(rng, 5, 4)
    every = brute(motions, query, (0.8, 1.0, 1.3))
    greedy: list[Match] = []
    for match in every:
        if all(match.clip != g.clip or abs(match.position - g.position) >= 20 for g in greedy):
            greedy.append(match)
    found = Matcher(motions, scales=(0.8, 1.0, 1.3)).k_best(query, 6, 20.0)
    assert [(m.clip, m.position, m.scale) for m in found] == [
        (m.clip, pytest.approx(m.position), m.scale) for m in greedy[:6]
    ]


def test_a_motion_is_found_again_at_another_speed() -> None:
    rng = np.random.default_rng(1)
    motions = library(smooth(rng, 200, 5), smooth(rng, 200, 5))
    query = motions.angles(1, 100 + np.arange(-9, 1) / 0.7)
    found = Matcher(motions).best(query)
    assert found is not None
    assert (found.clip, found.scale) == (1, 0.7)
    assert found.position == pytest.approx(100)
    assert found.distance < 1e-3


def test_nothing_matches_across_a_seam() -> None:
    """One motion cut in two: the stretch over the cut is found nowhere whole."""
    whole = smooth(np.random.default_rng(2), 200, 5)
    matcher = Matcher(library(whole[:100], whole[100:]), scales=(1.0,))
    for end in range(100, 104):
        found = matcher.best(whole[end - 4 : end + 1])
        assert found is not None
        assert found.position >= 4 and found.position + 1 <= 99
        assert found.distance > 0.01
    assert matcher.best(whole[95:100]).position == pytest.approx(98, abs=4)  # the clip ends there: nothing follows
    found = matcher.best(whole[100:105])
    assert found is not None and (found.clip, found.position) == (1, 4.0) and found.distance < 1e-5


def test_among_equals_the_last_match_goes_on() -> None:
    step = np.sin(np.arange(40) * 2 * np.pi / 40)[:, None]
    matcher = Matcher(library(np.tile(step, (5, 1)).astype(np.float32)), scales=(1.0,))
    for before in (50.0, 90.0, 130.0):
        found = matcher.best(np.tile(step, (2, 1))[47:52], Match(0, before, 1.0, 0.0))
        assert found is not None and found.position == before + 1.0
    better = matcher.best(np.tile(step, (2, 1))[47:52], Match(0, 60.0, 1.0, 0.0))
    assert better is not None and better.position % 40 == 11


def test_whole_turns_make_no_difference() -> None:
    rng = np.random.default_rng(5)
    q = smooth(rng, 100, 4)
    turned = q + 2 * np.pi * np.array([1, 0, -2, 0])
    a, b = Matcher(library(q)).best(q[20:30]), Matcher(library(turned)).best(q[20:30] - 2 * np.pi)
    assert a is not None and b is not None and b.distance < 1e-4
    assert (a.position, a.scale) == (b.position, b.scale)


def test_a_clip_too_short_matches_nothing() -> None:
    assert Matcher(library(np.zeros((4, 2)))).best(np.zeros((20, 2))) is None


def test_bad_input_is_refused() -> None:
    motions = library(np.zeros((30, 2)))
    with pytest.raises(InputError, match="weights must be positive"):
        Matcher(motions, weights=[1.0, 0.0])
    with pytest.raises(InputError, match="none of the library's 2 coordinates"):
        Matcher(motions, columns=[0, 2])
    with pytest.raises(InputError, match=r"must be \(m, 2\)"):
        Matcher(motions).best(np.zeros((5, 3)))
    with pytest.raises(InputError, match="not finite"):
        Matcher(motions).best(np.full((5, 2), np.nan))
