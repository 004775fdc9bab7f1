"""Which parts the images show, and which joints that leaves known; and what masks a cue that nobody here wrote."""

from __future__ import annotations

import numpy as np
import pytest

from twistcap.body.humanoid import humanoid
from twistcap.body.limbs import segments_above
from twistcap.cues.observation import Agreement
from twistcap.cues.visibility import OcclusionRule

LEG = ("femur_r", "tibia_r", "foot_r")
BODY = humanoid()
PARTS = len(BODY.segment_names)
NONE = np.zeros(PARTS, dtype=np.bool_)
RULE = OcclusionRule()


def agreement(**fraction: float) -> Agreement:
    """Twenty contour points on every part; all tell inside from outside but where a fraction of them is given."""
    fractions = [fraction.get(name, fraction.get("others", 1.0)) for name in BODY.segment_names]
    telling = np.array([float(round(20 * f)) for f in fractions])
    return Agreement(np.full(PARTS, 20, np.int32), telling, telling)


def occluded(**fraction: float) -> list[str]:
    return names(RULE.now_occluded(NONE, agreement(**fraction), BODY))


def names(flags: np.ndarray) -> list[str]:
    return [name for name, flag in zip(BODY.segment_names, flags, strict=True) if flag]


def test_a_segment_hangs_from_its_limb_but_not_from_the_root() -> None:
    hangs = segments_above(BODY)
    assert set(names(hangs[BODY.segment("foot_r")])) == {"femur_r", "tibia_r", "foot_r"}
    assert names(hangs[BODY.segment("femur_l")]) == ["femur_l"]
    assert not hangs[BODY.segment("pelvis")].any()


def test_what_no_view_shows_is_occluded_until_its_whole_limb_is_seen_again() -> None:
    assert occluded(tibia_r=0.3) == [] and occluded(tibia_r=0.1) == ["tibia_r"]
    hidden = RULE.now_occluded(NONE, agreement(femur_r=0.0, tibia_r=0.1, foot_r=0.2), BODY)
    assert names(hidden) == list(LEG)
    # The other leg's outline, taken for the hidden foot's own, does not count while the rest of the leg is absent.
    for still in (agreement(femur_r=0.0, tibia_r=0.1, foot_r=0.6), agreement(femur_r=0.6, tibia_r=0.05, foot_r=0.0)):
        assert names(RULE.now_occluded(hidden, still, BODY)) == list(LEG)
    assert names(RULE.now_occluded(hidden, agreement(femur_r=0.6, tibia_r=0.2, foot_r=0.2), BODY)) == []


def test_in_noise_nothing_counts_as_occluded() -> None:
    assert occluded(others=0.7, tibia_r=0.1) == []
    assert names(RULE.now_occluded(~NONE, agreement(), BODY)) == []


def test_an_occluded_part_is_not_in_sight() -> None:
    hidden = NONE.copy()
    hidden[BODY.segment("foot_r")] = True
    in_sight = RULE.in_sight(agreement(femur_l=0.75), hidden)
    assert in_sight[BODY.segment("foot_r")] == 0.0 and in_sight[BODY.segment("femur_l")] == pytest.approx(0.5)
    assert RULE.concealed(agreement(), hidden) == 1.0 and RULE.concealed(agreement(), NONE) == 0.0


def test_joints_below_a_hidden_segment_are_not_known() -> None:
    known = RULE.known(agreement(humerus_r=0.0), NONE, BODY)
    unknown = {name for name, share in zip(BODY.coordinate_names, known, strict=True) if share < 1.0}
    assert {"arm_flex_r", "elbow_flex_r", "pro_sup_r"} <= unknown
    assert all(name.startswith(("arm", "elbow", "pro_sup", "wrist")) and name.endswith("_r") for name in unknown)
