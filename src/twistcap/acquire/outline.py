"""Landmarks of silhouettes: corners of curves, arm pits, crotch, neck; skeletons of limbs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twistcap.arrays import Bool, Float, Int, UInt8
from twistcap.errors import InputError

_PIT_ANGLE = np.deg2rad(150.0)  # an arm pit is sharper than this


@dataclass(frozen=True)
class Separation:
    """What the front silhouette falls into, pixels.

    Attributes:
        body_line: the row above which arm pits are looked for.
        pits: (2, 2) arm pits (x, y), the person's right one (left in the image) first.
        neck, crotch: (2,) narrowest place below the head; top of the gap between the legs.
        trunk, arms, legs: masks (H, W); arms and legs the person's right one first.
    """

    body_line: float
    pits: Float
    neck: Float
    crotch: Float
    trunk: Bool
    arms: tuple[Bool, Bool]
    legs: tuple[Bool, Bool]


def separate(mask: Bool, body_line: float | None = None, role: str = "front") -> Separation:
    """Arms, legs and trunk of a front silhouette (H, W), cut at the arm pits and the crotch.

    `body_line` is the row that bounds the search for arm pits from below, by default 0.42 of the person's height from
    the top; `role` that of the view, for messages. Raises InputError if an arm pit or the gap between the legs is not
    to be seen.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    top, height = int(rows[0]), int(rows[-1] - rows[0])
    line = top + 0.42 * height if body_line is None else body_line
    pits = _arm_pits(mask, line, height, role)
    arms = (_arm_beyond(mask, pits[0], -1), _arm_beyond(mask, pits[1], 1))
    rest = mask & ~arms[0] & ~arms[1]
    crotch = _crotch(rest, line, role)
    x, y = np.meshgrid(*(np.arange(n) for n in mask.shape[::-1]))
    below, on_right = rest & (y >= int(crotch[1])), x < round(float(crotch[0]))
    legs = (below & on_right, below & ~on_right)
    trunk = rest & ~below
    return Separation(line, pits, _neck(trunk, height, float(pits[:, 1].mean())), crotch, trunk, arms, legs)


def outline(mask: Bool) -> Float:
    """(N, 2) the boundary pixels (x, y) of a mask, clockwise in the image."""
    curves, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    curve = max(curves, key=len)[:, 0].astype(float)
    x, y = curve.T
    clockwise = x @ np.roll(y, -1) > y @ np.roll(x, -1)  # y runs down
    return curve if clockwise else curve[::-1]


