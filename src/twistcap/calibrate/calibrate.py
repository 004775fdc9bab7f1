"""From recordings of a board to a rig: look, choose, fit the lenses, chain, adjust, place in the world."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.calibrate.adjust import Adjustment, Setup, adjust
from twistcap.calibrate.board import Board
from twistcap.calibrate.detect import Detector, is_mirrored, variants
from twistcap.calibrate.lens import Kind
from twistcap.calibrate.sightings import Sighting, by_camera, by_moment, chosen, look, moving, sharp
from twistcap.calibrate.start import LensFit, chained, fitted_lens
from twistcap.calibrate.terms import flat
from twistcap.calibrate.world import lying, moved, upright
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.io.video import Source

LONE = 10_000_000  # moments from here on are of pictures of one camera alone
_SAMPLES = 24  # images of each camera by which the variant of the board is found
_SHIFTED = 0.5  # frames; a clock that is later is paired with other frames
_PAIRINGS = 4


@dataclass(frozen=True)
class Options:
    """How to calibrate.

    Attributes:
        kinds: of lenses to try; of two, the evidence decides.
        looks: frames of each camera in which the board is looked for.
        moments: at most so many are adjusted that several cameras share, and so many of each camera alone.
        floor: frame in which the board lies on the floor; None where it never does.
        clocks: whether the cameras' clocks are estimated.
    """

    kinds: tuple[Kind, ...] = ("brown", "fisheye")
    looks: int = 400
    moments: tuple[int, int] = (240, 50)
    floor: int | None = None
    clocks: bool = True


@dataclass(frozen=True)
class Calibration:
    """Cameras by a board.

    Attributes:
        rig: the cameras.
        adjustment: what they rest on, with covariances; in the same world.
        board: as it was found to be.
        shifts: whole frames by which each camera shows a later moment; sightings are paired so.
        floor_known: whether a board on the floor says where the world is; else up is a guess by the images.
    """

    rig: Rig
    adjustment: Adjustment
    board: Board
    shifts: tuple[int, ...]
    floor_known: bool

    @property
    def late(self) -> tuple[Float, Float]:
        """(C,) frames by which each camera shows a later moment than the first, and their standard deviations."""
        late, sigmas = np.array(self.shifts) + np.array(self.adjustment.guess.late), self.adjustment.clocks
        return late - late[0], np.where(np.arange(len(late)) > 0, np.hypot(sigmas, sigmas[0]), 0.0)


Report = Callable[[str], None]
More = Callable[[int, Sequence[int]], Sequence[Sighting]]
"""Sightings of a camera in further frames, with the motion of their points."""


def calibrated(
    sources: Mapping[str, Source], board: Board, options: Options | None = None,
    lone: Mapping[str, Source] | None = None, report: Report = lambda note: None,
) -> Calibration:  # fmt: skip
    """Calibrate cameras by recordings of one board.

    Args:
        sources: of each camera, in step: frame k of all shows the same moment, to about a frame.
        lone: pictures of the board by one camera alone, for its lens, by camera.
        report: called with what is being done.

    Raises InputError: for a board that is not found, mirrored, or seen too little; cameras that nothing joins.
    """
    options, lone, names = options or Options(), lone or {}, tuple(sources)
    board = found_variant([*sources.values(), *lone.values()], board)
    own = list(sources.values())
    shared = seen(own, board, options, report)
    alone = alone_seen(lone, names, board, options, report)
    sizes = {c: source.size for c, source in enumerate(sources.values())}

    def more(camera: int, frames: Sequence[int]) -> list[Sighting]:
        wanted = sorted({f + d for f in frames for d in (-1, 0, 1) if f + d >= 0})
        found = moving(look([own[camera]], board, wanted, report))
        return [replace(s, camera=camera) for s in found if s.motion is not None]

    return of_sightings([*shared, *alone], board, names, sizes, options, report, more)


def of_sightings(
    sightings: Sequence[Sighting], board: Board, names: Sequence[str], sizes: Mapping[int, tuple[int, int]],
    options: Options, report: Report = lambda note: None, more: More | None = None,
) -> Calibration:  # fmt: skip
    """Calibrate by what was seen; `sizes` (w, h) px by camera.

    Where a clock is late by more than half a frame, its frames are paired with others, and all is adjusted again;
    `more` looks where they have not been looked at.
    """
    solid, fits = flat(board.points), list[LensFit]()
    of_each = by_camera(sightings)
    for c, name in enumerate(names):
        report(f"lens of {name}")
        fits.append(fitted_lens(sharp(of_each.get(c, [])), solid, sizes[c], name, options.kinds))
    if len(names) > 1 and not board.one_way:
        raise InputError("a chessboard of this size looks the same upside down; use one of an even and an odd side.")
    shifts, every = (0,) * len(names), {(s.camera, s.moment): s for s in sightings}

    def fitted() -> tuple[Setup, Adjustment]:
        report("chaining the cameras")
        used = _used(_paired(every.values(), shifts), sizes, options)
        guess = chained(used, fits, solid, names)
        first = next(c for c, place in enumerate(guess.places) if np.array_equal(place, np.eye(4)))
        used = tuple(s for s in used if s.moment in guess.boards)
        setup = Setup(guess, used, {"board": solid}, first, clocks=options.clocks)
        return setup, _of_all(adjust(setup, report), names)

    setup, adjustment = fitted()
    for _ in range(_PAIRINGS):
        whole = [round(late) if abs(late) > _SHIFTED else 0 for late in adjustment.guess.late]
        if not any(whole):
            break
        report("pairing frames by the clocks")
        shifts = tuple(n + by for n, by in zip(shifts, whole, strict=True))
        every |= _looked_again(every, shifts, more)
        setup, adjustment = fitted()
    adjustment, known = _in_world(adjustment, setup, board, options.floor, report)
    rig = Rig(adjustment.cameras(names))
    return Calibration(rig, adjustment, board, shifts, known)


def found_variant(sources: Sequence[Source], board: Board) -> Board:
    """The board, or the variant of it that images show. Raises InputError where they show none, or a mirrored one."""
    images = [i for source in sources for i in source.read(_spread(source, _SAMPLES)) if i is not None]
    counts = dict[Board, int]()
    for variant in variants(board):
        find = Detector(variant)
        counts[variant] = sum(find(image) is not None for image in images)
        if counts[variant] > 0.2 * len(images):
            break
    best = max(counts, key=counts.__getitem__)
    if counts[best] == 0 and is_mirrored(board, images):
        raise InputError("the board is seen mirrored; the videos are flipped (as a selfie is), or its print is.")
    if counts[best] == 0:
        raise InputError(f"no picture shows the board, a {board.words}; check --board, or film it nearer and slower.")
    return best


def seen(sources: Sequence[Source], board: Board, options: Options, report: Report) -> list[Sighting]:
    """Sightings of all cameras in frames that are spread over the recording, with the motion of their points."""
    length = max(len(source) for source in sources)
    step = max(1, -(-length // options.looks))
    frames = list(range(0, length, step))
    first = look(sources, board, frames, report)
    if options.floor is not None and options.floor not in frames:
        first += look(sources, board, [options.floor], report)
    if step > 1:
        sizes = {c: source.size for c, source in enumerate(sources)}
        wanted = {s.moment for s in chosen(_of_several(sharp(first)), sizes, options.moments[0])}
        beside = sorted({m + d for m in wanted for d in (-1, 1)} & set(range(length)) - {s.moment for s in first})
        first += look(sources, board, beside, report)
    return moving(first)


def alone_seen(
    lone: Mapping[str, Source], names: Sequence[str], board: Board, options: Options, report: Report
) -> list[Sighting]:
    """Sightings of pictures that one camera took alone, each a moment of its own."""
    return [
        replace(s, camera=names.index(name), moment=LONE * (1 + names.index(name)) + s.moment)
        for name, source in lone.items()
        for s in look([source], board, _spread(source, options.looks), report)
    ]


def _spread(source: Source, most: int) -> list[int]:
    count = len(source)
    return sorted({round(k) for k in np.linspace(0, count - 1, min(most, count))})


def _of_several(sightings: Sequence[Sighting]) -> list[Sighting]:
    return [s for own in by_moment(sightings).values() if len(own) > 1 for s in own]


def _used(sightings: Sequence[Sighting], sizes: Mapping[int, tuple[int, int]], options: Options) -> list[Sighting]:
    """Moments that several cameras share, those of one camera alone for its lens, and the floor.

    With clocks, cameras share moments of which the motion is known, unless these join fewer cameras.
    """
    good, (together, alone) = sharp(sightings), options.moments
    several = _of_several(good)
    moved = _of_several([s for s in several if s.motion is not None])
    several = moved if options.clocks and _groups(moved) == _groups(several) else several
    used = {(s.camera, s.moment): s for s in chosen(several, sizes, together)}
    count = len(sizes)
    for c, own in by_camera([s for s in good if (s.camera, s.moment) not in used]).items():
        for s in chosen(own, sizes, alone):  # what has no motion must not say that clocks agree
            one = replace(s, moment=LONE * (1 + count + c) + s.moment) if options.clocks and s.moment < LONE else s
            used[one.camera, one.moment] = one
    used |= {(s.camera, s.moment): s for s in sightings if s.moment == options.floor}
    return list(used.values())


def _groups(sightings: Sequence[Sighting]) -> set[frozenset[int]]:
    """The cameras that moments join."""
    groups = set[frozenset[int]]()
    for own in by_moment(sightings).values():
        here = frozenset(s.camera for s in own)
        joined = {group for group in groups if group & here}
        groups = groups - joined | {here.union(*joined)}
    return groups


def _paired(sightings: Iterable[Sighting], shifts: Sequence[int]) -> list[Sighting]:
    """With the moments that the cameras' frames show."""
    return [replace(s, moment=s.moment + shifts[s.camera]) if s.moment < LONE else s for s in sightings]


