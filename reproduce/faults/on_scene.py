"""Faults of what is filmed and of the start: each takes a take and gives it with the fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reproduce.faults.figures import Figure, figure_of
from reproduce.faults.motions import jerked, moved
from reproduce.faults.take import Take, in_images
from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.limbs import limbs
from twistcap.studio.look import Look, look
from twistcap.studio.motion import gait
from twistcap.studio.scene import default_body

Rng = np.random.Generator

_OFF = 0.3  # m that the first pose is beside the person
_LIMB_OFF_DEG = 50.0  # by which the joints of the wrong limb are off, together
_FARTHEST = 7.0  # m that somebody walks at most to be out of all images
_STOOL = 0.42  # m, its height


def jerks(take: Take, rng: Rng) -> Take:
    """The person moves in jerks for a while."""
    poses, span = list(take.scene.true_poses), take.during
    poses[span] = jerked(take.scene.true_body, poses[span], float(rng.uniform(2.0, 6.0)), rng)
    return take.staged(true_poses=tuple(poses))


def first_pose_beside(take: Take, rng: Rng) -> Take:
    """The first pose is 0.3 m beside the person."""
    angle = rng.uniform(0, 2 * np.pi)
    (pose,) = moved([take.first_pose], 0.0, _OFF * np.array([np.cos(angle), np.sin(angle), 0.0]))
    return replace(take, first_pose=pose)


def first_limb_wrong(take: Take, rng: Rng) -> Take:
    """A limb of the first pose is turned by 50 degrees over all its joints."""
    body, q = take.scene.body, take.first_pose.q.copy()
    wide = np.ptp(body.limits, axis=1) > 1.5  # rad: what can be off so far
    chosen = [mask[6:] & wide for mask in limbs(body)]
    joints = [mask for mask in chosen if mask.sum() >= 2][int(rng.integers(4))]
    q[joints] += np.deg2rad(_LIMB_OFF_DEG) * rng.choice([-1.0, 1.0], joints.sum())
    return replace(take, first_pose=Pose(take.first_pose.root, q).within(body.limits))


def crossing_other(take: Take, rng: Rng) -> Take:
    """Somebody in other clothes walks past between the person and a camera."""
    seed = take.scene.config.seed + 7919
    return _crossing(take, rng, look(take.scene.true_body, replace(take.scene.config, seed=seed)))


def crossing_alike(take: Take, rng: Rng) -> Take:
    """Somebody in nearly the same clothes walks past between the person and a camera."""
    worn = take.scene.look
    shift = 1.0 + 0.05 * rng.standard_normal((len(worn.albedo), 1))
    return _crossing(take, rng, replace(worn, albedo=np.clip(worn.albedo * shift, 0.0, 1.0)))


def _crossing(take: Take, rng: Rng, worn: Look) -> Take:
    """Somebody passes 0.5 to 0.9 m before the person, as a camera sees it, in the middle of the fault's span."""
    scene, (first, last) = take.scene, take.span
    middle = (first + (take.count - 1 if last is None else last)) // 2
    centre = scene.true_poses[middle].root[:3, 3] * [1.0, 1.0, 0.0]
    towards = scene.true_rig[int(rng.integers(take.views))].centre - centre
    towards[2] = 0.0
    place = centre + rng.uniform(0.5, 0.9) * towards / np.linalg.norm(towards)
    heading = np.arctan2(towards[1], towards[0]) + rng.choice([-1.0, 1.0]) * np.pi / 2 + rng.uniform(-0.4, 0.4)
    body, speed = default_body(replace(scene.config, seed=scene.config.seed + 7919)), float(rng.uniform(1.2, 1.8))
    steps = gait(body, fps=scene.config.fps, frames=take.count, speed=speed, phase=float(rng.uniform()))
    back = np.array([-speed * middle / scene.config.fps, 0.0, 0.0])
    walked = moved(moved(steps, 0.0, back), float(heading), place)

    def company(frame: int) -> Sequence[Figure]:
        figure = figure_of(Posed(body, walked[frame]), worn)
        return [replace(figure, rest=figure.rest + 1.37)]  # the texture of another place of the cloth

    near = [np.linalg.norm(p.root[:2, 3] - q.root[:2, 3]) < 1.5 for p, q in zip(walked, scene.true_poses, strict=True)]
    during = np.flatnonzero(near)
    return replace(take.staged(company=company), span=(int(during[0]), int(during[-1])))


def out_and_in(take: Take, rng: Rng) -> Take:
    """The person walks out of all images, and comes back from elsewhere after the length of the span."""
    scene, (first, last) = take.scene, take.span
    assert last is not None
    out, back = (_way_out(take, rng) for _ in range(2))
    fps, speed = scene.config.fps, float(rng.uniform(1.3, 1.7))
    away = last - first + 1
    leaving = gait(scene.true_body, fps=fps, frames=1 + round((out[1] + 0.3) * fps / speed), speed=speed)
    coming = gait(scene.true_body, fps=fps, frames=1 + round((back[1] + 0.5) * fps / speed), speed=speed)
    there, here = np.array([-0.3, 0.0, 0.0]), np.array([-back[1], 0.0, 0.0])
    poses = moved(moved(leaving, 0.0, there), out[0], np.zeros(3))
    poses += [poses[-1]] * away + moved(moved(coming, 0.0, here), back[0] + np.pi, np.zeros(3))
    return retimed(replace(take, first_pose=poses[0]), poses, (len(leaving) - 1, len(leaving) + away))


def _way_out(take: Take, rng: Rng) -> tuple[float, float]:
    """A direction from the middle of the ring, rad, and the metres along it after which no image shows the person."""
    ways = [
        (float(angle), _metres_out(take, float(angle))) for angle in np.arange(12) * np.pi / 6 + rng.uniform(0, 0.5)
    ]
    return sorted(ways, key=lambda way: way[1])[int(rng.integers(3))]


def _metres_out(take: Take, angle: float) -> float:
    scene = take.scene
    stand = Pose(se3.transform(np.eye(3), scene.true_poses[0].root[:3, 3] * [0.0, 0.0, 1.0]), scene.true_poses[0].q)
    for distance in np.arange(0.5, _FARTHEST, 0.1):
        (pose,) = moved(moved([stand], 0.0, np.array([distance, 0.0, 0.0])), angle, np.zeros(3))
        if not in_images(Posed(scene.true_body, pose), scene.true_rig).any():
            return float(distance)
    return _FARTHEST


def retimed(take: Take, poses: Sequence[Pose], span: tuple[int, int]) -> Take:
    """The take with other poses, as many as they may be, before any fault of its cameras."""
    n, c = len(poses), take.views
    source = np.stack(np.meshgrid(np.arange(n), np.arange(c), indexing="ij"), axis=-1)
    scene = replace(
        take.scene, config=replace(take.scene.config, frames=n), true_poses=tuple(poses), first_pose=poses[0],
        bumps=np.zeros((n, c, 3)), exposure=np.ones((n, c)), grain=np.zeros(n), relit=np.zeros(n, np.bool_),
    )  # fmt: skip
    return replace(take, motion="walk", scene=scene, source=source, span=span, first_pose=poses[0])