def corners(curve: Float, reach: tuple[int, int], angle: float, closed: bool) -> tuple[Int, Float]:
    """Corners of a curve (N, 2): indices and opening angles, rad; negative where the corner is concave (closed curves).

    At each point the sharpest triangle with both arms `reach` points long is taken; of corners nearer to each other
    than the shorter reach the sharpest stays (Chetverikov and Szabó, "A simple and efficient algorithm for detection of
    high curvature points in planar curves", Austrian Pattern Recognition Group, 1999).
    """
    n = len(curve)
    opening, turn = np.full(n, np.pi), np.zeros(n)
    for k in range(reach[0], reach[1] + 1, max(1, (reach[1] - reach[0]) // 6)):
        a, b = np.roll(curve, k, axis=0) - curve, np.roll(curve, -k, axis=0) - curve
        cosine = (a * b).sum(axis=1) / np.maximum(np.hypot(*a.T) * np.hypot(*b.T), 1e-9)
        bend = np.arccos(np.clip(cosine, -1.0, 1.0))
        if not closed:
            bend[:k] = bend[n - k :] = np.pi
        sharper = bend < opening
        opening = np.where(sharper, bend, opening)
        turn = np.where(sharper, a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1], turn)  # > 0: to the right, as convex ones do
    kept: list[int] = []
    for i in np.argsort(opening):
        apart = [min(abs(i - j), n - abs(i - j)) if closed else abs(i - j) for j in kept]
        if opening[i] < angle and all(d > reach[0] for d in apart):
            kept.append(int(i))
    index = np.array(kept, dtype=np.int32)
    return index, np.where(turn[index] < 0, -1.0, 1.0) * opening[index]


def _arm_pits(mask: Bool, line: float, height: int, role: str) -> Float:
    """(2, 2) the lowest concave corner above the body line on either side, the one on the left first."""
    curve = outline(mask)
    reach = max(4, round(0.025 * height)), max(8, round(0.05 * height))
    index, opening = corners(curve, reach, _PIT_ANGLE, closed=True)
    concave = curve[index[opening < 0]]
    concave = concave[concave[:, 1] < line]
    rows = np.flatnonzero(mask.any(axis=1))
    top = np.flatnonzero(mask[rows[0] : rows[0] + max(2, height // 10)].any(axis=0))
    middle = (top[0] + top[-1]) / 2
    pits: list[Float] = []
    for side, name in ((-1, "right"), (1, "left")):
        own = concave[side * (concave[:, 0] - middle) > 0.03 * height]
        if len(own) == 0:
            mend = "hold the arms out sideways, or set body_line below the arm pits"
            raise InputError(f"key view {role!r}: the {name} arm pit is not to be seen; {mend}.")
        pits.append(own[np.argmax(own[:, 1])])
    return np.array(pits)


def _arm_beyond(mask: Bool, pit: Float, side: int) -> Bool:
    """The piece of a mask that a vertical cut upward from an arm pit leaves on one side (-1 left, 1 right)."""
    x, y = (round(float(p)) for p in pit)
    beyond = mask.copy()
    beyond[:, slice(0, x + 1) if side > 0 else slice(x, None)] = False
    _, labels = cv2.connectedComponents(beyond.astype(np.uint8))
    column = labels[: y + 1, x + side]
    below = column[column > 0]
    return (labels == below[-1]) & beyond if len(below) else np.zeros_like(mask)


def _crotch(rest: Bool, line: float, role: str) -> Float:
    """(2,) top of the gap between the legs: going up, the last row that has two pieces."""
    rows = np.flatnonzero(rest.any(axis=1))
    crotch = None
    for row in range(int(rows[-1]) - 2, int(line), -1):
        edges = np.flatnonzero(np.diff(rest[row].astype(np.int8)))
        if len(edges) >= 4:
            crotch = np.array([(edges[1] + edges[2] + 1) / 2.0, float(row)])
        elif crotch is not None:
            return crotch
    raise InputError(f"key view {role!r}: no gap is seen between the legs; stand with the feet apart.")


def _neck(trunk: Bool, height: int, pits: float) -> Float:
    """(2,) middle of the narrowest row between the shoulders and the widest row of the head."""
    widths = trunk.sum(axis=1).astype(float)
    top = int(np.flatnonzero(widths)[0])
    head = top + int(np.argmax(widths[top : top + round(0.09 * height)]))
    row = head + int(np.argmin(widths[head : round(pits)]))
    cols = np.flatnonzero(trunk[row])
    return np.array([(cols[0] + cols[-1]) / 2.0, float(row)])


def skeleton(mask: Bool) -> Bool:
    """The one pixel wide skeleton of a mask (H, W): Zhang and Suen, CACM 27(3), 1984, DOI 10.1145/357994.358023."""
    image = np.pad(mask, 1).astype(np.uint8)
    while True:
        before = int(image.sum())
        for first in (True, False):
            image[_removable(image, first)] = 0
        if int(image.sum()) == before:
            return image[1:-1, 1:-1] > 0


def _removable(image: UInt8, first: bool) -> Bool:
    """(H, W) pixels that one half-step of the thinning takes away."""
    around = [(-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1)]
    p = [np.roll(image, (-dy, -dx), axis=(0, 1)) for dy, dx in around]  # P2 … P9 of the paper
    neighbours = sum(q.astype(np.int8) for q in p)
    rises = sum(((a == 0) & (b == 1)).astype(np.int8) for a, b in zip(p, [*p[1:], p[0]], strict=True))
    n, e, s, w = p[0], p[2], p[4], p[6]
    free = (n * e * s == 0) & (e * s * w == 0) if first else (n * e * w == 0) & (n * s * w == 0)
    return (image == 1) & (neighbours >= 2) & (neighbours <= 6) & (rises == 1) & free
