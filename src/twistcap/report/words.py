"""What a result says of itself, in words: which frames are lost and by which limb, which cameras were not believed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from twistcap.arrays import Bool, Float, Int, runs
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import most_of_limbs, named_limbs
from twistcap.estimate import Estimate
from twistcap.io.result import Result

DOUBTFUL = 0.5
"""Probability from which on a limb of a lost body is named."""
_WORTH = 5  # frames in a row in which a limb is in no image before that is said
_SPANS = 12  # most that a sentence lists
CONTRADICTS = "contradicts the others (bumped, frozen, late or swapped?)"
NOTHING_NEW = "a picture that is missing, blank, or the one before once more"
_UNSEEN_WORDS = {"no_images": "no images", "not_found": "not found", "failed": "failed"}
_STEP, _STEPS, _OF = 0.06, 4, 7  # of log brightness; so many such steps, of so many, and no person makes them
_BESIDE = 0.1  # m from which on a first pose was wrong
_SIDES = {"_l": "left ", "_r": "right "}


def limb_in_words(name: str) -> str:
    """``arm_l`` as `left arm`."""
    side = _SIDES.get(name[-2:], "")
    return (side + name[:-2] if side else name).replace("_", " ")


def unseen_limbs(limbs: Mapping[str, Bool], probability: Float) -> Bool:
    """(..., G) limbs that are not judged, by the probabilities (..., S); none where no body was seen."""
    hidden = np.isnan(probability)
    return np.stack([hidden[..., own].all(axis=-1) & ~hidden.all(axis=-1) for own in limbs.values()], axis=-1)


def doubtful(limbs: Mapping[str, Bool], probability: Float) -> tuple[str, ...]:
    """Names of those limbs that are probably lost, of the most doubtful one where none is.

    `probability` (S,) is that of each segment, NaN where it is not known; there is no name where none is known.
    """
    each = dict(zip(limbs, most_of_limbs(limbs, probability), strict=True))
    known = {name: float(value) for name, value in each.items() if not np.isnan(value)}
    worst = max(known.values(), default=0.0)
    return tuple(name for name, value in known.items() if value >= min(worst, DOUBTFUL))


def doubtful_in_words(limbs: Mapping[str, Bool], probability: Float) -> str:
    """`left arm, head`, or `whole body` for more than half of its limbs."""
    names = doubtful(limbs, probability)
    return "whole body" if len(names) > max(1, len(limbs) / 2) else ", ".join(map(limb_in_words, names))


def state_in_words(estimate: Estimate, limbs: Mapping[str, Bool]) -> str:
    """`lost: left arm`, `lost: no images`; empty for a frame that is not lost."""
    if not estimate.lost:
        return ""
    parts = estimate.part_probability
    why = _UNSEEN_WORDS.get(estimate.status, "") if parts is None else doubtful_in_words(limbs, parts)
    return f"lost: {why}" if why else "lost"


def bump_in_words(bump: Float) -> str:
    """`by 1.2°` for a turn (3,) of a camera; empty for none."""
    return f"by {np.rad2deg(np.linalg.norm(bump)):.1f}°" if np.any(bump) else ""


def camera_in_words(estimate: Estimate | None, camera: int, pictured: bool = True) -> str:
    """`left out`, `no image`, `nothing new` (blank, or the one before once more), `swapped` or `bumped by 1.2°`; empty
    where all is well.
    """
    if estimate is not None and camera in estimate.left_out:
        return "left out"
    if not pictured:
        return "no image"
    if estimate is None or camera in estimate.missing:
        return "nothing new" if estimate is not None else ""
    turned = "" if estimate.bumps is None else bump_in_words(estimate.bumps[camera])
    notes = ["swapped"] * (camera in estimate.swapped) + [f"bumped {turned}"] * bool(turned)
    return ", ".join(notes)


def frame_in_words(estimate: Estimate, limbs: Mapping[str, Bool], cameras: Sequence[str]) -> str:
    """`lost: left arm (probability 0.93); camera cam2 is left out`; empty where all is well."""
    lost = f"{state_in_words(estimate, limbs)} (probability {estimate.probability:.2f})" if estimate.lost else ""
    out = [f"camera {cameras[c]} is left out" for c in estimate.left_out]
    bumps = () if estimate.bumps is None else map(bump_in_words, estimate.bumps)
    out += [f"camera {name} is bumped {turned}" for name, turned in zip(cameras, bumps, strict=False) if turned]
    out += ["another light?"] * estimate.relit
    out += [f"camera {cameras[estimate.sources[c]]} gives the picture of {cameras[c]}" for c in estimate.swapped]
    some = estimate.missing if len(estimate.missing) < len(cameras) else ()
    return "; ".join(filter(None, [lost, *out, *(f"camera {cameras[c]} shows nothing new" for c in some)]))


def beside_in_words(body: Body, given: Pose, estimate: Estimate) -> list[str]:
    """A sentence about how far the first frame shows the body, or limbs of it, from the given first pose; none where
    that is right, or nobody knows.
    """
    if estimate.lost or not estimate.seen:
        return []
    shift = Posed(body, estimate.pose).segment_middles - Posed(body, given).segment_middles
    whole, limbs = float(np.linalg.norm(np.median(shift, axis=0))), named_limbs(body)
    own = np.linalg.norm(shift - np.median(shift, axis=0), axis=1)
    moved = [(limb_in_words(name), shift[parts]) for name, parts in limbs.items() if own[parts].max() > _BESIDE]
    found = [f"the body {whole:.2f} m"] if whole > _BESIDE else []
    found += [f"{name} {np.linalg.norm(each, axis=1).max():.2f} m" for name, each in moved]
    return (
        [f"frame {estimate.index} shows {', '.join(found)} from the first pose; it is tracked there"] if found else []
    )


def result_in_words(result: Result) -> list[str]:
    """Sentences about frames that are lost or not tracked yet, cameras that were left out, and pictures that showed
    nothing new.
    """
    if not len(result):
        return []
    unfinished = [f"the track {result.unfinished}"] if result.unfinished else []
    return [_lost(result), *unfinished, *_unseen(result), *cameras_in_words(result)]


def cameras_in_words(result: Result) -> list[str]:
    """Sentences about cameras: that they were left out, bumped, swapped, or showed nothing for a while."""
    none = np.asarray(result.missing.all(axis=1), np.bool_)
    names, out, some = result.rig.names, result.left_out.T, result.missing.T & ~none
    found = [(f"camera {n} was left out", f"; it {CONTRADICTS}", rows) for n, rows in zip(names, out, strict=True)]
    found += [_bumped(n, bumps) for n, bumps in zip(names, result.bumps.swapaxes(0, 1), strict=True)]
    found += [
        (f"camera {names[source]} gave the pictures of {names[c]}", " (they count as those)", rows)
        for source, c, rows in swaps(result)
    ]
    found += [("all pictures changed at once", " (another light? The body's look was learned again)", result.relit)]
    found += _flicker(result)
    found += [("no camera showed anything new", f" ({NOTHING_NEW})", none)]
    found += [
        (f"camera {n} showed nothing new", f" ({NOTHING_NEW})", rows) for n, rows in zip(names, some, strict=True)
    ]
    return [
        f"{what} in {_frames(int(rows.sum()))}: {in_spans(result.indices, rows)}{why}"
        for what, why, rows in found
        if rows.any()
    ]


def swaps(result: Result) -> list[tuple[int, int, Bool]]:
    """The camera that gave another one's pictures, that one, and the rows (N,) in which it did."""
    pairs = ((s, c) for s in range(len(result.rig)) for c in range(len(result.rig)) if s != c)
    each = [(s, c, np.asarray(result.sources[:, c] == s, np.bool_)) for s, c in pairs]
    return [(s, c, rows) for s, c, rows in each if rows.any()]


