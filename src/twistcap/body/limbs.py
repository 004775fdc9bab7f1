"""Limbs and branches of a body, by the coordinates that move its ends. The one definition of a limb."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body.model import Body, unsided

_NAMED_AFTER = {"head_top": "head", "wrist": "arm", "elbow": "arm", "ankle": "leg", "knee": "leg"}


def branches(body: Body) -> list[Bool]:
    """Masks (6 + J,) of coordinates that move the same ends of the body: the root's, then those of most ends first."""
    root = np.arange(body.dof) < 6
    return [root, *(mask for _, mask in _by_ends(body))]


def limbs(body: Body) -> list[Bool]:
    """Masks (6 + J,) of the coordinates of each limb: those that move the same single end of the body. With a hand of
    jointed fingers the fingers are limbs, and the arm is none."""
    return [mask for ends, mask in _by_ends(body) if ends == 1]


def limb_parts(body: Body, limb: Bool) -> Bool:
    """(S,) the segments that a limb's coordinates (6 + J,) move."""
    return np.asarray(body.chain[:, limb[6:]].any(axis=1), np.bool_)


def named_limbs(body: Body) -> dict[str, Bool]:
    """(S,) the segments of each limb by its name, such as ``arm_l``, ``head``; ``trunk`` is all others.

    A limb is named after its landmarks, else after its first segment.
    """
    own = [limb_parts(body, limb) for limb in limbs(body)]
    out: dict[str, Bool] = {}
    for part in own:
        name = _limb_name(body, part)
        out[name] = out.get(name, np.zeros_like(part)) | part
    rest = ~np.any(own, axis=0) if own else np.ones(len(body.segment_names), np.bool_)
    return out | {"trunk": rest} if rest.any() else out


def most_of_limbs(limbs: Mapping[str, Bool], values: Float) -> Float:
    """(..., G) the greatest of the values (..., S) of each limb's segments that are known; NaN where none is."""
    known = np.where(np.isnan(values), -np.inf, values)
    each = np.stack([known[..., own].max(axis=-1) for own in limbs.values()], axis=-1)
    return np.where(np.isneginf(each), np.nan, each)


def _limb_name(body: Body, part: Bool) -> str:
    marks = body.landmarks
    ends = [name for name, segment in zip(marks.names, marks.segments, strict=True) if part[segment]]
    for landmark, limb in _NAMED_AFTER.items():
        for name in ends:
            if unsided(name) == landmark:
                return limb + name[len(landmark) :]
    return body.segment_names[int(np.argmax(part))]


def segments_above(body: Body) -> Bool:
    """(S, S) whether a segment (column) is the other (row) itself or between it and the root."""
    chain = body.chain
    return np.asarray(np.all(chain <= chain[:, None], axis=2) & np.any(chain, axis=1), np.bool_)


def _by_ends(body: Body) -> list[tuple[int, Bool]]:
    """Number of ends of the body and mask (6 + J,) of each branch; those of most ends first."""
    carries = body.chain
    below = np.all(carries[:, None] >= carries, axis=2)  # all coordinates that move the column's segment move the row's
    ends = ~np.any(below & ~below.T, axis=0)
    groups: dict[bytes, list[int]] = {}
    for j, carried in enumerate(carries[ends].T):
        groups.setdefault(carried.tobytes(), []).append(j)
    return [(sum(key), np.isin(np.arange(body.dof) - 6, groups[key])) for key in sorted(groups, key=lambda k: -sum(k))]
