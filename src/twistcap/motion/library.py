"""Training motion: separate clips at one rate.

Rosenhahn, Brox and Seidel, "Scaled Motion Dynamics for Markerless Motion Capture" (DOI 10.1109/CVPR.2007.383128),
section 3; method.md 8.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twistcap.arrays import Float, Float32, Int
from twistcap.errors import check
from twistcap.motion.clip import MotionClip, interpolated_angles, interpolated_roots

_WHERE = "motion library"
PAPER_SCALES: tuple[float, ...] = tuple(round(0.5 + 0.1 * k, 1) for k in range(16))


@dataclass(frozen=True)
class MotionLibrary:
    """Clips of training motion, all of the same joint coordinates and rate.

    The paper's resampled copies ``P^s`` are not stored: pose j of ``P^s`` is at position j/s of its clip, interpolated.

    The rate (poses per second) is that of the tracked recording. Joint coordinates q (N, J), rad, and roots (N, 4, 4),
    T_world_root, are those of all clips, one after the other; `starts` (C + 1,) their starts, and the last one's end.

    Raises InputError for wrong shapes, or values that are not finite.
    """

    names: tuple[str, ...]
    rate: float
    clip_names: tuple[str, ...]
    starts: Int
    q: Float32
    roots: Float

    def __post_init__(self) -> None:
        N, J, C = len(self.q), len(self.names), len(self.clip_names)
        check(_WHERE, J > 0 and self.q.shape == (N, J), f"its q must be (N, {J}), one column for each coordinate name")
        check(_WHERE, self.roots.shape == (N, 4, 4), f"its roots must be ({N}, 4, 4), one for each pose")
        seams_fit = self.starts.shape == (C + 1,) and self.starts[0] == 0 and self.starts[-1] == N
        check(_WHERE, C > 0 and seams_fit and bool(np.all(np.diff(self.starts) > 0)), "its clips do not fill its poses")
        check(_WHERE, np.isfinite(self.q).all() and np.isfinite(self.roots).all(), "a pose is not finite")
        check(_WHERE, 0 < self.rate < np.inf, f"its rate is {self.rate}; it must be positive, in poses per second")

    @staticmethod
    def of(
        clips: Iterable[MotionClip], rate: float, names: Sequence[str] | None = None, mirrored: bool = False
    ) -> MotionLibrary:
        """A library of clips, resampled to the rate of the tracked recording, frames per second.

        The coordinates of `names` are kept, by default those of the first clip that all clips have; `mirrored` adds
        each clip's mirror image. Raises InputError where there is no clip, or a clip lacks a coordinate.
        """
        given = list(clips)
        check(_WHERE, bool(given), "it has no clips; give one or more")
        if names is None:
            names = tuple(n for n in given[0].names if all(n in clip.names for clip in given))
        check(_WHERE, len(names) > 0, "its clips have no joint coordinate in common")
        kept = [_at_rate(clip, names, rate) for clip in given]
        kept = [way for clip in kept for way in ((clip, clip.mirrored()) if mirrored else (clip,))]
        starts = np.cumsum([0, *(len(clip) for clip in kept)]).astype(np.int32)
        q = np.concatenate([clip.q for clip in kept], dtype=np.float32)
        roots = np.concatenate([clip.roots for clip in kept])
        return MotionLibrary(tuple(names), float(rate), tuple(clip.name for clip in kept), starts, q, roots)

    def resampled(self, rate: float) -> MotionLibrary:
        """The same motion at another rate, poses per second; see `MotionClip.resampled`, also for errors."""
        clips = (self.clip(k) for k in range(len(self.clip_names)))
        return self if rate == self.rate else MotionLibrary.of(clips, rate, self.names)

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.q)

    @cached_property
    def lengths(self) -> Int:
        """(C,) poses of each clip."""
        return np.diff(self.starts)

    def clip(self, index: int) -> MotionClip:
        """One of the clips."""
        part = slice(self.starts[index], self.starts[index + 1])
        return MotionClip(self.clip_names[index], self.names, self.rate, self.roots[part], self.q[part].astype(float))

    def angles(self, clip: int, positions: Float) -> Float:
        """(P, J) joint coordinates at positions (P,), in poses from the clip's start, clipped to it."""
        part = self.q[self.starts[clip] : self.starts[clip + 1]]
        return interpolated_angles(part, np.clip(positions, 0, len(part) - 1))

    def root_motions(self, clip: int, positions: Float) -> Float:
        """(P, 4, 4) roots at positions (P,), in poses from the clip's start, clipped to it."""
        part = self.roots[self.starts[clip] : self.starts[clip + 1]]
        return interpolated_roots(part, np.clip(positions, 0, len(part) - 1))

    def columns(self, names: Sequence[str]) -> Int:
        """(K,) indices of some coordinates in `names`; an InputError where the library lacks one."""
        for name in names:
            check(_WHERE, name in self.names, f"it has no coordinate {name!r}; it has {', '.join(self.names)}")
        return np.array([self.names.index(name) for name in names], dtype=np.int32)


def unwrapped(q: Float) -> Float:
    """Angles (N, J) without jumps by 2π, their mean within ±π, so that they compare modulo 2π."""
    smooth = np.unwrap(q, axis=0)
    return smooth - 2.0 * np.pi * np.round(smooth.mean(axis=0) / (2.0 * np.pi))


def _at_rate(clip: MotionClip, names: Sequence[str], rate: float) -> MotionClip:
    missing = [name for name in names if name not in clip.names]
    check(_WHERE, not missing, f"its clip {clip.name!r} lacks the coordinate {missing[0] if missing else ''!r}")
    q = unwrapped(clip.q[:, [clip.names.index(name) for name in names]])
    return MotionClip(clip.name, tuple(names), clip.rate, clip.roots, q).resampled(rate)