def _bumped(name: str, bumps: Float) -> tuple[str, str, Bool]:
    """What is said of the turns (N, 3) of a camera, and of which rows (N,)."""
    rows = np.asarray(np.any(bumps, axis=1), np.bool_)
    most = bump_in_words(bumps[np.linalg.norm(bumps, axis=1).argmax()])
    return f"camera {name} was out of its place", f" (turned {most} at most; its pictures are turned back)", rows


def _flicker(result: Result) -> list[tuple[str, str, Bool]]:
    """What is said of pictures that get brighter and darker, and of which rows (N,): of all cameras together where most
    of it is in all of them.
    """
    each = np.array([flickering(one) for one in result.brightness.T])
    whose = [(f"camera {name}", [c], rows) for c, (name, rows) in enumerate(zip(result.rig.names, each, strict=True))]
    if len(each) > 1 and 2 * each.all(axis=0).sum() > each.any(axis=0).sum():
        whose = [("all cameras", [*range(len(each))], np.asarray(each.any(axis=0), np.bool_))]
    return [
        (f"the pictures of {who} got brighter and darker", _wavered(result.brightness[:, own], rows), rows)
        for who, own, rows in whose
        if rows.any()
    ]


def _wavered(brightness: Float, rows: Bool) -> str:
    """How far brightness (N, C) strays from its mean in a run of the rows (N,), and what may have been the cause."""
    shown = [one[~np.isnan(one)] for a, b in runs(rows) for one in brightness[a:b].T]
    most = max(float(np.abs(one / one.mean() - 1.0).max()) for one in shown if len(one))
    return f" (by {100.0 * most:.0f} % of their mean; lamps that flicker, or automatic exposure?)"


