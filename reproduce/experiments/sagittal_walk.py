"""sagittal: a real walk before one camera, followed by brightness from clicked joints, beside the norms of gait.

The recording is `sagittal_walk` of the shared data. Both sides are followed in the image plane, since the far leg
crosses the near one; measured is how near hip and knee correlate with the norms, cycle by cycle. After Bregler and
Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998.

    TWISTCAP_DATA=... python -m reproduce sagittal --out out/sagittal
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from reproduce.arms import Findings
from reproduce.ellipsoids import ellipsoid_body
from reproduce.measures.gait_norms import FILE, by_cycle, correlation, gait_norm, heel_strikes
from reproduce.passes import WALKING, track_sequence
from reproduce.recorded import data_file
from reproduce.running import Tell
from twistcap.adjust.first_pose.clicks import fit_clicks
from twistcap.arrays import AnyArray, UInt8
from twistcap.body import Body
from twistcap.body.humanoid import humanoid
from twistcap.body.simplify import SIDE_VIEW, simplified
from twistcap.differential.model import DifferentialModel
from twistcap.differential.settings import DifferentialConfig, Rule
from twistcap.differential.state import State
from twistcap.evaluate import Row, row
from twistcap.render import render

FIRST, COUNT, TOP, BOTTOM = 80, 100, 480, 960  # frames, and rows of the image that hold the walker
CLICKS = {
    "hip_l": (1230, 734), "knee_l": (1178, 805), "ankle_l": (1149, 894), "toe_l": (1128, 911), "heel_l": (1158, 916),
    "shoulder_l": (1261, 605), "elbow_l": (1293, 682), "wrist_l": (1322, 727), "neck": (1241, 585),
    "head_top": (1226, 531), "hip_r": (1230, 734), "knee_r": (1260, 817), "ankle_r": (1307, 904), "toe_r": (1278, 917),
    "heel_r": (1320, 912), "shoulder_r": (1222, 610), "elbow_r": (1187, 671), "wrist_r": (1126, 704),
}  # fmt: skip
TRACKER, RULE = DifferentialConfig(turns="planar"), Rule(scale=1e-4, shift_px=2.0, turn_deg=0.5)


@dataclass(frozen=True)
class SagittalWalk:
    """The experiment; it draws no numbers at random, so that seeds change nothing. See `Experiment`."""

    id: str = "sagittal"
    says: str = "a real walk in one view, followed by brightness alone: hip and knee beside the norms of gait"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """The least correlation over the cycles; the picture shows the parts over the frames."""
        del seeds
        images, (model, first) = frames(data_file("sagittal_walk/demo.mp4")), start()
        progress("tracking", 0, 1)
        states = track_sequence(DifferentialModel(model, TRACKER, RULE), first, [[i] for i in images], WALKING)
        if out is not None:
            cv2.imwrite(str(out / f"{self.id}.png"), overlay(model, states, images, range(0, COUNT, 5))[..., ::-1])
        return Findings(self._rows(model, states), "", ())

    def _rows(self, model: Body, states: Sequence[State]) -> list[Row]:
        marks = np.array([s.views[0].pixels(s.posed(model).landmarks) for s in states])
        hip, ankle = (model.landmarks.index(name) for name in ("hip_l", "ankle_l"))
        strikes = heel_strikes(marks[:, hip, 0] - marks[:, ankle, 0], 20)
        strikes = np.unique([0, *strikes]).astype(np.int32)  # it begins as the near heel strikes
        rows: list[Row] = []
        for joint in ("hip_flexion", "knee_angle"):
            angle = np.degrees([s.q[model.coordinate(joint + "_l")] for s in states])
            band = gait_norm(data_file(FILE), joint)
            each = [correlation(curve, band) for curve in by_cycle(angle, strikes)]
            rows.append(row(self.id, f"{joint}, worst cycle", min(each), "correlation", at_least=0.9, seeds=each))
        return rows


def frames(path: Path) -> list[UInt8]:
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
    view = found.state.views[0].scaled(0.5)
    return ellipsoid_body(found.body), State((replace(view, shift=view.shift - [0, TOP // 2]),), found.state.q)


def overlay(model: Body, states: Sequence[State], images: Sequence[UInt8], wanted: range) -> AnyArray:
    """Some frames, the parts of the model coloured."""
    colours, tiles = (255 * np.random.default_rng(0).random((40, 3))).astype(np.uint8), []
    for k in wanted:
        image, view = images[k].copy(), states[k].views[0]
        part = render(states[k].posed(model), view).part
        image[part >= 0] = 0.6 * image[part >= 0] + 0.4 * colours[part[part >= 0]]
        x = int(np.clip(view.shift[0] - 75, 0, image.shape[1] - 150))
        tiles.append(np.hstack([images[k][:, x : x + 150], image[:, x : x + 150]]))
    return np.vstack([np.hstack(tiles[k : k + 4]) for k in range(0, len(tiles) - 3, 4)])


SAGITTAL = SagittalWalk()
