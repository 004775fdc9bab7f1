"""The verdict on a result, in words: which frames and which joint angles can be relied on, by flags and σ.

An angle is called reliable up to 2°, to be used with care up to 5°, and not reliable beyond: the limits of McGinley et
al. 2009 for gait (DOI 10.1016/j.gaitpost.2008.09.003), here for the standard deviation that the covariance claims.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from twistcap.arrays import Float
from twistcap.body.model import split_side
from twistcap.estimate import UNSEEN
from twistcap.evaluate.filters import FIXED
from twistcap.evaluate.metrics import Row, row
from twistcap.io.coordinates import coordinates_of
from twistcap.io.result import Result
from twistcap.report.page import Statement
from twistcap.report.words import bump_in_words, in_spans, swaps

RELIABLE, CARE = 2.0, 5.0
"""Degrees of σ."""
GRADES: tuple[tuple[str, str, float, bool | None], ...] = (
    ("fixed", "Fixed by the body's joints, not measured", FIXED, None),
    ("yes", f"Reliable, σ within {RELIABLE:g}°", RELIABLE, True),
    ("care", f"Use with care, σ of {RELIABLE:g}° to {CARE:g}°", CARE, None),
    ("no", f"Not reliable, σ above {CARE:g}°", np.inf, False),
)
"""Of an angle: in a word, in words, up to which σ (degrees), and whether that is good."""
_MOST = 95.0  # per cent of the frames that must be within
_DOUBT = 0.2  # probability of loss from which a frame that is not lost is named
_USABLE = 0.9  # share of the frames
_SIDES = {"r": "right", "l": "left"}
TURNS = (
    "Turns of thighs, upper arms and forearms about their long axes can be more wrong than their σ says: they hardly "
    "change what cameras see."
)
"""What claims do not cover; measured in docs/concepts/covariance.md."""
_CAVEAT = (
    f"In brackets is the σ that {_MOST:g} % of the frames keep. It is what the images leave open. A body or cameras "
    "that are a little wrong shift angles by constants that it does not contain; compare with a reference to find them."
    f" {TURNS}"
)


def verdict_of(result: Result, doubts: Sequence[str] = ()) -> list[Statement]:
    """What can be relied on: frames, joint angles from best to worst, cameras. Empty for a result without frames.

    `doubts` are sentences about cameras that only the run knows: where they seem to stand, and their clocks."""
    if not len(result):
        return []
    cameras = [*_cameras(result), *(Statement(doubt, None) for doubt in doubts)]
    return [_frames(result), *_doubtful(result), *_angles(result), *cameras, Statement(_CAVEAT, None)]


def camera_rows(result: Result) -> list[Row]:
    """A table of the frames in which each camera disagreed with the others, was turned back, or showed nothing new."""
    counts = (("frames in which it disagrees and was left out", result.left_out),
              ("frames in which its pictures were turned back", np.any(result.bumps, axis=2)),
              ("frames in which its pictures came under another name", result.swapped),
              ("frames without anything new", result.missing))  # fmt: skip
    return [
        row(name, what, int(rows[:, c].sum()), f"of {len(result)}", at_most=0)
        for c, name in enumerate(result.rig.names)
        for what, rows in counts
    ]


def chosen_rows(result: Result) -> list[int]:
    """Rows of a few frames to look at: spread over those with images of the body, and the most doubtful one of them;
    of all frames where no image shows it."""
    seen = np.flatnonzero(~np.isin(result.statuses, UNSEEN))
    rows = seen if len(seen) else np.arange(len(result))
    spread = [int(rows[round(share * (len(rows) - 1))]) for share in (1 / 6, 1 / 2, 5 / 6)] if len(rows) else []
    return sorted({*spread, int(rows[np.argmax(np.nan_to_num(result.probability[rows]))])}) if spread else []


def _frames(result: Result) -> Statement:
    known, total = int(result.known.sum()), len(result)
    if known == total:
        return Statement(f"All {total} frames can be used: images support the body in each.", True)
    good = None if known >= _USABLE * total else False
    out = in_spans(result.indices, ~result.known)
    return Statement(f"{known} of {total} frames can be used. Leave out those that are lost or unseen: {out}.", good)


def _doubtful(result: Result) -> list[Statement]:
    rows = result.known & (result.probability >= _DOUBT)
    if not rows.any():
        return []
    words = f"Look at these frames before you use them; they are lost with a probability of {_DOUBT:g} or more: "
    return [Statement(words + in_spans(result.indices, rows) + ".", None)]


def _angles(result: Result) -> list[Statement]:
    known = result.known
    if not known.any():
        return []
    poses = [pose for pose, use in zip(result.poses, known, strict=True) if use]
    table = coordinates_of(result.body, poses, result.covariances[known])
    worst = kept_by_most(table.in_degrees[1])
    sigmas = {name: float(s) for name, s, turns in zip(table.names, worst, table.turning, strict=True) if turns}
    return [*graded(sigmas), _place(table.names, worst)]


def kept_by_most(sigmas: Float) -> Float:
    """The σ that 95 % of the rows of (N, …) keep."""
    return np.asarray(np.percentile(sigmas, _MOST, axis=0))


def grade_of(sigma: float) -> str:
    """``yes``, ``care`` or ``no``: whether an angle of this σ (degrees) can be relied on, ``no`` where it is NaN; or
    ``fixed`` by the body's joints.
    """
    return next((grade for grade, _, most, _ in GRADES if sigma <= most), GRADES[-1][0])


def graded(sigmas: Mapping[str, float]) -> list[Statement]:
    """Joint angles by grade, those that have any, with their σ (degrees)."""
    out = list[Statement]()
    for grade, words, _, good in GRADES:
        if names := {name: sigma for name, sigma in sigmas.items() if grade_of(sigma) == grade}:
            out.append(Statement(f"{words}: {named(names)}.", good))
    return out


def _place(names: Sequence[str], worst: Float) -> Statement:
    sigma = 1000.0 * max(float(worst[names.index(f"pelvis_t{axis}")]) for axis in "xyz")
    return Statement(f"The place of the pelvis is known to {sigma:.0f} mm (σ).", True if sigma <= 10.0 else None)


def named(sigmas: Mapping[str, float]) -> str:
    """``knee angle (1.2°), elbow flex right (1.9°)``: from the surest, both sides as one where both are there."""
    stems: dict[str, dict[str, float]] = {}
    for name, sigma in sigmas.items():
        stem, side = split_side(name)
        stems.setdefault(stem, {})[side] = sigma
    worst = {stem: max(sides.values()) for stem, sides in stems.items()}
    parts = [(stem, stems[stem]) for stem in sorted(stems, key=lambda stem: worst[stem])]
    return ", ".join(f"{stem.replace('_', ' ')}{_side(sides)} ({worst[stem]:.1f}°)" for stem, sides in parts)


def _side(sides: Mapping[str, float]) -> str:
    only = next(iter(sides)) if len(sides) == 1 else ""
    return f" {_SIDES[only]}" if only else ""


def _cameras(result: Result) -> list[Statement]:
    out = result.left_out.mean(axis=0)
    odd = [f"{name} in {100 * share:.0f} %" for name, share in zip(result.rig.names, out, strict=True) if share > 0]
    if not odd:
        return [Statement(f"None of the {len(result.rig)} cameras was left out.", True), *_displaced(result)]
    words = f"Cameras that disagree with the others and were left out: {', '.join(odd)} of the frames. Check them."
    return [Statement(words, False if out.max() > 1 - _USABLE else None), *_displaced(result)]


def _displaced(result: Result) -> list[Statement]:
    """Statements about cameras that gave other cameras' pictures, or were turned back."""
    names, swapped = result.rig.names, swaps(result)
    each = [f"{names[s]} those of {names[c]} in {in_spans(result.indices, rows)}" for s, c, rows in swapped]
    words = f"Cameras that gave the pictures of others: {', '.join(each)}. They were sorted by their backgrounds."
    mend = "Give the videos their right names, or plug the cables as they were when you calibrated."
    return [*([Statement(f"{words} {mend}", None)] if each else []), *_bumped(result)]


def _bumped(result: Result) -> list[Statement]:
    """A statement about cameras that were turned back, if there are any."""
    stood = np.any(result.bumps, axis=2)
    rows = [(name, int(np.argmax(stood[:, c])), c) for c, name in enumerate(result.rig.names) if stood[:, c].any()]
    if not rows:
        return []
    most = np.linalg.norm(result.bumps, axis=2).argmax(axis=0)
    each = [f"{n} {bump_in_words(result.bumps[most[c], c])} from frame {result.indices[k]} on" for n, k, c in rows]
    words = (
        f"Cameras that were bumped or sway: {', '.join(each)}. Their pictures were turned back by their backgrounds. "
    )
    return [Statement(words + "Look at where the body lies in them, and calibrate them before you film more.", None)]
