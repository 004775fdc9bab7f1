"""Matching of the last poses to the training motion, at any speed.

Rosenhahn, Brox and Seidel, "Scaled Motion Dynamics for Markerless Motion Capture" (DOI 10.1109/CVPR.2007.383128),
eq. 18; method.md 8: ``argmin_{s,j} Σ_{v<m} ‖Θ_{t−v} − Θ̃^s_{j−v}‖``, a sum of norms of joint angles alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float, Float32, Int
from twistcap.errors import check
from twistcap.motion import _search as kernels
from twistcap.motion.clip import interpolated_angles, interpolated_roots
from twistcap.motion.library import PAPER_SCALES, MotionLibrary, unwrapped

_WHERE = "motion matching"
Interval = tuple[int, float, float]
"""A clip, and two positions in it."""


@dataclass(frozen=True)
class Match:
    """A place in the training motion, and the sum of norms there (`distance`, rad).

    Clip −1 is the person's own past. The position is that of the last pose, in poses from the clip's start, usually
    between two poses. Of the motion resampled by `scale` s, one frame of the query is 1/s poses of the clip.
    """

    clip: int
    position: float
    scale: float
    distance: float

    @property
    def step(self) -> float:
        """Poses of the clip per frame of the query."""
        return 1.0 / self.scale

    def after(self, frames: float) -> Match:
        """The place some frames later."""
        return Match(self.clip, self.position + frames * self.step, self.scale, self.distance)


@dataclass(frozen=True)
class PoseSequence:
    """Poses of the library's coordinates, one frame apart: q (n, J) rad, roots (n, 4, 4); and their last match."""

    q: Float
    roots: Float
    match: Match | None = None

    def __len__(self) -> int:
        return len(self.q)

    def then(self, more: PoseSequence) -> PoseSequence:
        """This sequence followed by another; the match is the later one's, its distance the larger of both. A
        prediction matches its own source perfectly, so that the distance of its match has no meaning."""
        match = more.match
        if match is not None and self.match is not None:
            match = replace(match, distance=max(match.distance, self.match.distance))
        return PoseSequence(np.concatenate([self.q, more.q]), np.concatenate([self.roots, more.roots]), match)

    def since(self, start: int) -> PoseSequence:
        """The poses from number `start` on."""
        return PoseSequence(self.q[start:], self.roots[start:], self.match)

    def at(self, position: float) -> tuple[Float, Float]:
        """(J,) and (4, 4) interpolated between two poses."""
        where = np.array([position])
        return interpolated_angles(self.q, where)[0], interpolated_roots(self.roots, where)[0]


