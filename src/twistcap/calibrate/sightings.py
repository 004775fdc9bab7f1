"""Sightings of a board in many images, and the choice of those that an adjustment needs: sharp and well spread."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Bool, Float, Int
from twistcap.calibrate.board import Board
from twistcap.calibrate.detect import Detector
from twistcap.io.video import Source

_CELLS = (6, 4)  # of an image, by which coverage is counted
SCENE = -1
LONE = 10_000_000  # moments from here on are of pictures of one camera alone
_FEWEST = 6  # points of a board by which its place is found
_GAP = 1.6  # usual intervals; frames that are farther apart show nothing of the motion between them
_BLURRED = 1.5  # times the usual edge width, beyond which a sighting is left out where there are others


@dataclass(frozen=True)
class Sighting:
    """One camera's view of the board at one moment: ids (N,) and pixels (N, 2) of its points, width of its edges, px.

    Cameras that show the same `moment` show the same pose of the board. `solid` "scene" is for points of the scene,
    which do not move: its moment is `SCENE`. `motion` (2, N, 2) is how the points move in the image, by the frames
    before and after: velocity and half the acceleration, px per frame and its square; None where it is not known.
    `rough` is how many times less exact its points are than is usual for the camera.
    """

    camera: int
    moment: int
    ids: Int
    pixels: Float
    blur: float = 0.0
    solid: str = "board"
    motion: Float | None = None
    rough: float = 1.0

    def only(self, some: Bool) -> Sighting:
        """With some of its points (N,)."""
        motion = None if self.motion is None else self.motion[:, some]
        return replace(self, ids=self.ids[some], pixels=self.pixels[some], motion=motion)


def look(
    sources: Sequence[Source], board: Board, frames: Sequence[int], progress: Callable[[str], None] = lambda note: None
) -> list[Sighting]:
    """Sightings in these frames of each camera's source; the moment is the frame number."""
    find, out = Detector(board), list[Sighting]()
    for c, source in enumerate(sources):
        own = [k for k in frames if k < len(source)]
        for k, image in zip(own, source.read(own), strict=True):
            found = None if image is None else find(image)
            if found is not None:
                out.append(Sighting(c, k, found.ids, found.pixels, found.blur))
            progress(source.name)
    return out


@dataclass(frozen=True)
class Looker:
    """Looks for the board in frames of each camera, in none twice. `times` (F,) s are those of each camera's frames."""

    sources: Sequence[Source]
    board: Board
    times: Sequence[Float]
    progress: Callable[[str], None] = lambda note: None
    known: dict[tuple[int, int], Sighting | None] = field(default_factory=dict[tuple[int, int], Sighting | None])

    def at(self, camera: int, frames: Sequence[int]) -> list[Sighting]:
        """Sightings in these frames, with the motion of their points where the frames beside are known."""
        count = len(self.sources[camera])
        new = sorted({f for f in frames if 0 <= f < count and (camera, f) not in self.known})
        seen = look([self.sources[camera]], self.board, new, self.progress)
        self.known.update(dict.fromkeys(((camera, f) for f in new), None))
        self.known.update({(camera, s.moment): replace(s, camera=camera) for s in seen})
        there = {d + f for f in frames for d in (-1, 0, 1)}
        own = [s for f in sorted(there) if (s := self.known.get((camera, f))) is not None]
        return [s for s in moving(own, self.times) if s.moment in set(frames)]

    def __call__(self, camera: int, frames: Sequence[int]) -> list[Sighting]:
        """Sightings in these frames of which the motion is known: those beside are looked at too."""
        self.at(camera, [f + d for f in frames for d in (-1, 0, 1)])
        return [s for s in self.at(camera, frames) if s.motion is not None]


def moving(sightings: Sequence[Sighting], times: Sequence[Float] | None = None) -> list[Sighting]:
    """The same sightings with the motion of their points, where those of the frames before and after are known.

    `times` (F,) s are those of each camera's frames; None where they are even.
    """
    there = {(s.camera, s.moment): dict(zip(s.ids.tolist(), s.pixels, strict=True)) for s in sightings}
    out = list[Sighting]()
    for s in sightings:
        before, after = (there.get((s.camera, s.moment + d), {}) for d in (-1, 1))
        gaps = (1.0, 1.0) if times is None or not before or not after else _gaps(times[s.camera], s.moment)
        out.append(_moving(s, before, after, gaps))
    return out


