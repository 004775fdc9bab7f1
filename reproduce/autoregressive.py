"""Prediction by a vector autoregression, a baseline: the next step is linear in the last poses.

Joint angles and the root's twists of the last p frames predict the next increments, by ridge regression over all poses
of all clips (Lütkepohl, "New Introduction to Multiple Time Series Analysis", 2005, chapter 3;
DOI 10.1007/978-3-540-27752-1). The linear algebra is scipy's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.errors import InputError
from twistcap.motion import MotionLibrary
from twistcap.motion.matching import Interval
from twistcap.motion.openloop import OpenLoop, PoseSequence
from twistcap.motion.paper import standard_step
from twistcap.motion.predictor import TrainedMotion
from twistcap.track import Model

_BEYOND = 0.2  # rad by which a joint may leave its range in the library
_TWIST = 10.0  # weight of a twist per frame (rad, m) against a joint angle (rad)


class AutoregressiveMotion(OpenLoop):
    """Predicts step by step from the last poses, linearly.

    Args:
        library: training motion, at the frame rate of the recording.
        body: that is tracked.
        order: p, number of poses.
        stride: frames between them.
        ridge: weight of the penalty on a coefficient, as a fraction of the mean square of its feature.

    Raises:
        InputError: as `OpenLoop`, for an order or a stride below 1, a ridge that is not positive, or clips that are all
            too short to learn from.
    """

    def __init__(
        self, library: MotionLibrary, body: Body, order: int = 4, stride: int = 3, ridge: float = 1e-3
    ) -> None:
        super().__init__(library, body)
        if order < 1 or stride < 1 or not 0 < ridge < np.inf:
            raise InputError("autoregressive motion: take an order and a stride of 1 or more, and a positive ridge.")
        self.order, self.stride, self.ridge = order, stride, ridge
        self.history = (order - 1) * stride + 2  # the first pose needs the step before it
        clips = [library.clip(k) for k in range(len(library.clip_names))]
        rows = [self._rows(clip.q, clip.roots) for clip in clips if len(clip) > self.history]
        if not rows:
            raise InputError(
                f"autoregressive motion: every clip is shorter than {self.history + 1} poses; give longer ones."
            )
        self._x, self._y = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        lengths = [(k, len(clip)) for k, clip in enumerate(clips) if len(clip) > self.history]
        self._clip = np.concatenate([np.full(n - self.history, k) for k, n in lengths])
        self._position = np.concatenate([np.arange(self.history - 1, n - 1) for _, n in lengths])
        self._gram, self._cross = self._x.T @ self._x, self._x.T @ self._y
        used = library.q[:, self.compared]
        self._range = used.min(axis=0) - _BEYOND, used.max(axis=0) + _BEYOND
        self._coefficients = self._solved(np.zeros(len(self._x), dtype=np.bool_))
        self._without: tuple[tuple[Interval, ...], Float] = ((), self._coefficients)

    def next_poses(self, past: PoseSequence, count: int, excluded: Sequence[Interval] = ()) -> PoseSequence:
        """The next pose; see `OpenLoop.next_poses`. Excluded stretches are left out of what is learnt from."""
        if len(past) < self.history:
            return standard_step(past.since(max(0, len(past) - 5)))
        past = past.since(len(past) - self.history)
        x = self._features(past.q[:, self.compared], _twists(past.roots), past.roots[:, 2, :3])[-1]
        step = x @ self._fitted(tuple(excluded))
        q = past.q[-1].copy()
        K = len(self.compared)
        # Where the person already is beyond the range, one step does not jump back into it.
        low, high = (
            edge(side, q[self.compared]) for edge, side in zip((np.minimum, np.maximum), self._range, strict=True)
        )
        q[self.compared] = np.clip(q[self.compared] + step[:K], low, high)
        root = past.roots[-1] @ se3.exp(step[K:] / _TWIST)
        return PoseSequence(q[None], root[None])

    def _rows(self, q: Float, roots: Float) -> tuple[Float, Float]:
        """Features (n, F) and what followed (n, K + 6) at the poses history − 1 … N − 2 of a clip."""
        known, twists = q[:, self.compared], _twists(roots)
        x = self._features(known, twists, roots[:, 2, :3])[:-1]
        return x, np.column_stack([np.diff(known, axis=0), twists[1:]])[self.history - 1 :]

    def _features(self, q: Float, twists: Float, up: Float) -> Float:
        """(n, F) from angles (N, K), twists (N, 6) and the vertical in the root's frame (N, 3): 1, it, and the lags."""
        last = np.arange(self.history - 1, len(q))
        lags = [np.column_stack([q[last - v], twists[last - v]]) for v in self.stride * np.arange(self.order)]
        return np.column_stack([np.ones(len(last)), up[last], *lags])

    def _fitted(self, excluded: tuple[Interval, ...]) -> Float:
        """(F, K + 6) coefficients without what is excluded; the last ones are kept."""
        if not excluded:
            return self._coefficients
        if self._without[0] != excluded:
            out = np.zeros(len(self._x), dtype=np.bool_)
            for clip, low, high in excluded:
                out |= (self._clip == clip) & (self._position > low) & (self._position < high)
            self._without = excluded, self._solved(out)
        return self._without[1]

    def _solved(self, out: np.ndarray) -> Float:
        """Coefficients of the rows that are not `out` (n,): ``(XᵀX + λ diag) B = XᵀY``."""
        gram = self._gram - self._x[out].T @ self._x[out]
        cross = self._cross - self._x[out].T @ self._y[out]
        diagonal = np.diag(gram)
        weight = self.ridge * np.maximum(diagonal, 1e-3 * diagonal.max())
        return np.asarray(scipy.linalg.solve(gram + np.diag(weight), cross, assume_a="pos"))


def with_autoregression(model: Model, library: MotionLibrary) -> Model:
    """The model with this predictor in place of its own from training motion."""
    linear = TrainedMotion(AutoregressiveMotion(library, model.body))
    return replace(model, predictors=tuple(linear if isinstance(p, TrainedMotion) else p for p in model.predictors))


def _twists(roots: Float) -> Float:
    """(N, 6) the step that led to each root (N, 4, 4), in its own frame, times `_TWIST`; the first is repeated."""
    steps = se3.log(se3.inverse(roots[:-1]) @ roots[1:])
    return _TWIST * np.concatenate([steps[:1], steps])
