"""From recordings of a board to a rig: look, choose, fit the lenses, chain, adjust, place in the world."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.calibrate.adjust import Adjustment, Setup, adjust
from twistcap.calibrate.board import Board
from twistcap.calibrate.clocks import motions, offsets
from twistcap.calibrate.detect import Detector, is_mirrored, variants
from twistcap.calibrate.lens import Kind
from twistcap.calibrate.other import is_contradicted, other_in_words, tagged
from twistcap.calibrate.sightings import LONE, Looker, Sighting, by_camera, by_moment, chosen, look, sharp
from twistcap.calibrate.start import LensFit, chained, fitted_lens
from twistcap.calibrate.terms import Solid, flat
from twistcap.calibrate.timing import Timing, in_step, started_together
from twistcap.calibrate.world import lying, moved, upright
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.io.video import Source

_SAMPLES = 24  # images of each camera by which the variant of the board is found
_FEW = 12  # images that show whether another board was filmed
_SHIFTED = 0.5  # frames; a clock that is later is paired with other frames
_PAIRINGS = 4
_DENSE = 0.12  # s from one look to the next, at which the motion of a board in hands is seen
_AGREE = 0.5  # share of a camera's sightings that must fit, where its clock was not found
_WORSE = 10.0  # times the noise of a camera by itself, from which on it does not fit the others
_OTHER_CLOCK = (
    "camera {name} shows the board elsewhere than the others at the same time, and how the board moves does not tell by"
    " how much its clock differs; film again, and turn the board briskly this way and that where {name} and another"
    " camera see it."
)


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
        timing: when each camera's frames were taken; sightings are paired so.
        floor_known: whether a board on the floor says where the world is; else up is a guess by the images.
        points: names of the measured points of the scene, by their ids.
    """

    rig: Rig
    adjustment: Adjustment
    board: Board
    timing: Timing
    floor_known: bool
    points: tuple[str, ...] = ()

    @property
    def late(self) -> tuple[Float, Float]:
        """(C,) ticks by which each camera shows a later moment than the first, and their standard deviations.

        A tick is a frame of the slowest camera.
        """
        late, sigmas = np.array(self.timing.shifts) + np.array(self.adjustment.guess.late), self.adjustment.clocks
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
        sources: of each camera, started at any time; their rates may differ.
        lone: pictures of the board by one camera alone, for its lens, by camera.
        report: called with what is being done.

    Raises InputError: for a board that is not found, mirrored, seen too little, or the same upside down; a floor's
    frame that is none; cameras that nothing joins, or whose clocks differ and are not found.
    """
    options, lone, names = options or Options(), lone or {}, tuple(sources)
    _check_asked(sources, board, options)
    board = found_variant([*sources.values(), *lone.values()], board)
    own = list(sources.values())
    timing = started_together(own)
    step, looker = _step(timing, options), Looker(own, board, timing.times, report)
    shared = seen(looker, timing, step, options)
    alone = alone_seen(lone, names, board, options, report)
    sizes = {c: source.size for c, source in enumerate(sources.values())}
    return of_sightings([*shared, *alone], board, names, sizes, options, report, looker, timing, step)


def _check_asked(sources: Mapping[str, Source], board: Board, options: Options) -> None:
    """What needs no look into the videos. Raises InputError."""
    if len(sources) > 1 and not board.one_way:
        raise InputError("a chessboard of this size looks the same upside down; use one of an even and an odd side.")
    (name, first), *_ = sources.items()
    if options.floor is not None and options.floor >= len(first):
        frames = f"the frames of camera {name} are 0 to {len(first) - 1}"
        raise InputError(f"--floor is {options.floor}, but {frames}; name one in which the board lies on the floor.")


def of_sightings(
    sightings: Sequence[Sighting], board: Board, names: Sequence[str], sizes: Mapping[int, tuple[int, int]],
    options: Options, report: Report = lambda note: None, more: More | None = None, timing: Timing | None = None,
    step: int = 1,
) -> Calibration:  # fmt: skip
    """Calibrate by what was seen; `sizes` (w, h) px by camera.

    Clocks are found coarsely by how the board moves. Where one is then late by more than half a frame, its frames are
    paired with others, and all is adjusted again.

    Args:
        sightings: the moment of each is the number of its frame.
        more: looks in frames that were not looked at.
        timing: when the frames were taken; None where those of one number were taken together.
        step: ticks from one frame that was looked at to the next.
    """
    solid, of_each = flat(board.points), by_camera(sightings)
    fits = [_lens(of_each.get(c, []), solid, sizes[c], name, options, report) for c, name in enumerate(names)]
    every, timing = {(s.camera, s.moment): s for s in sightings}, timing or in_step(sightings, len(names))
    timing, lost = _by_motion(sightings, fits, solid, timing) if options.clocks else (timing, [])

    def fitted(timing: Timing) -> tuple[Setup, Adjustment]:
        every.update(_looked_again(every, timing, step, sizes, options, more))
        report("chaining the cameras")
        floor = _floor(timing, options)
        used = _used(timing.paired(every.values(), floor), sizes, options, floor)
        guess = chained(used, fits, solid, names)
        first = next(c for c, place in enumerate(guess.places) if np.array_equal(place, np.eye(4)))
        used = tuple(s for s in used if s.moment in guess.boards)
        setup = Setup(guess, used, {"board": solid}, first, clocks=options.clocks)
        return setup, _agreeing(setup, names, lost, report)

    setup, adjustment = fitted(timing)
    for _ in range(_PAIRINGS):
        ticks = [round(late) if abs(late) > _SHIFTED else 0 for late in adjustment.guess.late]
        if not any(ticks):
            break
        report("pairing frames by the clocks")
        timing = timing.later(ticks)
        setup, adjustment = fitted(timing)
    adjustment, known = _in_world(adjustment, setup, board, _floor(timing, options), options, report)
    return Calibration(Rig(adjustment.cameras(names)), adjustment, board, timing, known)


def _floor(timing: Timing, options: Options) -> int | None:
    """The moment at which the board lies on the floor."""
    return None if options.floor is None else round(timing.moment(0, options.floor))


def _lens(
    own: Sequence[Sighting], solid: Solid, size: tuple[int, int], name: str, options: Options, report: Report
) -> LensFit:
    report(f"lens of {name}")
    return fitted_lens(sharp(own), solid, size, name, options.kinds)


def _by_motion(
    sightings: Sequence[Sighting], fits: Sequence[LensFit], solid: Solid, timing: Timing
) -> tuple[Timing, list[int]]:
    """The clocks to a tick or so, and the cameras whose clocks are not found; the rest is left to the adjustment."""
    by, lost = offsets(motions(sightings, fits, solid, timing.times))
    ticks = by / timing.interval
    return timing.later([round(n) if abs(n) >= 1.0 else 0 for n in ticks.tolist()]), lost


def found_variant(sources: Sequence[Source], board: Board) -> Board:
    """The board, or the variant of it that images show.

    Raises InputError where they show none, a mirrored one, or another board, which a few of them tell.
    """
    images = [i for source in sources for i in source.read(_spread(source, _SAMPLES)) if i is not None]
    few = images[:: max(1, len(images) // _FEW)]
    if board.kind == "chessboard" and is_contradicted(board, tags := tagged(few)):
        raise InputError(f"the pictures do not show the board, a {board.words}{other_in_words(board, tags)}.")
    counts = dict[Board, int]()
    for variant in variants(board):
        find, counts[variant] = Detector(variant), 0
        for image in images:
            counts[variant] += find(image) is not None
            if counts[variant] > 0.2 * len(images):  # more than any before it
                return variant
    best = max(counts, key=counts.__getitem__)
    if counts[best] == 0 and is_mirrored(board, images):
        raise InputError("the board is seen mirrored; the videos are flipped (as a selfie is), or its print is.")
    if counts[best] == 0:
        raise InputError(f"no picture shows the board, a {board.words}{other_in_words(board, tagged(few))}.")
    return best


def _step(timing: Timing, options: Options) -> int:
    """Ticks from one frame that is looked at to the next; where clocks are to be found, the motion must be seen."""
    length = max(round(float(times[-1] - times[0]) / timing.interval) + 1 for times in timing.times)
    step = max(1, -(-length // options.looks))
    wanted = options.clocks and len(timing.times) > 1
    return min(step, max(1, int(_DENSE / timing.interval))) if wanted else step


def seen(looker: Looker, timing: Timing, step: int, options: Options) -> list[Sighting]:
    """Sightings of all cameras in frames that are spread over the recording; the moment is the frame."""
    out = list[Sighting]()
    for c, times in enumerate(timing.times):
        frames = list(range(0, len(times), max(1, round(step * timing.interval / timing.intervals[c]))))
        out += looker.at(c, sorted({*frames, *([] if c or options.floor is None else [options.floor])}))
    return out


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


def _used(
    sightings: Sequence[Sighting], sizes: Mapping[int, tuple[int, int]], options: Options, floor: int | None
) -> list[Sighting]:
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
    used |= {(s.camera, s.moment): s for s in sightings if s.moment == floor}
    return list(used.values())


def _groups(sightings: Sequence[Sighting]) -> set[frozenset[int]]:
    """The cameras that moments join."""
    groups = set[frozenset[int]]()
    for own in by_moment(sightings).values():
        here = frozenset(s.camera for s in own)
        joined = {group for group in groups if group & here}
        groups = groups - joined | {here.union(*joined)}
    return groups


def _looked_again(
    every: Mapping[tuple[int, int], Sighting], timing: Timing, step: int, sizes: Mapping[int, tuple[int, int]],
    options: Options, more: More | None,
) -> dict[tuple[int, int], Sighting]:  # fmt: skip
    """By camera and frame, what cameras show in those moments, every `step` ticks, that are worth adjusting."""
    near, off = dict[tuple[int, int], Sighting](), dict[tuple[int, int], float]()
    for (c, frame), s in every.items():
        if frame < LONE:
            exact = timing.moment(c, frame)
            key = (c, step * round(exact / step))
            if abs(exact - key[1]) < off.get(key, np.inf):
                near[key], off[key] = replace(s, moment=key[1]), abs(exact - key[1])
    wanted = {s.moment for s in chosen(_of_several(sharp(list(near.values()))), sizes, options.moments[0])}
    floor = _floor(timing, options)
    wanted |= set() if floor is None else {floor}
    out: dict[tuple[int, int], Sighting] = {}
    for c in range(len(sizes)):
        frames = {frame for m in wanted if (frame := timing.frame(c, m)) is not None}
        lacking = sorted(f for f in frames if (c, f) not in every or every[c, f].motion is None)
        out |= {(c, s.moment): s for s in more(c, lacking)} if more is not None and lacking else {}
    return out


def _agreeing(setup: Setup, names: Sequence[str], lost: Sequence[int], report: Report) -> Adjustment:
    """The adjustment. Raises InputError where a camera does not agree with the others; `lost` are of unknown clocks."""
    try:
        found = adjust(setup, report)
    except InputError:
        if lost:
            raise InputError(_OTHER_CLOCK.format(name=names[lost[0]])) from None
        raise
    for c, name in enumerate(names):
        asked, kept = (sum(s.camera == c and s.moment < LONE for s in side.sightings) for side in (setup, found))
        noise = float(found.sigmas[c]) / setup.guess.noise[c]
        if c in lost and (kept < _AGREE * asked or noise > _WORSE):
            raise InputError(_OTHER_CLOCK.format(name=name))
        if all(s.camera != c for s in found.sightings):
            why = "does not agree with the others in any picture of the board; is its video of the same recording?"
            raise InputError(f"camera {name} {why}")
    return found


def _in_world(
    out: Adjustment, setup: Setup, board: Board, floor: int | None, options: Options, report: Report
) -> tuple[Adjustment, bool]:
    """The same in a world that is up: that of the board on the floor, which then does not move, or a guess."""
    if floor is None:
        return replace(out, guess=moved(out.guess, upright(out.guess))), False
    if floor not in out.guess.boards:
        raise InputError(
            f"--floor: the board is not seen well enough in frame {options.floor}; name a frame where it lies in view."
        )
    report("floor")
    there = moved(out.guess, lying(board) @ np.linalg.inv(out.guess.boards[floor]))
    setup = replace(setup, guess=there, sightings=out.sightings, gauge=None, still=floor)
    return adjust(setup, report), True
