"""Key views of a body whose truth is known: the four pictures that `twistcap.acquire` builds a body from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap import se3
from twistcap.arrays import Float32
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera, look_at
from twistcap.studio.background import background
from twistcap.studio.config import StudioConfig, stream
from twistcap.studio.look import look
from twistcap.studio.picture import picture_of

_STANCE = {"arm_add": -90.0, "hip_adduction": -8.0, "subtalar_angle": 8.0}
_FOREARMS_UP = {**_STANCE, "arm_rot": -90.0, "elbow_flex": 90.0}


@dataclass(frozen=True)
class KeyViewScene:
    """What the photographer takes home, and the truth.

    Attributes:
        cameras, images, plates: by role (front, side, above, elbows); images and empty plates (H, W, 3) in [0, 1].
        body, stance, forearms_up: who was seen, and how they stood in the first three views and in the last.
    """

    cameras: dict[str, Camera]
    images: dict[str, Float32]
    plates: dict[str, Float32]
    body: Body
    stance: Pose
    forearms_up: Pose


def key_view_scene(body: Body, seed: int = 0, size: int = 1000) -> KeyViewScene:
    """A person in the middle of a room, arms out sideways, before three cameras about 90° apart, and once with the
    forearms up; where the person faces, and the cameras' places by a few degrees, the seed chooses."""
    rng = stream(seed, "key views")
    heading = float(rng.uniform(0, 2 * np.pi))
    turn = se3.transform(se3.exp_rotation(np.array([0.0, 0.0, heading])), rng.uniform(-0.3, 0.3, 3) * [1, 1, 0])
    stance = _standing(body, turn, _STANCE)
    forearms_up = _standing(body, turn, _FOREARMS_UP)
    points = Posed(body, stance).vertices
    stature = float(np.ptp(points[:, 2]))
    middle = turn[:3, 3] + [0.0, 0.0, 0.5 * stature]
    cameras = _cameras(rng, heading, middle, stature, size)
    config = StudioConfig(seed, len(cameras), (size, size))
    dress = look(body, config)
    plates = {role: background(config, k) for k, role in enumerate(("front", "side", "above"))}
    plates["elbows"] = plates["front"]
    images = {
        role: picture_of([Posed(body, forearms_up if role == "elbows" else stance)], camera, dress, plates[role])
        for role, camera in cameras.items()
    }
    return KeyViewScene(cameras, images, plates, body, stance, forearms_up)


def _standing(body: Body, turn: np.ndarray, degrees: dict[str, float]) -> Pose:
    """The pose of given joint angles, both sides alike, the soles on the floor."""
    pose = Pose.rest(body)
    q = pose.q.copy()
    for joint, value in degrees.items():
        for side in "rl":
            if f"{joint}_{side}" in body.coordinate_names:
                q[body.coordinate(f"{joint}_{side}")] = np.deg2rad(value)
    low = float(Posed(body, Pose(pose.root, q)).vertices[:, 2].min())
    return Pose(turn @ se3.transform(np.eye(3), np.array([0.0, 0.0, -low])), q)


def _cameras(
    rng: np.random.Generator, heading: float, middle: np.ndarray, stature: float, size: int
) -> dict[str, Camera]:
    """Three cameras that the whole person with outstretched arms fits into, near a right angle to each other."""
    radius = 2.4 * stature
    focal = 0.8 * size * radius / (1.08 * stature)
    K = np.array([[focal, 0.0, (size - 1) / 2], [0.0, focal, (size - 1) / 2], [0.0, 0.0, 1.0]])
    off = np.deg2rad(rng.uniform(-4, 4, 3))
    level = rng.uniform(-0.1, 0.15, 2)
    front = [np.cos(heading + off[0]), np.sin(heading + off[0]), level[0]]
    side = [np.cos(heading + off[1] + np.pi / 2), np.sin(heading + off[1] + np.pi / 2), level[1]]
    above = [np.sin(off[2]) * np.cos(heading), np.sin(off[2]) * np.sin(heading), 1.0]
    ups = {"front": (0, 0, 1), "side": (0, 0, 1), "above": (np.cos(heading), np.sin(heading), 0)}
    cameras = {
        role: Camera(role, K, look_at(middle + radius * np.array(way), middle, ups[role]), (size, size))
        for role, way in (("front", front), ("side", side), ("above", above))
    }
    return cameras | {"elbows": cameras["front"]}
