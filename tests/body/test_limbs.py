"""Limbs are found in any skeleton, without names."""

from __future__ import annotations

from twistcap.body.limbs import limbs
from twistcap.studio import StudioConfig
from twistcap.studio.scene import default_body


def test_limbs_are_branches_that_end_in_one_place() -> None:
    body = default_body(StudioConfig(seed=0))
    found = limbs(body)
    assert len(found) == 5  # head, arms and legs; the trunk carries more than one end
    assert not any(limb[:6].any() or limb[6 + body.coordinate("lumbar_bending")] for limb in found)
    arm = 6 + body.coordinate("arm_flex_r")
    assert [limb[6 + body.coordinate("elbow_flex_r")] for limb in found if limb[arm]] == [True]
