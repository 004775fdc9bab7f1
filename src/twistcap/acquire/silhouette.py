"""Silhouettes of the key views: the person against an empty plate, or a given mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Bool, Float, Float32
from twistcap.camera import Camera
from twistcap.errors import InputError

ROLES = {  # and what they need
    "front": "the person facing the camera, arms out sideways, feet apart",
    "side": "the same stance seen at a right angle to the front view",
    "above": "the arm view: the arms held out, seen from above",
    "elbows": "the joint view: upper arms out sideways, forearms straight up",
}
_KEPT = 0.35  # px of a person's rim that are kept: toes and fingers are thin
_TILT = np.deg2rad(30.0)  # two views farther than this from a right angle give poor control points
_NOISE = 4.0  # times the median difference from the plate: what differs more is the person


@dataclass(frozen=True)
class KeyView:
    """One key view: a camera without distortion and the person's silhouette (H, W) in its image."""

    role: str
    camera: Camera
    mask: Bool

    def soft(self, part: Bool | None = None) -> Float32:
        """(H, W) the silhouette, or a part of it, blurred by one pixel: its level 0.5 is between the pixels."""
        mask = self.mask if part is None else part
        return np.asarray(cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0), np.float32)


def difference_mask(image: AnyArray, plate: AnyArray) -> Bool:
    """(H, W) where an image differs from the empty plate by more than four times the median difference. Raises
    InputError if image and plate are not of one shape."""
    if image.shape != plate.shape:
        raise InputError(f"the image is {image.shape[1::-1]} and its background {plate.shape[1::-1]}; take both alike.")
    change = np.abs(cv2.GaussianBlur(image, (0, 0), 1.0).astype(float) - cv2.GaussianBlur(plate, (0, 0), 1.0))
    change = change.reshape(*change.shape[:2], -1).max(axis=2)
    mask = (change > max(_NOISE * float(np.median(change)), 5.0)).astype(np.uint8)  # most of the image is empty room
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel), cv2.MORPH_CLOSE, kernel)
    return _at_half_contrast(change, mask)


def _at_half_contrast(change: Float, mask: AnyArray) -> Bool:
    """The mask (H, W) eroded by the median depth at which the change reaches half of its value farther inside. Noise is
    small, so that a mask of all above noise contains the outer blur of the edge."""
    near, far = (cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (n, n)) for n in (9, 17))
    core = cv2.erode(mask, near)
    inner = cv2.dilate(np.where(core > 0, change, 0.0), far)
    half = ((core > 0) | ((mask > 0) & (change > 0.5 * inner))).astype(np.uint8)
    depth = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    edge = (half > 0) & (cv2.erode(half, np.ones((3, 3), np.uint8)) == 0)
    return depth > (float(np.median(depth[edge])) - 1.0 - _KEPT if edge.any() else 0.0)


def one_person(mask: Bool) -> Bool:
    """The largest connected piece of a mask (H, W), its holes of less than a hundredth of it filled."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count < 2:
        return np.zeros_like(mask)
    body = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    count, labels, stats, _ = cv2.connectedComponentsWithStats((~body).astype(np.uint8), connectivity=4)
    small = np.flatnonzero(stats[:, cv2.CC_STAT_AREA] < 0.01 * body.sum())
    return body | (np.isin(labels, small[small > 0]) & ~body)


def check_views(views: dict[str, KeyView]) -> None:
    """Check that a body can be built from the views. Raises InputError for a view that is missing, empty, cut off by
    the image's border, or not near-orthogonal."""
    for role, needs in ROLES.items():
        if role not in views:
            raise InputError(f"key view {role!r} is missing ({needs}); add [views.{role}].")
        _check_silhouette(views[role])
    middle = middle_of(views["front"], views["side"])
    for second in ("side", "above"):
        a, b = (views[role].camera.centre - middle for role in ("front", second))
        angle = float(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1.0, 1.0)))
        if abs(angle - np.pi / 2) > _TILT:
            both = f"'front' and {second!r} look at the person {np.rad2deg(angle):.0f}° apart"
            raise InputError(f"key views {both}; they must be near 90° (60° to 120°): move a camera.")


def _check_silhouette(view: KeyView) -> None:
    mask = view.mask
    if mask.sum() < 0.005 * mask.size:
        raise InputError(f"key view {view.role!r}: no person stands out; check its image, background or mask.")
    for name, line in {"top": mask[0], "bottom": mask[-1], "left": mask[:, 0], "right": mask[:, -1]}.items():
        if line.any():
            what = f"the silhouette touches the {name} border of the image"
            raise InputError(f"key view {view.role!r}: {what}; take the view again with the whole person inside it.")


def middle_of(front: KeyView, side: KeyView) -> Float:
    """(3,) the point nearest to the rays through the middles of two silhouettes, world, m."""
    return nearest_point([(v.camera, middle_pixel(v.mask)) for v in (front, side)])


def middle_pixel(mask: Bool) -> Float:
    """(2,) the middle (x, y) of the box around a mask."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return np.array([cols[0] + cols[-1], rows[0] + rows[-1]]) / 2.0


def nearest_point(rays: list[tuple[Camera, Float]]) -> Float:
    """(3,) the point with the least squared distances to the rays through one pixel (2,) in each camera, m."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for camera, pixel in rays:
        n = camera.rays(pixel)[0]
        across = np.eye(3) - np.outer(n, n)
        A, b = A + across, b + across @ camera.centre
    return np.asarray(np.linalg.solve(A, b), dtype=np.float64)
