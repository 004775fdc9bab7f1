"""Kernels of motion matching against their readable twins."""

from __future__ import annotations

import numpy as np
import pytest

from support.twins import check_twin
from twistcap.motion import Matcher, MotionClip, MotionLibrary, _search
from twistcap.motion.following import misplaced, placed

STEPS = np.array([0.5, 0.9, 1.3])


def matcher(seed: int, joints: int = 5) -> Matcher:
    """Of clips of smooth motion, one shorter than a block."""
    rng = np.random.default_rng(seed)
    clips = []
    for k, n in enumerate((61, 6, 130)):
        t = np.arange(n)[:, None, None]
        speed, phase = rng.uniform(0.01, 0.1, (3, joints)), rng.uniform(0, 6, (3, joints))
        q = (0.3 * np.sin(t * speed + phase)).sum(axis=1)
        clips.append(MotionClip(str(k), tuple("abcde"[:joints]), 60.0, np.tile(np.eye(4), (n, 1, 1)), q))
    return Matcher(MotionLibrary.of(clips, 60.0))


def asked(m: int, seed: int = 1) -> np.ndarray:
    """(m, 8) the latest pose first, padded with zeros."""
    rng = np.random.default_rng(seed)
    out = np.zeros((m, 8))
    out[:, :5] = 0.4 * np.sin(0.05 * np.arange(m)[:, None] + rng.uniform(0, 6, 5)) + rng.normal(0, 0.02, (m, 5))
    return out


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("m", [1, 5])
def test_the_search_finds_what_the_twin_finds(seed: int, m: int) -> None:
    library, query = matcher(seed), asked(m, seed)
    starts = library.library.starts
    clips = (library.base, library.jumps, starts)
    nothing = (np.zeros(0, np.int32), np.zeros((0, 2)))
    search = (clips, query, STEPS, 2.0)
    best, clip, scale, j = check_twin(_search.search, *search, nothing, 1e300)
    place = j * STEPS[scale]
    around = (np.array([clip], np.int32), np.array([[place - 5.0, place + 5.0]]))
    assert check_twin(_search.search, *search, around, 1e300)[0] > best
    assert check_twin(_search.search, *search, nothing, 0.9 * best)[1] == -1
    start = int(starts[clip])
    check_twin(_search.score, library.base, query, start, j, STEPS[scale], 1e300)
    assert _search.score(library.base, query, start, j, STEPS[scale], 0.5 * best) > 0.5 * best


@pytest.mark.parametrize("any_pace", [False, True])
def test_matches_are_placed_in_time_as_by_the_twin(any_pace: bool) -> None:
    rng = np.random.default_rng(3)
    clip = np.sin(0.1 * np.arange(80)[:, None] + rng.uniform(0, 6, 5)).astype(np.float32)
    query = np.sin(0.1 * (31.3 + 1.1 * np.arange(-7, 1))[:, None] + rng.uniform(0, 6, 5))
    for position in (31.0, 60.2, 3.0, 200.0):
        check_twin(misplaced, clip, query, position, 1.0, rtol=1e-6)
    check_twin(placed, clip, query, 31.0, 1.0, any_pace, rtol=1e-6)
