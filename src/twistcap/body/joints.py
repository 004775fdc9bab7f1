"""A body as a tree of joints, each with its coordinates about axes through one point, as skeleton files want them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float
from twistcap.body.model import Body
from twistcap.body.shape import joint_coordinates, joint_origin, meeting_point
from twistcap.errors import InputError


@dataclass(frozen=True)
class Joint:
    """One joint: what it moves bears its name; `parent` is the number of the one above, −1 at the root.

    Attributes:
        segment: number of the segment; of two joints of one segment the first moves something without a surface.
        coordinates: its coordinates, the first outermost; none at the root.
        moved_by: the last coordinate that moves it, −1 for the root.
        origin: (3,) where its axes meet in the rest pose, m.
    """

    name: str
    parent: int
    segment: int
    coordinates: tuple[int, ...]
    moved_by: int
    origin: Float


def joints_of(body: Body) -> list[Joint]:
    """Joints, parents first. A segment whose axes do not meet in a point (ankle and subtalar) has two or more.

    Raises InputError for a body with several root segments, or with sliding coordinates.
    """
    if int(np.sum(body.segment_joint < 0)) != 1:
        raise InputError(f"body {body.name!r} must have one root segment.")
    if not np.all(np.any(body.twists[:, :3] != 0, axis=1)):
        raise InputError(f"body {body.name!r} has sliding coordinates, which the format cannot hold.")
    joints: list[Joint] = []
    of_segment: dict[int, int] = {}
    for s, name in enumerate(body.segment_names):
        parent = of_segment.get(int(body.segment_parent[s]), -1)
        runs = _runs(body, s)
        whole = joint_origin(body, s)
        for n, run in enumerate(runs):
            own = name if n == len(runs) - 1 else f"{name}_{n + 1}"
            origin = whole if len(runs) == 1 else meeting_point(body.twists[run], whole)[0]
            moved_by = run[-1] if run else int(body.segment_joint[s])
            joints.append(Joint(own, parent, s, tuple(run), moved_by, origin))
            parent = len(joints) - 1
        of_segment[s] = parent
    return joints


def _runs(body: Body, segment: int) -> list[list[int]]:
    """The coordinates between a segment and the one above, in runs whose axes meet in a point."""
    runs: list[list[int]] = [[]]
    for k in reversed(joint_coordinates(body, segment)):
        if runs[-1] and meeting_point(body.twists[[*runs[-1], k]], np.zeros(3))[1] > 1e-7:
            runs.append([])
        runs[-1].append(k)
    return runs