def flickering(brightness: Float) -> Bool:
    """(N,) frames about which a camera's brightness (N,) goes up and down: four steps of seven successive ones are of
    more than 6 %, some of them up and some down. A switched light is one step; pictures that are missing are left out.
    """
    shown = np.flatnonzero(~np.isnan(brightness))
    steps, out = np.diff(np.log(np.maximum(brightness[shown], 1e-3))), np.zeros(len(brightness), np.bool_)
    for first in range(max(len(steps) - _OF, 0) + 1):
        strong = steps[first : first + _OF]
        up, down = (strong > _STEP).sum(), (strong < -_STEP).sum()
        if up and down and up + down >= _STEPS:
            which = first + np.flatnonzero(np.abs(strong) > _STEP)
            out[shown[which[0]] : shown[which[-1] + 1] + 1] = True
    return out


def in_spans(indices: Int, rows: Bool, notes: Sequence[str] = ()) -> str:
    """Frame numbers (N,) of the rows (N,) that are true, runs as `211–222`, each run with its note."""
    each = [str(indices[a]) if b - a == 1 else f"{indices[a]}–{indices[b - 1]}" for a, b in runs(rows)]
    noted = [f"{span} ({note})" if note else span for span, note in zip(each, notes or [""] * len(each), strict=True)]
    more = [f"and {len(noted) - _SPANS} spans more"] if len(noted) > _SPANS else []
    return ", ".join([*noted[:_SPANS], *more])


def _lost(result: Result) -> str:
    lost = int(result.lost.sum())
    if not lost:
        return f"none of {_frames(len(result))} lost"
    limbs = named_limbs(result.body)
    notes = [_why(result, limbs, slice(a, b)) for a, b in runs(result.lost)]
    return f"{lost} of {_frames(len(result))} lost: {in_spans(result.indices, result.lost, notes)}"


def _unseen(result: Result) -> list[str]:
    """A sentence for each limb that is not judged for a while."""
    limbs = named_limbs(result.body)
    each = zip(limbs, unseen_limbs(limbs, result.part_probability).T, strict=True)
    shown = [(name, _long(rows)) for name, rows in each]
    return [
        f"{limb_in_words(name)}: not whole in any image, or like what is behind it, and not judged, "
        f"in {_frames(int(rows.sum()))}: {in_spans(result.indices, rows)}"
        for name, rows in shown
        if rows.any()
    ]


def _long(rows: Bool) -> Bool:
    """The rows (N,) of runs that are worth a word."""
    out = np.zeros(len(rows), np.bool_)
    for first, end in runs(rows):
        out[first:end] = end - first >= _WORTH
    return out


def _why(result: Result, limbs: Mapping[str, Bool], span: slice) -> str:
    """What is most doubtful in a span of lost frames: limbs, or why there is no body."""
    probability = result.part_probability[span]
    seen = ~np.isnan(probability).all(axis=1)
    if seen.any():
        known = probability[seen]
        counts = (~np.isnan(known)).sum(axis=0)
        means = np.nansum(known, axis=0) / np.maximum(counts, 1)
        return doubtful_in_words(limbs, np.where(counts > 0, means, np.nan))
    statuses = dict.fromkeys(result.statuses[span])
    return ", ".join(_UNSEEN_WORDS[s] for s in statuses if s in _UNSEEN_WORDS)


def _frames(count: int) -> str:
    return f"{count} frame{'' if count == 1 else 's'}"
