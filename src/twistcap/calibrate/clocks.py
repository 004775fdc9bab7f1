"""Clocks of cameras that were started by hand, by how the board moves.

A camera that stands still sees the board turn and go. Told in the board's own axes, both are the same for all cameras,
wherever they stand. So each camera gives a signal over time, and the signals of two cameras are equal at the right
offset of their clocks, and at no other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.calibrate.sightings import LONE, Sighting, by_camera
from twistcap.calibrate.start import LensFit, best_places
from twistcap.calibrate.terms import Solid

_RATE = 60.0  # 1/s, at which signals are compared
_SMOOTH = 0.05  # s, standard deviation of the smoothing
FARTHEST = 0.25  # s between two sightings beyond which nothing is known of the motion between them
_FASTEST = 5.0  # m/s; a board that goes or turns faster was seen wrongly
_INDEPENDENT = 6.0  # 1/s, independent numbers in a signal of six: a hand changes its motion about once in a second
_SHARED = 1.0  # s that both cameras must see, at the least
_SURE = 15.0  # nats by which an offset must be better than no likeness
_RIVAL = 0.5  # of the evidence of the best offset, from which on another one casts doubt on it
_APART = 0.15  # s by which another offset differs


@dataclass(frozen=True)
class Motion:
    """Velocity (N, 6) m/s of the board in its own axes, at even times of a camera's clock: of its rim by turning, and
    of its centre. `known` (N,) says when it is known; it is 0 elsewhere.
    """

    values: Float
    known: Bool


@dataclass(frozen=True)
class Offset:
    """By how much the clock of one camera is later than that of another, s, and the evidence for it, nats.

    It is `clear` where no other offset has nearly as much.
    """

    by: float
    evidence: float
    clear: bool


def offsets(motions: Sequence[Motion]) -> tuple[Float, list[int]]:
    """(C,) s by which cameras show later moments than the first, and the cameras whose clocks are not found.

    Pairs of cameras are joined in the order of their evidence. A camera that nothing joins to those before it has 0.
    """
    pairs = {(a, b): offset(motions[a], motions[b]) for a, b in combinations(range(len(motions)), 2)}
    edges = [(found.evidence, *pair, found.by) for pair, found in pairs.items() if found is not None and found.clear]
    by, lost = {0: 0.0}, list[int]()
    while len(by) < len(motions):
        rest = [edge for edge in edges if (edge[1] in by) != (edge[2] in by)]
        if rest:
            _, a, b, later = max(rest)
            by |= {b: by[a] + later} if a in by else {a: by[b] - later}
        else:
            lost.append(min(set(range(len(motions))) - set(by)))
            by[lost[-1]] = 0.0
    return np.array([by[c] for c in range(len(motions))]), lost


def offset(a: Motion, b: Motion) -> Offset | None:
    """By how much b shows later moments than a; None where they never see the board move alike."""
    evidence = _evidence(a, b)
    best = int(np.argmax(evidence))
    if evidence[best] < _SURE:
        return None
    inner = np.r_[False, (evidence[1:-1] >= evidence[:-2]) & (evidence[1:-1] >= evidence[2:]), False]
    apart = np.abs(np.arange(len(evidence)) - best) > _APART * _RATE
    rival = float(evidence[inner & apart].max(initial=0.0))
    by = (best + _peak(evidence, best) - (len(b.values) - 1)) / _RATE
    return Offset(by, float(evidence[best]), rival < _RIVAL * float(evidence[best]))


def _evidence(a: Motion, b: Motion) -> Float:
    """(K,) nats for each offset: both signals being equal but for noise, against their being unlike.

    With the likeness s = 2 Σ a·b / Σ (|a|² + |b|²) of n independent numbers this is −½ n log(1 − s²), as for a
    correlation; nothing is subtracted, since at the right offset also the means are equal.
    """
    from scipy.signal import correlate  # slow to import

    mask_a, mask_b = a.known.astype(float), b.known.astype(float)
    both = correlate(mask_a, mask_b, method="fft").round()
    alike = sum(correlate(x, y, method="fft") for x, y in zip(a.values.T, b.values.T, strict=True))
    power = correlate(np.sum(a.values**2, axis=1), mask_b, method="fft")
    power = power + correlate(mask_a, np.sum(b.values**2, axis=1), method="fft")
    likeness = np.clip(2.0 * np.asarray(alike) / np.maximum(power, 1e-9 * power.max() + 1e-30), 0.0, 0.999)
    numbers = _INDEPENDENT * both / _RATE
    return np.where(both >= _SHARED * _RATE, -0.5 * numbers * np.log1p(-(likeness**2)), 0.0)


def _peak(values: Float, at: int) -> float:
    """Where a parabola through a greatest value and those beside it is highest, from there."""
    if not 0 < at < len(values) - 1:
        return 0.0
    left, middle, right = values[at - 1 : at + 2]
    return float(0.5 * (left - right) / min(left - 2.0 * middle + right, -1e-12))


def motions(
    sightings: Sequence[Sighting], fits: Sequence[LensFit], solid: Solid, times: Sequence[Float]
) -> list[Motion]:
    """How each camera sees the board move; sightings are of frames, `times` (F,) s by camera."""
    every = by_camera([s for s in sightings if s.moment < LONE])
    return [_motion(every.get(c, []), fit, solid, times[c]) for c, fit in enumerate(fits)]


def _motion(own: Sequence[Sighting], fit: LensFit, solid: Solid, times: Float) -> Motion:
    centre = 0.5 * (solid.points.min(axis=0) + solid.points.max(axis=0))
    reach = float(np.linalg.norm(solid.points - centre, axis=1).max())
    count = int(np.ceil((times[-1] + FARTHEST) * _RATE)) + 1
    values, known = np.zeros((count, 6)), np.zeros(count, np.bool_)
    own = sorted(own, key=lambda s: s.moment)
    places = zip(own, best_places(own, solid, fit.lens, fit.numbers), strict=True)
    seen = [(times[s.moment], T @ se3.transform(np.eye(3), centre)) for s, (_, T) in places if T is not None]
    for (before, first), (after, second) in pairwise(seen):
        velocity = np.array([*np.repeat(reach, 3), 1, 1, 1]) * _step(first, second) / (after - before)
        if after - before <= FARTHEST and max(np.linalg.norm(velocity[:3]), np.linalg.norm(velocity[3:])) < _FASTEST:
            span = slice(int(np.ceil(before * _RATE - 1e-6)), int(np.ceil(after * _RATE - 1e-6)))
            values[span], known[span] = velocity, True
    weight = gaussian_filter1d(known.astype(float), _SMOOTH * _RATE, mode="constant")
    smooth = gaussian_filter1d(values, _SMOOTH * _RATE, axis=0, mode="constant") / np.maximum(weight, 1e-9)[:, None]
    return Motion(np.where(known[:, None], smooth, 0.0), known)


def _step(first: Float, second: Float) -> Float:
    """(6,) rad, m: how the board turned, and how its centre went, in its own axes halfway."""
    turn = se3.log_rotation(first[:3, :3].T @ second[:3, :3])
    halfway = first[:3, :3] @ se3.exp_rotation(0.5 * turn)
    return np.concatenate([turn, halfway.T @ (second[:3, 3] - first[:3, 3])])
