"""Which of the people in each view is the same person: the one on whom the views agree in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from twistcap.adjust.first_pose.triangulate import nearest_points
from twistcap.arrays import Bool, Float
from twistcap.camera import Rig
from twistcap.errors import InputError

_REACH, _LEAST = 0.05, 3.0  # px that agree: a fraction of the person's height in the image, and at least
_ENOUGH = 0.5  # of the joints seen twice that must agree, else a view does not show the person
_STRIDE = 0.5  # m that a person may have moved since the frame before
Choice = tuple[int | None, ...]
"""Person by camera; None where none of them is the one."""


def same_person(
    rig: Rig, people: Sequence[Float], pinned: Mapping[str, int] | None = None, before: Float | None = None
) -> tuple[Choice, Float]:
    """The person of each camera, and the joints (L, 3) on which the views agree, m, NaN where they do not.

    `people` are, by camera, (P, L, 3) x, y, confidence, confidence 0 where nothing was detected. Each pair of people of
    two cameras proposes joints in space, and all views vote. `pinned` are people that the user names, by camera, where
    that camera has people; `before` (L, 3) are the joints in the frame before, which must be near. Where no pair
    agrees, the first is taken.
    """
    return _agreed(rig, people, pinned or {}, before)[1:]


def check_arrangement(rig: Rig, people: Sequence[Float]) -> None:
    """Raises InputError where one person is in all views as soon as two cameras are exchanged, as if their videos were.

    Asked of three cameras or more: what two show of different people or times may agree by chance. People are (P, L, 3)
    by camera, as `same_person` takes them.
    """
    showing = [c for c, persons in enumerate(people) if np.any(persons[..., 2] > 0.0)]
    score, choice, _ = _agreed(rig, people, {}, None)
    alone = [c for c in showing if score == 0 or choice[c] is None]
    if len(showing) < 3 or not alone:
        return
    found = dict[str, float]()
    for c, d in combinations(alone if 1 < len(alone) < len(showing) / 2 else showing, 2):
        given = [people[{c: d, d: c}.get(k, k)] for k in range(len(rig))]
        better, chosen, _ = _agreed(rig, given, {}, None)
        if all(chosen[k] is not None for k in showing):
            found[f"{rig.names[c]} and {rig.names[d]}"] = better
    best = max(found.values(), default=0.0)
    clear = 0.5 * best / len(showing)  # half of what a camera says
    if best > score + clear:  # of four in a ring, either two that face each other
        pairs = ", or ".join(name for name, value in found.items() if value > best - clear)
        mend = "give each camera its own video, keypoints and calibration"
        raise InputError(f"[first_pose]: the keypoints of all cameras agree only if {pairs} are exchanged; {mend}.")


def _agreed(
    rig: Rig, people: Sequence[Float], pinned: Mapping[str, int], before: Float | None
) -> tuple[float, Choice, Float]:
    """By how much confidence the views agree, the person of each, and the joints."""
    allowed = [_allowed(len(p), pinned.get(name)) for name, p in zip(rig.names, people, strict=True)]
    needed = [k for k, name in enumerate(rig.names) if name in pinned and allowed[k]]
    best: tuple[float, Choice, Float] | None = None
    for c, d in combinations(range(len(rig)), 2):
        for i in allowed[c]:
            for j in allowed[d]:
                points = _between(rig, (c, d), (people[c][i], people[d][j]))
                if before is not None and not _near(points, before):
                    continue
                score, choice = _votes(rig, people, allowed, points)
                if any(choice[k] is None for k in needed):
                    continue
                if best is None or score > best[0]:
                    best = score, choice, points
    if best is None or best[0] <= 0:
        first = tuple(a[0] if a else None for a in allowed)
        return 0.0, first, np.full((people[0].shape[1], 3), np.nan)
    return best


def _allowed(count: int, pinned: int | None) -> list[int]:
    return list(range(count)) if pinned is None else [pinned] if pinned < count else []


def _between(rig: Rig, cameras: tuple[int, int], persons: tuple[Float, Float]) -> Float:
    """(L, 3) joints seen by two cameras."""
    centres = np.stack([rig[c].centre for c in cameras])
    directions = np.stack([np.nan_to_num(rig[c].rays(p[:, :2])[0]) for c, p in zip(cameras, persons, strict=True)])
    both = np.minimum(persons[0][:, 2], persons[1][:, 2])
    return nearest_points(centres, directions, np.stack([both, both]))


def _votes(rig: Rig, people: Sequence[Float], allowed: Sequence[Sequence[int]], points: Float) -> tuple[float, Choice]:
    """The person of each camera that is nearest to the joints, and by how much confidence they all agree."""
    total, choice = 0.0, list[int | None]()
    known = np.isfinite(points).all(axis=1)
    for camera, persons, some in zip(rig, people, allowed, strict=True):
        pixels, depth = camera.project(np.nan_to_num(points))
        votes = {i: _vote(persons[i], pixels, known & (depth > 0)) for i in some}
        person = max(votes, key=lambda i: votes[i], default=None)
        if person is None or votes[person] <= 0:
            choice.append(None)
            continue
        choice.append(person)
        total += votes[person]
    return (total, tuple(choice)) if sum(p is not None for p in choice) >= 2 else (0.0, tuple(choice))


def _vote(person: Float, pixels: Float, known: Bool) -> float:
    """Confidence of the joints that agree, less the mean error's fraction of the reach; 0 where too few do."""
    seen = person[:, 2] > 0
    both = seen & known
    if both.sum() < 3:
        return 0.0
    reach = max(_LEAST, _REACH * float(np.ptp(person[seen, :2], axis=0).max()))
    off = np.linalg.norm(pixels - person[:, :2], axis=1)
    agree = both & (off < reach)
    return float(np.sum(person[agree, 2] * (1 - off[agree] / reach))) if agree.sum() >= _ENOUGH * both.sum() else 0.0


def _near(points: Float, before: Float) -> bool:
    off = np.linalg.norm(points - before, axis=1)
    off = off[np.isfinite(off)]
    return len(off) == 0 or float(np.median(off)) < _STRIDE
