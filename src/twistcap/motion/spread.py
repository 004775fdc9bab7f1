"""Standard deviations of a motion from its prediction, learned from the training motion itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.motion.library import MotionLibrary
from twistcap.motion.matching import PoseSequence

if TYPE_CHECKING:
    from twistcap.motion.openloop import OpenLoop

_HORIZONS = np.array([1, 2, 4, 8, 16, 32, 48])
_TRIALS = 48
_AWAY = 0.35  # s around a trial that may not be matched: about a step
_FEWEST = 8  # trials needed
_LEAST = (np.radians(0.3), 0.002, np.radians(0.3))  # rad, m, rad: least standard deviations
_GUESS = (1.0, 0.5, 1.5)  # rad/s, m/s, rad/s: for libraries that are too small to learn from
_UNKNOWN = (2.0, 0.5)  # rad/s, and rad at most, of a coordinate that the library lacks
_WORST = 4.0  # greatest factor by which a bad match widens the spread


@dataclass(frozen=True)
class Spread:
    """Standard deviations of a prediction by the number of open-loop frames (H,), `rate` per second.

    `deviations` (H, 2 + J) are those of the root's rotation (rad) and place (m), about the root, along each axis, and
    of the joints (rad). Worse matches than of the dissimilarity `usual`, rad per pose, widen the spread; 0 for none do.
    """

    frames: Float
    deviations: Float
    usual: float
    rate: float

    def variances(self, frames: float, dissimilarity: float = 0.0) -> tuple[float, float, Float]:
        """Variances of turn (rad²), shift (m²) and joints (J,) rad² after some frames."""
        wider = 1.0 if self.usual <= 0 else float(np.clip(dissimilarity / self.usual, 1.0, _WORST))
        wider *= max(1.0, frames / self.frames[-1])
        at = [np.interp(frames, self.frames, s) for s in self.deviations.T]
        squares = (np.array(at) * wider) ** 2
        return float(squares[0]), float(squares[1]), squares[2:]

    def unknown(self, frames: float) -> float:
        """Variance (rad²) of a coordinate that the library lacks, after some frames."""
        return min(_UNKNOWN[1], _LEAST[2] + _UNKNOWN[0] * frames / self.rate) ** 2


def learned_spread(predictor: OpenLoop) -> Spread:
    """The spread of a predictor on the library's own clips, by cross-validation.

    Intervals are predicted from the poses before them, with the library around them excluded. For a library that is too
    small the spread is a guess.
    """
    library, history, longest = predictor.library, predictor.history, int(_HORIZONS[-1])
    errors, dissimilarity = list[Float](), list[float]()
    for clip, end in _places(library, history, longest):
        motion = library.clip(clip)
        past = slice(max(0, end - history + 1), end + 1)
        excluded = [(clip, end - _AWAY * library.rate, end + _AWAY * library.rate)]
        found = predictor.roll(PoseSequence(motion.q[past], motion.roots[past]), longest, excluded)
        distance = predictor.dissimilarity(found.match)
        if not np.isnan(distance):
            truth = slice(end + 1, end + 1 + longest)
            errors.append(_errors(found.q, found.roots, motion.q[truth], motion.roots[truth])[_HORIZONS - 1])
            dissimilarity.append(distance)
    frames, least = _HORIZONS.astype(float), _of_all(_LEAST, library)
    if len(errors) < _FEWEST:
        growth = frames[:, None] / library.rate * _of_all(_GUESS, library) + least
        return Spread(frames, growth, 0.0, library.rate)
    deviations = np.sqrt(np.mean(np.square(errors), axis=0))
    growing = np.maximum.accumulate(np.maximum(deviations, least), axis=0)
    return Spread(frames, growing, float(np.median(dissimilarity)), library.rate)


def _places(library: MotionLibrary, history: int, longest: int) -> list[tuple[int, int]]:
    """Clips and poses in them, evenly spread, at which a trial may begin."""
    begin = min(history, longest) // 2
    room = [max(0, int(n) - longest - begin) for n in library.lengths]
    total = sum(room)
    wanted = np.unique(np.linspace(0, total - 1, min(total, _TRIALS)).astype(int)) if total else []
    ends = np.cumsum(room)
    clips = np.searchsorted(ends, wanted, side="right")
    return [(int(c), begin + int(w - (ends[c] - room[c]))) for c, w in zip(clips, wanted, strict=True)]


def _errors(q: Float, roots: Float, true_q: Float, true_roots: Float) -> Float:
    """(n, 2 + J) root mean square over the axes of turn (rad) and shift (m), and the coordinates' errors (rad)."""
    turn = se3.log_rotation(roots[:, :3, :3] @ np.swapaxes(true_roots[:, :3, :3], 1, 2))
    shift = roots[:, :3, 3] - true_roots[:, :3, 3]
    rms = [np.sqrt(np.mean(v**2, axis=1)) for v in (turn, shift)]
    return np.column_stack([*rms, q - true_q])


def _of_all(each: tuple[float, float, float], library: MotionLibrary) -> Float:
    """(2 + J,) of turn, shift and all joints."""
    return np.array([*each[:2], *[each[2]] * len(library.names)])
