"""From recordings of a board to a rig: look, choose, fit the lenses, chain, adjust, place in the world."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.calibrate.adjust import Adjustment, Guess, Setup, adjust
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
        fits: of each lens alone.
        shifts: whole frames by which each camera shows a later moment than the first; sightings are paired so.
        floor_known: whether a board on the floor says where the world is; else up is a guess by the images.
    """

    rig: Rig
    adjustment: Adjustment
    board: Board
    fits: tuple[LensFit, ...]
    shifts: tuple[int, ...]
    floor_known: bool

    @property
    def late(self) -> Float:
        """(C,) frames by which each camera shows a later moment than the first."""
        return np.array(self.shifts, float) + np.array(self.adjustment.guess.late)


Report = Callable[[str], None]


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
    shared = seen(list(sources.values()), board, options, report)
    alone = alone_seen(lone, names, board, options, report)
    sizes = {c: source.size for c, source in enumerate(sources.values())}
    return of_sightings([*shared, *alone], board, names, sizes, options, report)


def of_sightings(
    sightings: Sequence[Sighting], board: Board, names: Sequence[str], sizes: Mapping[int, tuple[int, int]],
    options: Options, report: Report = lambda note: None,
) -> Calibration:  # fmt: skip
    """Calibrate by what was seen; `sizes` (w, h) px by camera."""
    solid, fits = flat(board.points), list[LensFit]()
    every = by_camera(sightings)
    for c, name in enumerate(names):
        report(f"lens of {name}")
        fits.append(fitted_lens(sharp(every.get(c, [])), solid, sizes[c], name, options.kinds))
    used = _used(sightings, sizes, options)
    if len(names) > 1 and not board.one_way:
        raise InputError("a chessboard of this size looks the same upside down; use one of an even and an odd side.")
    report("chaining the cameras")
    guess = chained(used, fits, solid, names)
    used = [s for s in used if s.moment in guess.boards]
    setup = Setup(guess, tuple(used), {"board": solid}, _first(guess), clocks=options.clocks)
    adjustment, shifts = _with_clocks(setup, report)
    adjustment, known = _in_world(adjustment, setup, board, options.floor, report)
    rig = Rig(adjustment.cameras(names))
    return Calibration(rig, adjustment, board, tuple(fits), shifts, known)


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
    """Moments that several cameras share, those of one camera alone for its lens, and the floor."""
    good, (together, alone) = sharp(sightings), options.moments
    several = _of_several(good)
    still = [s for s in several if s.motion is not None]
    several = still if options.clocks and len(still) > 0.5 * len(several) else several
    used = {(s.camera, s.moment): s for s in chosen(several, sizes, together)}
    for own in by_camera([s for s in good if (s.camera, s.moment) not in used]).values():
        used |= {(s.camera, s.moment): s for s in chosen(own, sizes, alone)}
    used |= {(s.camera, s.moment): s for s in sightings if s.moment == options.floor}
    return list(used.values())


def _first(guess: Guess) -> int:
    """The camera whose axes are the world's."""
    return next(c for c, place in enumerate(guess.places) if np.array_equal(place, np.eye(4)))


def _with_clocks(setup: Setup, report: Report) -> tuple[Adjustment, tuple[int, ...]]:
    """Adjust; where a clock is late by more than half a frame, pair its frames with others, and adjust again."""
    out, shifts = adjust(setup, report), (0,) * len(setup.guess.lenses)
    whole = tuple(round(late) if abs(late) > _SHIFTED else 0 for late in out.guess.late)
    if not any(whole):
        return out, shifts
    report("pairing frames by the clocks")
    paired = [replace(s, moment=s.moment + whole[s.camera]) if s.moment < LONE else s for s in setup.sightings]
    late = tuple(x - n for x, n in zip(out.guess.late, whole, strict=True))
    boards = {**setup.guess.boards, **out.guess.boards}
    used = tuple(s for s in paired if s.moment in boards)
    again = adjust(replace(setup, guess=replace(out.guess, late=late, boards=boards), sightings=used), report)
    return again, whole


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
