"""Recorded motions of the experiments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from reproduce.recorded import looped
from twistcap import se3
from twistcap.errors import InputError
from twistcap.motion import MotionClip


def test_a_cycle_goes_on_where_it_ended() -> None:
    t = np.linspace(0.0, 2 * np.pi, 31)
    turn = se3.exp_rotation(np.outer(0.3 * t / t[-1], [0.0, 0.0, 1.0]))
    roots = se3.transform(turn, np.stack([t, 0.1 * t**2, 1.0 + 0.05 * np.sin(t)], axis=1))
    walk = MotionClip("walk", ("a",), 30.0, roots, np.sin(t)[:, None])
    three = looped(walk, 3)
    assert len(three) == 91
    steps = se3.log(se3.inverse(three.roots[:-1]) @ three.roots[1:])
    np.testing.assert_allclose(steps[30:60], steps[:30], atol=1e-12)
    np.testing.assert_allclose(steps[60:], steps[:30], atol=1e-12)
    np.testing.assert_allclose(three.q[30:61], walk.q, atol=1e-12)
    with pytest.raises(InputError, match="no cycle"):
        looped(replace(walk, q=np.linspace(0.0, 1.0, 31)[:, None]), 2)