def _gaps(times: Float, frame: int) -> tuple[float, float]:
    """From the frame before to this one, and on to the next, in usual intervals."""
    usual = float(np.median(np.diff(times)))
    return float(times[frame] - times[frame - 1]) / usual, float(times[frame + 1] - times[frame]) / usual


def _moving(
    s: Sighting, before: Mapping[int, Float], after: Mapping[int, Float], gaps: tuple[float, float]
) -> Sighting:
    """One sighting with its motion, by the parabola through three frames; without points that one of them lacks."""
    known = np.array([k in before and k in after for k in s.ids.tolist()], np.bool_)
    if known.sum() < min(_FEWEST, len(s.ids)) or max(gaps) > _GAP:
        return s
    ids, pixels = s.ids[known], s.pixels[known]
    back, on = (np.array([side[k] for k in ids.tolist()]) - pixels for side in (before, after))
    h, k = gaps
    motion = np.stack([h * h * on - k * k * back, h * on + k * back]) / (h * k * (h + k))
    return replace(s, ids=ids, pixels=pixels, motion=motion)


def sharp(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Those whose edges are not much wider than is usual for their camera."""
    usual = {c: float(np.median([s.blur for s in own])) for c, own in by_camera(sightings).items()}
    return [s for s in sightings if s.blur <= _BLURRED * usual[s.camera]]


def chosen(sightings: Sequence[Sighting], sizes: Mapping[int, tuple[int, int]], most: int) -> list[Sighting]:
    """The sightings of at most so many moments, taken one by one for what they add.

    A moment is worth the cells of the images in which it shows points that few moments before it have shown, and the
    pairs of cameras that it joins. `sizes` (w, h) px are by camera.
    """
    moments = by_moment(sightings)
    parts = {m: _parts(own, sizes) for m, own in moments.items()}
    blur = {m: float(np.mean([s.blur for s in own])) for m, own in moments.items()}
    have: dict[tuple[int, ...], int] = defaultdict(int)
    taken, rest = list[int](), set(moments)
    while rest and len(taken) < most:
        worth = {m: sum(n / (1 + have[key]) ** 2 for key, n in parts[m].items()) / (1.0 + blur[m]) for m in rest}
        best = max(sorted(rest), key=worth.__getitem__)
        for key in parts[best]:
            have[key] += 1
        taken.append(best)
        rest.remove(best)
    return [s for s in sightings if s.moment in set(taken)]


def by_camera(sightings: Sequence[Sighting]) -> dict[int, list[Sighting]]:
    """Sightings by camera."""
    return _grouped(sightings, lambda s: s.camera)


def by_moment(sightings: Sequence[Sighting]) -> dict[int, list[Sighting]]:
    """Sightings by moment, in order of time."""
    return dict(sorted(_grouped(sightings, lambda s: s.moment).items()))


def coverage(sightings: Sequence[Sighting], size: tuple[int, int]) -> Int:
    """(rows, columns) points in each cell of the image of one camera."""
    out = np.zeros(_CELLS[::-1], np.int32)
    for s in sightings:
        column, row = _cells(s.pixels, size)
        np.add.at(out, (row, column), 1)
    return out


def _grouped(sightings: Sequence[Sighting], key: Callable[[Sighting], int]) -> dict[int, list[Sighting]]:
    out: dict[int, list[Sighting]] = {}
    for s in sightings:
        out.setdefault(key(s), []).append(s)
    return out


def _parts(own: Sequence[Sighting], sizes: Mapping[int, tuple[int, int]]) -> Mapping[tuple[int, ...], float]:
    """What a moment shows, and how much each part is worth: cells of images, pairs of cameras."""
    out: dict[tuple[int, ...], float] = {}
    for s in own:
        column, row = _cells(s.pixels, sizes[s.camera])
        for cell in set(zip(column.tolist(), row.tolist(), strict=True)):
            out[(s.camera, *cell)] = 1.0
    cameras = sorted(s.camera for s in own)
    return out | {(a, b): 4.0 for k, a in enumerate(cameras) for b in cameras[k + 1 :]}


def _cells(pixels: Float, size: tuple[int, int]) -> tuple[Int, Int]:
    cell = np.clip(pixels / np.array(size) * _CELLS, 0, np.array(_CELLS) - 1).astype(np.int32)
    return cell[:, 0], cell[:, 1]