class Matcher:
    """Exact search of a library, prepared once.

    By default all coordinates of the library are compared; weights, one per column, count for its squared difference
    and are 1 by default, as in the paper. At the time scale s one frame of the query is 1/s poses of the library; after
    a match a clip must go on for `ahead` frames.

    Raises InputError for weights or scales that are not positive, or a column that does not exist.
    """

    def __init__(
        self, library: MotionLibrary, columns: Sequence[int] | Int | None = None,
        weights: Sequence[float] | Float | None = None, scales: Sequence[float] = PAPER_SCALES, ahead: float = 1.0,
    ) -> None:  # fmt: skip
        self.library, self.ahead = library, ahead
        chosen = range(len(library.names)) if columns is None else columns
        self.columns = np.array([int(c) for c in chosen], dtype=np.int32)
        check(_WHERE, len(self.columns) > 0, "no coordinates are given to compare")
        known = np.all((self.columns >= 0) & (self.columns < len(library.names)))
        check(_WHERE, known, f"a column is none of the library's {len(library.names)} coordinates")
        given = np.ones(len(self.columns)) if weights is None else np.asarray(weights, dtype=float)
        check(_WHERE, given.shape == self.columns.shape, f"{len(self.columns)} coordinates need as many weights")
        check(_WHERE, np.all((given > 0) & (given < np.inf)), "its weights must be positive")
        self.scales = np.array(scales, dtype=float)
        in_range = (self.scales > 0) & (self.scales < np.inf)
        check(_WHERE, len(in_range) > 0 and np.all(in_range), "bad time scales")
        self._factors, self.steps = np.sqrt(given), 1.0 / self.scales
        self.base = _transposed(library.q, self.columns, self._factors)
        self.jumps = _jumps(self.base, library.starts)

    def best(self, query: Float, last: Match | None = None, excluded: Sequence[Interval] = ()) -> Match | None:
        """The best match of the last m poses; None where no clip is long enough.

        Args:
            query: (m, K) compared coordinates, rad, the latest last, one frame apart.
            last: match of the previous frame; of equal matches the one that continues it is taken.
            excluded: intervals in which no match may end.

        Raises InputError for a query that is not (m, K), or not finite.
        """
        poses = self._ready(query)
        near = None if last is None or excluded else self._near(poses, last.after(1.0))
        if near is None:
            return self._best(poses, excluded)
        return self._best(poses, limit=near.distance * (1.0 - 1e-9) - 1e-9) or near

    def k_best(self, query: Float, count: int, apart: float, excluded: Sequence[Interval] = ()) -> list[Match]:
        """The `count` best matches, each more than `apart` poses of the library from those before it in its clip.
        Query, excluded intervals and errors are as of `best`."""
        poses, taken = self._ready(query), list[Match]()
        while len(taken) < count:
            around = [(match.clip, match.position - apart, match.position + apart) for match in taken]
            match = self._best(poses, [*excluded, *around])
            if match is None:
                break
            taken.append(match)
        return taken

    def _ready(self, query: Float) -> Float:
        """The query unwrapped, weighted and padded as the library is, the latest pose first."""
        query, K = np.ascontiguousarray(query, dtype=float), len(self.columns)
        fits = query.ndim == 2 and len(query) > 0 and query.shape[1] == K
        check(_WHERE, fits, f"a query must be (m, {K}), K coordinates")
        check(_WHERE, np.isfinite(query).all(), "a pose of the query is not finite")
        poses = np.zeros((len(query), len(self.base)))
        poses[:, :K] = unwrapped(query)[::-1] * self._factors
        return poses

    def _best(self, poses: Float, excluded: Sequence[Interval] = (), limit: float = 1e300) -> Match | None:
        """The best match below a limit that does not end in an excluded interval."""
        clips = (self.base, self.jumps, self.library.starts)
        windows = np.array([[low, high] for _, low, high in excluded]).reshape(-1, 2)
        within = np.array([clip for clip, _, _ in excluded], np.int32), windows
        distance, clip, scale, pose = kernels.search(clips, poses, self.steps, self.ahead, within, limit)
        return None if scale < 0 else self._match(clip, scale, pose, distance)

    def _near(self, poses: Float, place: Match) -> Match | None:
        """The best match within half a step of a place."""
        start, end = map(int, self.library.starts[place.clip : place.clip + 2])
        low, high = place.position - 0.5 * place.step - kernels.NEAR, place.position + 0.5 * place.step + kernels.NEAR
        best, limit = None, np.inf
        for scale, step in enumerate(self.steps):
            last = min(high, end - start - 1 + kernels.NEAR - self.ahead * step)
            for j in range(max(int(np.ceil(low / step)), len(poses) - 1), int(np.floor(last / step)) + 1):
                value = kernels.score(self.base, poses, start, j, step, limit)
                if value < limit:
                    best, limit = self._match(place.clip, scale, j, value), value
        return best

    def _match(self, clip: int, scale: int, pose: int, distance: float) -> Match:
        return Match(int(clip), float(pose * self.steps[scale]), float(self.scales[scale]), float(distance))


def _transposed(q: Float32, columns: Int, factors: Float) -> Float32:
    """(K, N) the compared coordinates, weighted; K is padded with zeros to a multiple of four."""
    out = np.zeros((-(-len(columns) // 4) * 4, len(q)), np.float32)
    out[: len(columns)] = (q[:, columns] * factors.astype(np.float32)).T
    return out


def _jumps(base: Float32, starts: Int) -> Float32:
    """(N,) distance of each pose from the next one, rounded up; 0 at seams."""
    squares = np.zeros(base.shape[1])
    for row in base:
        squares[:-1] += np.diff(row.astype(float)) ** 2
    squares[starts[1:] - 1] = 0.0
    return (np.sqrt(squares) * (1.0 + 1e-6)).astype(np.float32)