def _looked_again(
    every: Mapping[tuple[int, int], Sighting], shifts: Sequence[int], more: More | None
) -> dict[tuple[int, int], Sighting]:
    """What late cameras show in those moments that others show, by camera and frame."""
    known = [s for s in every.values() if s.moment < LONE and s.motion is not None]
    moments, there = {s.moment + shifts[s.camera] for s in known}, {(s.camera, s.moment) for s in known}
    out: dict[tuple[int, int], Sighting] = {}
    for c, shift in enumerate(shifts):
        frames = sorted(m - shift for m in moments if (c, m - shift) not in there)
        if shift and more is not None and frames:
            out |= {(c, s.moment): s for s in more(c, frames)}
    return out


def _of_all(found: Adjustment, names: Sequence[str]) -> Adjustment:
    lost = [name for c, name in enumerate(names) if c not in {s.camera for s in found.sightings}]
    if lost:
        raise InputError(
            f"camera {lost[0]} does not agree with the others in any picture of the board; is its video of the same"
            " recording, and its clock within a frame or two of theirs?"
        )
    return found


def _in_world(
    out: Adjustment, setup: Setup, board: Board, floor: int | None, report: Report
) -> tuple[Adjustment, bool]:
    """The same in a world that is up: that of the board on the floor, which then does not move, or a guess."""
    if floor is None:
        return replace(out, guess=moved(out.guess, upright(out.guess))), False
    if floor not in out.guess.boards:
        raise InputError(
            f"--floor: the board is not seen well enough in frame {floor}; name a frame where it lies in view."
        )
    report("floor")
    there = moved(out.guess, lying(board) @ np.linalg.inv(out.guess.boards[floor]))
    setup = replace(setup, guess=there, sightings=out.sightings, gauge=None, still=floor)
    return adjust(setup, report), True
