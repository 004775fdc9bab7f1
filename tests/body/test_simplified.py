"""Simplified bodies."""

from __future__ import annotations

import numpy as np
import pytest

from reproduce.plates import NINETEEN, angles_of
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.simplify import side_view, simplified
from twistcap.errors import InputError

BODY = humanoid()


def test_a_simplified_body_moves_as_the_full_one_whose_other_joints_stay() -> None:
    rng = np.random.default_rng(2)
    q = np.clip(rng.normal(0, 0.3, len(BODY.coordinate_names)), *BODY.limits.T)
    model = simplified(BODY, NINETEEN, at=q)
    assert len(model.coordinate_names) == 19
    moved = q.copy()
    for name in NINETEEN:
        moved[BODY.coordinate(name)] += 0.1
    there = Posed(BODY, Pose(np.eye(4), moved)).landmarks
    here = Posed(model, Pose(np.eye(4), angles_of(model, BODY, moved))).landmarks
    assert model.landmarks.names == BODY.landmarks.names
    np.testing.assert_allclose(here, there, atol=1e-9)


def test_the_side_view_is_planar() -> None:
    model = side_view(BODY, "r", at=np.full(len(BODY.coordinate_names), 0.1))
    assert len(model.coordinate_names) == 6
    assert not any(name.endswith("_l") for name in model.segment_names)
    assert "knee_r" in model.landmarks.names
    assert "knee_l" not in model.landmarks.names
    moved = Posed(model, Pose(np.eye(4), np.full(6, 0.3))).landmarks - Posed(model, Pose.rest(model)).landmarks
    assert np.abs(moved[:, 1]).max() < 1e-12
    assert np.abs(moved[:, 0]).max() > 0.1


def test_unknown_names_are_told() -> None:
    with pytest.raises(InputError, match="tail"):
        simplified(BODY, ["tail"])
    with pytest.raises(InputError, match="side"):
        side_view(BODY, "x")
