"""The idea of twistcap in twenty lines: keypoints, joint limits and a prior meet in one least-squares system.

python examples/02_one_system.py
"""

import numpy as np

from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.render import SurfacePoints
from twistcap.solve import PoseProblem, minimise
from twistcap.studio import ring
from twistcap.terms import GaussianTerm, KeypointTerm, LimitTerm


def main() -> float:
    """Fit a crouch to noisy keypoints in two views; returns the error of the right knee, deg."""
    body = humanoid("full")
    knee = body.coordinate("knee_angle_r")
    q = np.zeros(len(body.coordinate_names))
    for name, angle in {"hip_flexion_r": 70, "hip_flexion_l": 60, "knee_angle_r": 90, "knee_angle_l": 80}.items():
        q[body.coordinate(name)] = np.deg2rad(angle)
    truth = Pose(np.eye(4), q)

    marks = body.landmarks
    points = SurfacePoints(marks.segments[:, None], np.ones((len(marks.names), 1)), marks.points)
    noise = np.random.default_rng(0)
    keypoints = [
        KeypointTerm(
            camera.P,
            points,
            camera.project(Posed(body, truth).landmarks)[0] + noise.normal(0.0, 1.0, (len(marks.names), 2)),
            weight=np.ones(len(marks.names)),
            scale_px=50.0,  # nothing here is an outlier, and the start is far off
        )
        for camera in ring(2, radius=4.0, height=0.5, target=(0.0, 0.0, 0.0), size=(640, 480))
    ]
    standing = GaussianTerm(Pose.rest(body), 0.1 * np.eye(body.dof))  # where nothing is seen, stand

    result = minimise(PoseProblem([*keypoints, standing, LimitTerm()]), Posed(body, Pose.rest(body)), steps=50)
    sigma = np.rad2deg(np.sqrt(result.system.covariance()[6 + knee, 6 + knee]))
    print(f"{result.status} after {result.steps} steps, energy {result.energy:.1f}")
    print(f"right knee {np.rad2deg(result.x.pose.q[knee]):.1f}° ± {sigma:.1f}° (true 90°)")
    return float(abs(np.rad2deg(result.x.pose.q[knee]) - 90.0))


if __name__ == "__main__":
    main()
