"""The first frames of the real recording, end to end as `twistcap track` does it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twistcap.body import Posed
from twistcap.build import build
from twistcap.evaluate.metrics import iou
from twistcap.hindsight import tracked
from twistcap.io.masks import read_masks
from twistcap.io.recording import open_recording
from twistcap.io.session import load_session
from twistcap.render import render

SESSION = Path(__file__).parents[2] / "examples" / "balance_4view.toml"
BODY_25B = {"shoulder_l": 5, "shoulder_r": 6, "elbow_l": 7, "elbow_r": 8, "knee_l": 13, "knee_r": 14, "ankle_r": 16}


def test_the_man_on_the_beam(shared_data: Path, monkeypatch) -> None:
    monkeypatch.setenv("TWISTCAP_DATA", str(shared_data))
    folder = shared_data / "balance_4view"
    recording = open_recording(load_session(SESSION, {"frames": [0, 7]}))
    estimates = list(tracked(recording.views, build(recording.body, recording.views.image_rig), recording.first_pose))
    assert not any(e.lost for e in estimates)

    masks = read_masks(str(folder / "masks"), recording.rig, 0)
    posed = Posed(recording.body, estimates[0].pose)
    overlap = [iou(render(posed, c.pinhole()).mask, m) for c, m in zip(recording.rig, masks, strict=True)]
    assert np.mean(overlap) > 0.83

    # The reference's file 5 belongs to video frame 6.3: half a centimetre from frame 6, which is well within the bar.
    reference = np.load(folder / "reference" / "keypoints3d_world.npz")["X"][5]
    ours = Posed(recording.body, estimates[6].pose).landmarks
    marks = recording.body.landmarks
    off = [np.linalg.norm(ours[marks.index(n)] - reference[k]) for n, k in BODY_25B.items()]
    assert np.median(off) < 0.03
