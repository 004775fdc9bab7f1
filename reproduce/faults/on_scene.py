"""Faults of what is filmed and of the start: each takes a take and gives it with the fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reproduce.faults import on_images
from reproduce.faults.figures import Figure, box, figure_of
from reproduce.faults.motions import jerked, moved
from reproduce.faults.take import Take, in_images, own_pictures
from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.limbs import limbs
from twistcap.camera import Camera, Rig
from twistcap.studio.look import GARMENTS, Look, garment_fractions, look
from twistcap.studio.motion import gait
from twistcap.studio.scene import default_body

Rng = np.random.Generator

_OFF = 0.3  # m that the first pose is beside the person
_LIMB_OFF_DEG = 50.0  # by which the joints of the wrong limb are off, together
_FARTHEST = 7.0  # m that somebody walks at most to be out of all images
_AFTERWARDS = 10  # frames that must follow for a fault to count as over
_DARK = np.array([0.075, 0.07, 0.08])  # of the trousers and the chair
_BORDER = 4.0  # px between the edge of a cropped picture and what is still in it


def jerks(take: Take, rng: Rng) -> Take:
    """The person moves in jerks for a while."""
    poses, span = list(take.scene.true_poses), take.during
    poses[span] = jerked(take.scene.true_body, poses[span], float(rng.uniform(2.0, 6.0)), rng)
    return take.staged(true_poses=tuple(poses))


def first_pose_beside(take: Take, rng: Rng) -> Take:
    """The first pose is 0.3 m beside the person."""
    angle = rng.uniform(0, 2 * np.pi)
    (pose,) = moved([take.first_pose], 0.0, _OFF * np.array([np.cos(angle), np.sin(angle), 0.0]))
    return replace(take, first_pose=pose, span=(0, 0))


def first_limb_wrong(take: Take, rng: Rng) -> Take:
    """A limb of the first pose is turned by 50 degrees over all its joints."""
    body, q = take.scene.body, take.first_pose.q.copy()
    wide = np.ptp(body.limits, axis=1) > 1.5  # rad: what can be off so far
    chosen = [mask[6:] & wide for mask in limbs(body)]
    moving = [mask for mask in chosen if mask.sum() >= 2]
    joints = moving[int(rng.integers(len(moving)))]
    q[joints] += np.deg2rad(_LIMB_OFF_DEG) * rng.choice([-1.0, 1.0], joints.sum())
    return replace(take, first_pose=Pose(take.first_pose.root, q).within(body.limits), span=(0, 0))


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
    ended = take.count - 1 - during[-1] >= _AFTERWARDS
    return replace(take.staged(company=company), span=(int(during[0]), int(during[-1]) if ended else None))


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
    scene = replace(
        take.scene, config=replace(take.scene.config, frames=n), true_poses=tuple(poses), first_pose=poses[0],
        bumps=np.zeros((n, c, 3)), exposure=np.ones((n, c)), grain=np.zeros(n), relit=np.zeros(n, np.bool_),
    )  # fmt: skip
    return replace(take, motion="walk", scene=scene, source=own_pictures(n, c), span=span, first_pose=poses[0])


def cropped(take: Take, rng: Rng) -> Take:
    """All pictures end above the head, so that raised arms leave them, or at the knees."""
    top, scene = take.motion == "reach", take.scene
    landmark = scene.true_body.landmarks.index
    names = ("head_top",) if top else ("knee_r", "knee_l")
    points = scene.landmarks[:, [landmark(name) for name in names]]
    cameras: list[Camera] = []
    for camera in scene.true_rig:
        rows, K = camera.project(points)[0][..., 1], camera.K.copy()
        K[1, 2] += _BORDER - rows.min() if top else camera.size[1] - 1 - _BORDER - rows.min()
        cameras.append(replace(camera, K=K))
    return take.staged(true_rig=Rig(tuple(cameras)), rig=Rig(tuple(cameras)))


def dark_chair(take: Take, rng: Rng) -> Take:
    """Somebody in dark trousers sits on a chair as dark."""
    scene, body = take.scene, take.scene.true_body
    albedo, contrast = scene.look.albedo.copy(), scene.look.contrast.copy()
    trousers = GARMENTS.index("trousers")
    albedo[trousers], contrast[trousers] = _DARK, 0.05
    cover = garment_fractions(body, short_sleeves=bool(rng.random() < 0.5), shorts=False)
    worn = replace(scene.look, albedo=albedo, contrast=contrast, cover=cover)
    colour = _DARK * rng.uniform(0.85, 1.2)
    sitting = Posed(body, scene.true_poses[0])
    under = np.isin(body.vertex_part, [body.segment(name) for name in ("pelvis", "femur_r", "femur_l")])
    seat, pelvis = float(sitting.vertices[under][:, 2].min()) + 0.02, scene.true_poses[0].root[:3, 3]
    place = np.array([pelvis[0], pelvis[1], 0.0])
    parts = (
        box(np.array([-0.22, -0.26, 0.0]), np.array([0.26, 0.26, seat]), 0.0, place, colour),
        box(np.array([-0.28, -0.26, 0.0]), np.array([-0.22, 0.26, seat + 0.5]), 0.0, place, colour),
    )
    return take.staged(look=worn, company=lambda frame: parts)


def two_at_once(take: Take, rng: Rng) -> Take:
    """Two different faults of cameras or lights in the same span."""
    for k in rng.choice(len(_COMBINED), 2, replace=False):
        take = _COMBINED[k](take, rng)
    return take


_COMBINED = (
    on_images.blackout, on_images.dropped, on_images.frozen, on_images.out_of_step, on_images.bump, on_images.flicker,
    on_images.light_switched, on_images.grain, jerks, crossing_other,
)  # fmt: skip
