"""A limb that is drawn again before the rest of the body: the evidence is that of the whole body drawn."""

from __future__ import annotations

import numpy as np
import pytest

from support.cameras import ring
from support.twins import check_twin
from twistcap import se3
from twistcap.body import Pose
from twistcap.body.humanoid import humanoid
from twistcap.body.limbs import branches
from twistcap.search.draws import anywhere
from twistcap.search.evidence import Evidence, EvidenceView
from twistcap.search.redrawn import RedrawnLimb, evidence_before, window


@pytest.mark.parametrize("nearest", [0.0, 9.0])
def test_the_evidence_of_any_pose_of_a_branch_is_that_of_the_whole_body(nearest: float) -> None:
    body, rng = humanoid(), np.random.default_rng(0)
    cameras = [camera.resized((96, 70)) for camera in ring(3).cameras]
    shape = len(body.segment_names), cameras[0].size[1], cameras[0].size[0]
    maps = [rng.normal(0.4, 1.0, shape).astype(np.float32) for _ in cameras]
    views = [EvidenceView(i, c, m, nearest) for i, (c, m) in enumerate(zip(cameras, maps, strict=True))]
    evidence = Evidence(body, views)
    pose = Pose(se3.exp(np.array([0.0, 0, 0.1, 0.0, 0.0, 0.4])), np.zeros(len(body.twists)))
    for limb in branches(body)[1:]:
        redrawn = RedrawnLimb.at(evidence, pose, limb)
        poses = [pose.retract(step) for step in anywhere(rng, limb, pose, body, 6)]
        whole = [evidence.of(p) for p in poses]
        assert np.ptp(whole) > 1.0
        np.testing.assert_allclose([redrawn.of(p) for p in poses], whole, atol=1e-3)


def test_kernels_are_their_readable_twins() -> None:
    rng, shape, seen = np.random.default_rng(1), (9, 11), (5, 4)
    maps = rng.normal(size=(4, *shape)).astype(np.float32)
    part, nearness = rng.integers(-1, 4, shape).astype(np.int32), rng.random(shape).astype(np.float32)
    face, near = rng.integers(-1, 6, seen).astype(np.int32), rng.random(seen).astype(np.float32)
    face_part = rng.integers(0, 4, 6).astype(np.int32)
    check_twin(evidence_before, maps, part, nearness, (6, 2), face, near, face_part, rtol=1e-5)
    for middle in ((20.0, 30.0), (0.0, 0.0), (-60.0, 20.0), (300.0, 20.0), (97.0, 71.5)):
        check_twin(window, np.array(middle) + 9.0 * rng.normal(size=(7, 2)), (96, 70))
