"""A real walk before one camera, from clicked joints: `python benchmarks/sagittal.py [OVERLAY.png]`.

The recording is `sagittal_walk` of the shared data. Both sides are followed in the image plane, since the far leg
crosses the near one; printed is how the near knee and hip compare with the norms of gait, cycle by cycle.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from twistcap.adjust.first_pose.clicks import fit_clicks
from twistcap.body import Body
from twistcap.body.ellipsoids import ellipsoid_body
from twistcap.body.humanoid import humanoid
from twistcap.body.simplify import SIDE_VIEW, simplified
from twistcap.differential.render import render
from twistcap.differential.sequence import Limb, SequenceConfig, track_sequence
from twistcap.differential.settings import DifferentialConfig
from twistcap.differential.view import State
from twistcap.evaluate.norms import FILE, by_cycle, correlation, gait_norm, heel_strikes

FIRST, COUNT, TOP, BOTTOM = 80, 100, 480, 960  # frames, and rows of the image that hold the walker
CLICKS = {
    "hip_l": (1230, 734), "knee_l": (1178, 805), "ankle_l": (1149, 894), "toe_l": (1128, 911), "heel_l": (1158, 916),
    "shoulder_l": (1261, 605), "elbow_l": (1293, 682), "wrist_l": (1322, 727), "neck": (1241, 585),
    "head_top": (1226, 531), "hip_r": (1230, 734), "knee_r": (1260, 817), "ankle_r": (1307, 904), "toe_r": (1278, 917),
    "heel_r": (1320, 912), "shoulder_r": (1222, 610), "elbow_r": (1187, 671), "wrist_r": (1126, 704),
}  # fmt: skip
TRACKER = DifferentialConfig(turns="planar", stray_scale=1e-4, stray_px=2.0, stray_turn_deg=0.5)
LIMBS = tuple(
    Limb(names, (10, 12), (5, 7), (3, 6)) for names in (("hip_flexion", "knee_angle"), ("arm_flex", "elbow_flex"))
)


def frames(path: Path) -> list[np.ndarray]:
    """The walk, RGB at half size."""
    video, out = cv2.VideoCapture(str(path)), []
    for k in range(FIRST + COUNT):
        image = video.read()[1]
        if k >= FIRST:
            half = cv2.resize(image[..., ::-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            out.append(half[TOP // 2 : BOTTOM // 2])
    return out


def start() -> tuple[Body, State]:
    """The planar model of both sides, at the clicked state."""
    body = humanoid(stature=1.65)
    kept = [n for n in body.coordinate_names if n.removesuffix("_r").removesuffix("_l") in SIDE_VIEW]
    model = simplified(body, kept, axis=np.array([0.0, 1.0, 0.0]))
    found = fit_clicks(model, [CLICKS], facing_deg=[-90])
    view = found.state.views[0].resized(0.5)
    return ellipsoid_body(found.body), State((replace(view, shift=view.shift - [0, TOP // 2]),), found.state.q)


def overlay(model, states, images, wanted: range) -> np.ndarray:
    """Some frames, the parts of the model coloured."""
    colours, tiles = (255 * np.random.default_rng(0).random((40, 3))).astype(np.uint8), []
    for k in wanted:
        image, view = images[k].copy(), states[k].views[0]
        part = render(states[k].posed(model), view, image.shape[1::-1]).part
        image[part >= 0] = 0.6 * image[part >= 0] + 0.4 * colours[part[part >= 0]]
        x = int(np.clip(view.shift[0] - 75, 0, image.shape[1] - 150))
        tiles.append(np.hstack([images[k][:, x : x + 150], image[:, x : x + 150]]))
    return np.vstack([np.hstack(tiles[k : k + 4]) for k in range(0, len(tiles) - 3, 4)])


def main() -> None:
    data = Path(os.environ["TWISTCAP_DATA"])
    images, (model, first) = frames(data / "sagittal_walk/demo.mp4"), start()
    states = track_sequence(
        model, first, [[i] for i in images], TRACKER, SequenceConfig(passes=1, limbs=LIMBS, apart=True)
    )
    marks = np.array([s.views[0].pixels(s.posed(model).landmarks) for s in states])
    names = model.landmarks.names
    strikes = heel_strikes(marks[:, names.index("hip_l"), 0] - marks[:, names.index("ankle_l"), 0], 20)
    strikes = np.unique([0, *strikes]).astype(np.int32)  # it begins as the near heel strikes
    print("heel strikes", strikes)
    for joint in ("hip_flexion", "knee_angle"):
        angle = np.degrees([s.q[model.coordinate(joint + "_l")] for s in states])
        band = gait_norm(data / FILE, joint)
        print(joint, "correlation with the norms", [round(correlation(c, band), 3) for c in by_cycle(angle, strikes)])
    if len(sys.argv) > 1:
        cv2.imwrite(sys.argv[1], overlay(model, states, images, range(0, COUNT, 5))[..., ::-1])


if __name__ == "__main__":
    main()
