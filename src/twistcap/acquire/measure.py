"""From four checked silhouettes to slices of every part of the body, and joint centres."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twistcap import se3
from twistcap.acquire.joints import ArmCorner, arm_corner, narrowest
from twistcap.acquire.outline import Separation, separate
from twistcap.acquire.sections import Cut, sections
from twistcap.acquire.silhouette import KeyView, check_views, middle_of, middle_pixel, nearest_point
from twistcap.arrays import Bool, Float
from twistcap.body import proportions as P
from twistcap.body.model import unsided
from twistcap.errors import InputError, check

SIDES = ("r", "l")
_STEP = 0.012  # m between slices
_NEAR_PIT, _FLARE = 0.08, 0.6  # m from the arm pit where arms widen to shoulders; by how much, front and back, per m
# Joint shifts: place in anatomy less place in the silhouettes (x forward, y outward, z up; fractions of
# stature), in the poses of the key views. Measured on the built-in humanoid, but for the hip's height above the crotch:
# 0.530 (Winter 2009, fig. 4.1) less the 0.478 of the crotch in ANSUR. They hold for average people.
SHIFT: dict[str, tuple[float, float, float]] = {
    "shoulder": (0.0, 0.006, 0.0), "elbow": (0.0, 0.0025, 0.0), "wrist": (0.0, 0.012, 0.0),
    "hip": (0.0, 0.0, 0.052), "knee": (0.0, 0.0, 0.0), "ankle": (0.0, 0.0, 0.0), "neck": (0.0, 0.0, -0.025),
}  # fmt: skip


@dataclass(frozen=True)
class Measured:
    """Measurements from the views, in the body's axes: x forward, y left, z up, m; the origin is on the floor.

    `to_world` (4, 4) leads to the world. Slices are control points (n, 4, 3) by part (trunk, arm_r, arm_l, leg_r,
    leg_l), joints are centres (3,) by landmark name, in the pose of the front view. The separation is that of the front
    view, corners those of the joint view, px.
    """

    to_world: Float
    stature: float
    slices: dict[str, Float]
    joints: dict[str, Float]
    separation: Separation
    corners: dict[str, ArmCorner]


def measure(views: Mapping[str, KeyView], body_line: float | None = None) -> Measured:
    """Slices and joints from the key views front, side, above and elbows.

    Arm pits are searched for above `body_line`, a height above the floor, m. Raises InputError for views that are not
    enough for a body, naming view and reason.
    """
    check_views(dict(views))
    to_world = _axes(views["front"], views["side"], views["above"])
    cameras = {role: replace(v.camera, T_cam_world=v.camera.T_cam_world @ to_world) for role, v in views.items()}
    views = {role: replace(view, camera=cameras[role]) for role, view in views.items()}  # in the body's axes
    line = None if body_line is None else float(_pixel(views["front"], np.array([0.0, 0.0, body_line]))[1])
    front = separate(views["front"].mask, line)
    elbows = separate(views["elbows"].mask, line, "elbows")
    slices = {"trunk": _trunk_slices(views, front)}
    for k, s in enumerate(SIDES):
        slices[f"leg_{s}"] = _leg_slices(views, front.legs[k])
        slices[f"arm_{s}"] = _arm_slices(views, front.arms[k], 2 * k - 1)
    for part, control in slices.items():
        n = len(control)
        check("key views", n >= 8, f"{part} is seen in {n} slices; check silhouettes and calibration")
    floor, top = _heights(views["front"], slices)
    slices |= _mended(slices, views["side"], floor)
    stature = top - floor
    height = float(np.ptp(np.flatnonzero(views["front"].mask.any(axis=1))))
    corners = {s: arm_corner(elbows.arms[k], elbows.pits[k], height) for k, s in enumerate(SIDES)}
    neck = _frontal(views["front"], front.neck)
    joints = {"neck": np.array([_mid_depth(slices["trunk"], neck[2] + SHIFT["neck"][2] * stature), neck[1], neck[2]])}
    for k, s in enumerate(SIDES):
        joints |= _leg_joints(views["front"], slices[f"leg_{s}"], front, s, floor, stature)
        joints |= _arm_joints(views, slices[f"arm_{s}"], front.pits[k], elbows.arms[k], corners[s], s)
        joints[f"shoulder_{s}"][0] = _mid_depth(slices["trunk"], joints[f"shoulder_{s}"][2])
    joints = _straight(_shifted(_even_shoulders(joints), stature))
    return Measured(to_world, stature, slices, joints, front, corners)


def _even_shoulders(joints: dict[str, Float]) -> dict[str, Float]:
    """Both shoulders equally far from the neck: an arm pit is a blunt corner, sometimes 20 mm off, hardly both."""
    half, out = 0.5 * (joints["shoulder_l"][1] - joints["shoulder_r"][1]), dict(joints)
    for side, sign in (("r", -1.0), ("l", 1.0)):
        x, _, z = joints[f"shoulder_{side}"]
        out[f"shoulder_{side}"] = np.array([x, joints["neck"][1] + sign * half, z])
    return out


def _straight(joints: dict[str, Float]) -> dict[str, Float]:
    """Elbows and knees on the line of their neighbours, the zero of their angles; 10 mm off it would be 5° wrong."""
    out = dict(joints)
    for side in SIDES:
        for above, joint, below in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")):
            a, b, c = (joints[f"{n}_{side}"] for n in (above, joint, below))
            out[f"{joint}_{side}"] = a + (c - a) * ((b - a) @ (c - a)) / ((c - a) @ (c - a))
    return out


def _shifted(joints: dict[str, Float], stature: float) -> dict[str, Float]:
    """Joints moved from their places in the silhouettes to those in anatomy."""
    shifts = {n: np.array(SHIFT[unsided(n)]) * [1.0, -1.0 if n.endswith("_r") else 1.0, 1.0] for n in joints}
    return {name: point + stature * shifts[name] for name, point in joints.items()}


def _axes(front: KeyView, side: KeyView, above: KeyView) -> Float:
    """(4, 4) body axes in the world: z up, x away from the back, y from the right to the left fingertip. The origin is
    on the vertical through the middle of the silhouettes, at the height of the lowest pixel."""
    middle, up = middle_of(front, side), np.array([0.0, 0.0, 1.0])
    across = np.cross(up, (front.camera.centre - middle) * [1.0, 1.0, 0.0])
    both = (front, above)
    right, left = (nearest_point([(v.camera, _farthest(v, middle, w)) for v in both]) for w in (-across, across))
    left = (left - right) * [1.0, 1.0, 0.0]
    left /= np.linalg.norm(left)
    R = np.stack([np.cross(left, up), left, up], axis=1)
    low = np.array([middle_pixel(front.mask)[0], np.flatnonzero(front.mask.any(axis=1))[-1]])
    ray, centre = front.camera.rays(low)[0], front.camera.centre
    depth = ((middle - centre) @ R[:, 0]) / (ray @ R[:, 0])
    middle[2] = (centre + depth * ray)[2]
    return se3.transform(R, middle)


def _farthest(view: KeyView, middle: Float, way: Float) -> Float:
    """(2,) the pixel of a silhouette farthest in a world direction (3,) at a point (3,)."""
    ends, _ = view.camera.project(np.array([middle, middle + 0.1 * way / np.linalg.norm(way)]))
    pixels = np.argwhere(view.mask)[:, ::-1]
    reach = pixels @ (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return pixels[reach > reach.max() - 2.0].mean(axis=0)


def _frontal(view: KeyView, pixel: Float, x: float = 0.0) -> Float:
    """(3,) where the ray of a pixel (2,) meets the plane at depth x of the body, m."""
    ray, centre = view.camera.rays(pixel)[0], view.camera.centre
    return centre + ray * (x - centre[0]) / ray[0]


def _pixel(view: KeyView, point: Float) -> Float:
    return view.camera.project(point)[0]


def _cuts(views: Mapping[str, KeyView], part: Bool, second: str) -> tuple[Cut, Cut]:
    front, other = views["front"], views[second]
    return Cut(front.camera, front.soft(part)), Cut(other.camera, other.soft())


def _trunk_slices(views: Mapping[str, KeyView], front: Separation) -> Float:
    """(n, 4, 3) from the crotch to the top of the head."""
    rows = np.flatnonzero(front.trunk.any(axis=1))
    top = _frontal(views["front"], np.array([front.neck[0], rows[0]]))[2]
    bottom = _frontal(views["front"], front.crotch)[2]
    middles = [np.array([0.0, 0.0, z]) for z in np.arange(bottom + 0.005, top, _STEP)]
    return sections(*_cuts(views, front.trunk, "side"), middles)


def _leg_slices(views: Mapping[str, KeyView], leg: Bool) -> Float:
    """(n, 4, 3) from the crotch to the sole."""
    rows = np.flatnonzero(leg.any(axis=1))
    at = {int(r): float(np.flatnonzero(leg[r]).mean()) for r in rows}
    ends = [_frontal(views["front"], np.array([at[int(r)], r]))[2] for r in (rows[0], rows[-1])]
    middles: list[Float] = []
    for z in np.arange(ends[0] - 0.005, ends[1], -_STEP):
        row = int(np.clip(round(float(_pixel(views["front"], np.array([0.0, 0.0, z]))[1])), rows[0], rows[-1]))
        middles.append(_frontal(views["front"], np.array([at[row], row])))
    return sections(*_cuts(views, leg, "side"), middles)


def _arm_slices(views: Mapping[str, KeyView], arm: Bool, sign: int) -> Float:
    """(n, 4, 3) from the arm pit to the fingertip; `sign` is -1 for the right arm."""
    cols = np.flatnonzero(arm.any(axis=0))
    cols = cols if sign > 0 else cols[::-1]
    at = {int(c): float(np.flatnonzero(arm[:, c]).mean()) for c in cols}
    points = np.array([_frontal(views["front"], np.array([c, at[int(c)]])) for c in cols])
    wanted = np.arange(abs(points[0, 1]) + 0.003, abs(points[-1, 1]), _STEP)
    middles = points[np.searchsorted(np.abs(points[:, 1]), wanted).clip(0, len(points) - 1)]
    return _beside_trunk(sections(*_cuts(views, arm, "above"), middles))


def _beside_trunk(arm: Float) -> Float:
    """The slices (n, 4, 3) of an arm, from its pit outward, without the trunk in the view from above. Breast and
    shoulder blade are 30 to 70 mm before or behind the first slices; the arm itself widens smoothly."""
    out, y = arm.copy(), np.abs(arm.mean(axis=1)[:, 1])
    near = np.flatnonzero(y < y.min(initial=np.inf) + _NEAR_PIT)
    edges = arm[:, :, 0].reshape(-1, 2, 2).mean(axis=2)
    for k, pair in enumerate(([0, 1], [2, 3])):
        way = np.sign(edges[:, k] - edges[:, 1 - k])
        reach = way * edges[:, k]
        for n in near[-2::-1]:
            reach[n] = min(reach[n], reach[n + 1] + _FLARE * (y[n + 1] - y[n]))
        out[:, pair, 0] += (way * reach - edges[:, k])[:, None]
    return out


def _heights(view: KeyView, slices: Mapping[str, Float]) -> tuple[float, float]:
    """Floor and top of the head, m: the lowest pixel is a tip of a foot, the highest the middle of the head."""
    rows = np.flatnonzero(view.mask.any(axis=1))
    toes = max(float(slices[f"leg_{s}"][-8:, :, 0].max()) for s in SIDES)
    depths = (float(slices["trunk"][-1, :, 0].mean()), toes)
    top, floor = (
        float(_frontal(view, np.array([np.flatnonzero(view.mask[r]).mean(), r]), x)[2])
        for r, x in zip((rows[0], rows[-1]), depths, strict=True)
    )
    return floor, top


def _mended(slices: Mapping[str, Float], side: KeyView, floor: float) -> dict[str, Float]:
    """Trunk and legs without the other limbs in the side view."""
    hidden = _arms_seen(side, [slices["arm_r"], slices["arm_l"]])
    right, left = (control[control[:, :, 2].mean(axis=1) > floor] for control in (slices["leg_r"], slices["leg_l"]))
    trunk = _beside_arms(slices["trunk"], side, hidden)
    return {"trunk": trunk, "leg_r": _as_deep(right, left), "leg_l": _as_deep(left, right)}


def _as_deep(leg: Float, other: Float) -> Float:
    """The slices (n, 4, 3) of a leg as deep as its own and the other's slices at this height have in common. From the
    side, one leg hides behind the other, and the silhouette is that of both."""
    z, other_z = leg.mean(axis=1)[:, 2], other.mean(axis=1)[::-1, 2]
    out, pairs = leg.copy(), ([0, 1], [2, 3])
    own = np.array([leg[:, p, 0].mean(axis=1) for p in pairs])
    there = np.array([np.interp(z, other_z, other[::-1, p, 0].mean(axis=1)) for p in pairs])
    front, back = np.minimum(own.max(axis=0), there.max(axis=0)), np.maximum(own.min(axis=0), there.min(axis=0))
    shared = np.where(own == own.max(axis=0), front, back)
    shared = np.where(front - back > 0.02, shared, own)
    for k, pair in enumerate(pairs):
        out[:, pair, 0] += (shared[k] - own[k])[:, None]
    return out


def _arms_seen(side: KeyView, arms: list[Float]) -> Bool:
    """(H, W) where forearms and hands are seen in the side view, with a margin of 3 px around them."""
    out = np.zeros(side.mask.shape, np.uint8)
    for arm in arms:
        pixels = side.camera.project(arm[len(arm) // 2 :])[0]
        for one, two in itertools.pairwise(pixels):
            hull = cv2.convexHull(np.concatenate([one, two]).astype(np.float32))
            cv2.fillConvexPoly(out, np.round(hull).astype(np.int32), 1)
    return cv2.dilate(out, np.ones((7, 7), np.uint8)) > 0


def _beside_arms(trunk: Float, side: KeyView, arms: Bool) -> Float:
    """The slices (n, 4, 3) of the trunk, their front and back taken from their neighbours where an arm hides them."""
    out, z = trunk.copy(), trunk.mean(axis=1)[:, 2]
    for pair in ([0, 1], [2, 3]):
        edge = trunk[:, pair].mean(axis=1)
        x, y = np.round(side.camera.project(edge)[0]).astype(int).T
        free = ~arms[y.clip(0, len(arms) - 1), x.clip(0, arms.shape[1] - 1)]
        if free.sum() >= 2:
            out[:, pair, 0] += (np.interp(z, z[free], edge[free, 0]) - edge[:, 0])[:, None]
    return out


def _mid_depth(trunk: Float, z: float) -> float:
    """Middle of the trunk between front and back at a height, m."""
    centres = trunk.mean(axis=1)
    return float(np.interp(z, centres[:, 2], centres[:, 0]))


def _leg_joints(
    view: KeyView, leg: Float, front: Separation, side: str, floor: float, stature: float
) -> dict[str, Float]:
    """Hip, knee and ankle of a leg: from the front on the line its slices follow, from the side on the plumb line. A
    straight leg shows neither knee nor ankle: their heights are those of Winter (2009), fig. 4.1."""
    centres = leg.mean(axis=1)
    crotch = float(_frontal(view, front.crotch)[2])
    hip_z = crotch + SHIFT["hip"][2] * stature
    ankle_z = floor + P.RATIOS["ankle_height"] * stature
    straight = (centres[:, 2] > ankle_z + 0.06 * stature) & (centres[:, 2] < crotch - 0.06 * stature)
    if straight.sum() < 4:
        raise InputError("key views: the legs are not seen from thigh to shank; check silhouettes and calibration.")
    fit = np.polynomial.polynomial.polyfit(centres[straight, 2], centres[straight, :2], 1)
    ratio = P.RATIOS["thigh"] / (P.RATIOS["thigh"] + P.RATIOS["shank"])
    heights = {"hip": crotch, "knee": hip_z + ratio * (ankle_z - hip_z), "ankle": ankle_z}
    x = float(centres[(centres[:, 2] > ankle_z) & (centres[:, 2] < crotch), 0].mean())
    y = {n: float(fit[0, 1] + fit[1, 1] * z) for n, z in heights.items()}
    y["ankle"] = float(np.interp(ankle_z + 0.02 * stature, centres[::-1, 2], centres[::-1, 1]))
    return {f"{n}_{side}": np.array([x, y[n], z]) for n, z in heights.items()}


def _arm_joints(
    views: Mapping[str, KeyView], arm: Float, pit: Float, bent: Bool, corner: ArmCorner, side: str
) -> dict[str, Float]:
    """Shoulder at the arm pit, elbow at its distance from the fingertip in the joint view, wrist at the narrowest."""
    centres = arm.mean(axis=1)
    x = float(np.median(centres[:, 0]))
    tip = centres[-1] + (centres[-1] - centres[-6]) / 5.0 * 0.5
    forearm = corner.path[: max(2, corner.corner // 2)].mean(axis=0) - corner.elbow
    pixels = np.argwhere(bent)[:, ::-1]
    end = pixels[np.argmax((pixels - corner.elbow) @ forearm)]
    reach = float(np.linalg.norm(np.subtract(*(_frontal(views["elbows"], p, x) for p in (end, corner.elbow)))))
    from_tip = np.linalg.norm(centres - tip, axis=1)
    wrist = narrowest(arm, from_tip, (0.3 * reach, 0.65 * reach))

    def at(distance: float) -> Float:
        return np.array([np.interp(distance, from_tip[::-1], centres[::-1, k]) for k in range(3)])

    upper = (from_tip > reach) & (from_tip < reach + 0.7 * (from_tip[0] - reach))
    fit = np.polynomial.polynomial.polyfit(centres[upper, 1], centres[upper], 1)
    shoulder = fit[0] + fit[1] * _frontal(views["front"], pit, x)[1]
    return {f"shoulder_{side}": shoulder, f"elbow_{side}": at(reach), f"wrist_{side}": at(wrist)}
