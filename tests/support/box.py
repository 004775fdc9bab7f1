"""A body of one hinge, where every error can be worked out by hand."""

from __future__ import annotations

import numpy as np

from twistcap.body import Body, Landmarks

BOX = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.15, 0.15) for z in (-0.5, 0.5)])
BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]], np.int32,
)  # fmt: skip


def hinged_box() -> Body:
    """A box whose hip stands at its centre; the knee hinge there, about y, carries the ankle 0.5 m below."""
    return Body(
        name="box",
        coordinate_names=("knee_angle_r",),
        parent=np.array([-1], np.int32),
        twists=np.array([[0.0, 1, 0, 0, 0, 0]]),
        limits=np.array([[-2.0, 2.0]]),
        segment_names=("pelvis", "tibia_r"),
        segment_joint=np.array([-1, 0], np.int32),
        vertices=BOX,
        faces=BOX_FACES,
        skin_segments=np.zeros((8, 1), np.int32),
        skin_weights=np.ones((8, 1)),
        landmarks=Landmarks(
            ("hip_r", "ankle_r", "toe_r"),
            np.array([0, 1, 1], np.int32),
            np.array([[0.0, 0, 0], [0, 0, -0.5], [0, 0, -0.6]]),
        ),
    )
