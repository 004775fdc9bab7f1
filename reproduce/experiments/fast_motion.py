"""C-3: an arm that moves 25 px and more per frame; without flow, and without a velocity, it is left behind.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", section 11.4: prediction by optic flow.

    python -m reproduce C-3 --seeds 0-7 --out out/C-3
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reproduce.arms import Arm, Comparison, Trace, by_arm, landmark_error_mm, unsearched
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import Row, row
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.scene import default_body, default_poses
from twistcap.track import Settings

FASTEST = 26.5  # px per frame that the wrist moves at its fastest, in the view that shows most of it
HOLD, FLOW = Settings(predictor="hold"), Settings(predictor="flow")
BARS = {"flow": (7 / 8, None), "hold": (None, 0.49), "hold, limb search": (None, None)}
KEPT = 50.0  # mm: an arm whose elbow and wrist are farther off on average is lost


def waving(seed: int) -> Capture:
    """Somebody stands and waves an arm, up and down through 150°, in four views at 25 frames per second."""
    config = StudioConfig(seed=seed, views=4, frames=16, fps=25.0, size=(576, 420))
    body = default_body(config)
    root = default_poses(config, body, 0.0)[0].root
    phase = float(stream(seed, "wave").uniform(0, 2 * np.pi))
    frequency = 0.8
    for _ in range(2):  # displacement is all but proportional to frequency
        scene = capture(config, body, [_pose(body, root, frequency * k / config.fps, phase) for k in range(16)])
        frequency *= FASTEST / fastest(scene.true_body, scene.true_poses, scene.true_rig, "wrist_r")
    return capture(config, body, [_pose(body, root, frequency * k / config.fps, phase) for k in range(16)])


def _pose(body: Body, root: np.ndarray, turns: float, phase: float) -> Pose:
    q = np.zeros(len(body.coordinate_names))
    q[body.coordinate("arm_flex_r")] = np.deg2rad(60 + 75 * np.sin(2 * np.pi * turns + phase))
    q[body.coordinate("elbow_flex_r")], q[body.coordinate("elbow_flex_l")] = np.deg2rad(25), np.deg2rad(15)
    return Pose(root, q)


def fastest(body: Body, poses: Sequence[Pose], rig: Rig, landmark: str) -> float:
    """Most px that a landmark moves from frame to frame, in any view."""
    places = np.array([Posed(body, pose).landmarks[body.landmarks.index(landmark)] for pose in poses])
    return max(float(np.linalg.norm(np.diff(camera.project(places)[0], axis=0), axis=1).max()) for camera in rig)


def _error(scene: Capture, estimate: Estimate) -> float:
    return landmark_error_mm(scene, estimate, ("elbow_r", "wrist_r"))


def _rows(traces: Sequence[Trace]) -> list[Row]:
    rows: list[Row] = []
    for arm in dict.fromkeys(t.arm for t in traces):
        means = [float(t.errors.mean()) for t in by_arm(traces, arm)]
        kept = sum(mean <= KEPT for mean in means)
        least, most = BARS[arm]  # "in most" of the seeds hold loses it
        fraction, lost = kept / len(means), len(means) - kept
        rows.append(row("C-3", f"{arm}: arm kept", fraction, "share", at_least=least, at_most=most, lost=lost))
        rows.append(row("C-3", f"{arm}: arm error", float(np.median(means)), "mm, median", seeds=means))
    return rows


C3 = Comparison(
    "C-3",
    f"an arm moves up to {FASTEST:g} px per frame and no velocity is known: hold loses it, flow prediction keeps it",
    "error of elbow and wrist, mm",
    waving,
    (
        Arm("hold", HOLD, changed=unsearched),
        Arm("flow", FLOW, changed=unsearched),
        Arm("hold, limb search", HOLD),
    ),
    _error,
    _rows,
    shown=(9, 0),
)
