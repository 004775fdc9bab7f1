"""Bundle adjustment: places and lenses of all cameras, the board at every moment, and the board's true shape.

Triggs et al., "Bundle Adjustment: A Modern Synthesis", 1999, DOI 10.1007/3-540-44480-7_21. The poses of the board are
the arrow's band; cameras, lenses and shape are its border, so that their covariance is the inverse of one small matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Pose
from twistcap.calibrate.covariance import marginals
from twistcap.calibrate.lens import Lens
from twistcap.calibrate.sightings import SCENE, Sighting
from twistcap.calibrate.terms import KnownLens, SightingTerm, Solid
from twistcap.camera import Camera
from twistcap.solve import BlockProblem, CameraBlock, PoseTrack, Variables, Vector, minimise
from twistcap.terms.coordinates import BlockGaussian

_REACHES = (60.0, 20.0, 6.0)  # px: a wrong start is still within the first, most wrong points are beyond the last
_REACH, _KEPT = 4.0, 4.0  # standard deviations: of the robust loss; of the points that are kept for the last fit
_SHARPEST = 0.007  # px; no point is found better than that: no board's picture and no print is more exact
_RAYLEIGH = 1.1774  # median distance in the plane over the standard deviation of each coordinate
_LATE = 2.0  # frames; standard deviation of a clock that is not known
_PARABOLA = 0.041  # rms of t (1 − t²) / 6 for |t| < 1/2; see `_between_frames`
_FEWEST = 4  # right points of a sighting
_STEPS = 60


@dataclass(frozen=True)
class Guess:
    """Where an adjustment starts.

    Attributes:
        lenses, numbers: of each camera; see `Lens`.
        places: `T_cam_world` of each camera.
        boards: by moment, board to world.
        noise: of each camera's points, px, or in any unit: how far to trust a camera before another.
        late: frames by which each camera's clock is late.
    """

    lenses: tuple[Lens, ...]
    numbers: tuple[Float, ...]
    places: tuple[Float, ...]
    boards: Mapping[int, Float]
    noise: tuple[float, ...]
    late: tuple[float, ...]


@dataclass(frozen=True)
class Adjustment:
    """Cameras and boards, adjusted.

    Attributes:
        guess: the values reached.
        sightings, kept: those with enough right points, and which points of each (N,) were taken for right.
        sigmas: standard deviation of the points, px, by camera.
        solids, shapes: by name, what was seen, and the numbers of its shape.
        places, lenses: covariance of each camera's place (6, 6) (the left twist of `T_cam_world`; zero for the camera
            that is the gauge), and of its lens's numbers (n, n).
        clocks: standard deviation of each camera's clock, frames; 0 where it was held.
        shape_sigmas: by name, standard deviations of the numbers of the shape.
        residuals: (N, 2) px of each sighting.
        energy: of the robust fit.
    """

    guess: Guess
    sightings: tuple[Sighting, ...]
    kept: tuple[Bool, ...]
    sigmas: Float
    solids: Mapping[str, Solid]
    shapes: Mapping[str, Float]
    places: tuple[Float, ...]
    lenses: tuple[Float, ...]
    clocks: Float
    shape_sigmas: Mapping[str, Float]
    residuals: tuple[Float, ...]
    energy: float

    def cameras(self, names: Sequence[str]) -> tuple[Camera, ...]:
        """The cameras, by these names."""
        g = self.guess
        parts = zip(names, g.lenses, g.numbers, g.places, strict=True)
        return tuple(lens.camera(name, numbers, place) for name, lens, numbers, place in parts)


@dataclass(frozen=True)
class Setup:
    """What is adjusted, and what stays: the place of the camera `gauge`, or the board at the moment `still`.

    Attributes:
        guess, sightings: start, and evidence.
        solids: "board", "scene", or both.
        gauge: camera that does not move; None where `still` or the scene hold the world.
        still: moment of a board that does not move.
        clocks: whether each camera's clock is estimated, but for the gauge's.
    """

    guess: Guess
    sightings: tuple[Sighting, ...]
    solids: Mapping[str, Solid]
    gauge: int | None = 0
    still: int | None = None
    clocks: bool = False

    @cached_property
    def moments(self) -> list[int]:
        """Those at which the board may move, in order."""
        return sorted({s.moment for s in self.sightings} - {SCENE, self.still})

    @cached_property
    def frames(self) -> dict[int, tuple[str, int]]:
        """Block and frame of the pose at each moment."""
        fixed = SCENE if self.still is None else self.still
        return {m: ("boards", k) for k, m in enumerate(self.moments)} | {fixed: ("world", 0)}

    def variables(self) -> Variables:
        """All blocks at the guess."""
        g, still = self.guess, np.eye(4) if self.still is None else self.guess.boards[self.still]
        blocks = {"boards": _track([g.boards[m] for m in self.moments]), "world": _track([still])}
        cameras = zip(g.lenses, g.numbers, g.places, strict=True)
        for c, (lens, numbers, place) in enumerate(cameras):
            blocks |= {f"place {c}": CameraBlock(lens.camera(str(c), numbers, place)), f"lens {c}": Vector(numbers)}
        blocks |= {f"clock {c}": Vector(np.array([late])) for c, late in enumerate(g.late)}
        blocks |= {f"shape of {name}": Vector(np.zeros(len(solid.sigmas))) for name, solid in self.solids.items()}
        here = {s.camera for s in self.sightings}
        free = [f"place {c}" for c in sorted(here) if c != self.gauge]
        free += [f"lens {c}" for c in sorted(here)]
        free += [f"clock {c}" for c in self.estimated_clocks]
        free += [f"shape of {name}" for name in self.solids]
        longest = dict.fromkeys(["boards", *free], 0.3)
        return Variables(blocks, (*(["boards"] if self.moments else []), *free), longest)

    @property
    def estimated_clocks(self) -> list[int]:
        """Cameras whose clock is estimated: those that saw the board move, but for the first of them."""
        moving = sorted({s.camera for s in self.sightings if s.motion is not None})
        first = self.gauge if self.gauge in moving else moving[0] if moving else None
        return [c for c in moving if c != first] if self.clocks else []

    def problem(self, sigmas: Float, reach: float | None, kept: Sequence[Bool] | None = None) -> BlockProblem:
        """The terms of all sightings, and of what is known of lenses and shapes before."""
        own = [s.only(some) for s, some in zip(self.sightings, kept, strict=True)] if kept else self.sightings
        terms = [self._term([own[n] for n in group], sigmas, reach) for group in self.groups]
        shapes = [BlockGaussian(f"shape of {n}", np.zeros_like(x.sigmas), x.sigmas) for n, x in self.solids.items()]
        lenses = [KnownLens(self.guess.lenses[c], f"lens {c}") for c in sorted({s.camera for s in self.sightings})]
        clocks = [BlockGaussian(f"clock {c}", np.zeros(1), np.array([_LATE])) for c in self.estimated_clocks]
        return BlockProblem([*terms, *shapes, *lenses, *clocks], reach=0 if self.moments else None)

    @cached_property
    def groups(self) -> list[list[int]]:
        """Which sightings have one term: those of one camera and solid, with motion or without."""
        out: dict[tuple[object, ...], list[int]] = {}
        for n, s in enumerate(self.sightings):
            out.setdefault((s.camera, s.solid, self.frames[s.moment][0], s.motion is None), []).append(n)
        return list(out.values())

    def _term(self, own: Sequence[Sighting], sigmas: Float, reach: float | None) -> SightingTerm:
        """Of the sightings of a group."""
        s, ends = own[0], np.cumsum([0, *(len(s.ids) for s in own)]).tolist()
        names = (f"place {s.camera}", f"lens {s.camera}", self.frames[s.moment][0], f"shape of {s.solid}")
        motions = [s.motion for s in own if s.motion is not None]
        return SightingTerm(
            self.solids[s.solid], np.concatenate([s.ids for s in own]), np.concatenate([s.pixels for s in own]),
            np.concatenate([np.full(len(s.ids), s.rough * float(sigmas[s.camera])) for s in own]),
            [slice(*pair) for pair in pairwise(ends)], [self.frames[s.moment][1] for s in own], reach,
            self.guess.lenses[s.camera], *names, f"clock {s.camera}" if self.clocks and motions else None,
            np.concatenate(motions, axis=1) if motions else None,
        )  # fmt: skip


def adjust(setup: Setup, report: Callable[[str], None] = lambda note: None) -> Adjustment:
    """Adjust robustly, estimate each camera's noise, leave wrong points out, and adjust what is left by least squares.

    Raises InputError where the sightings do not determine the cameras.
    """
    x, count = setup.variables(), len(setup.guess.lenses)
    sigmas = np.ones(count)
    for reach in _REACHES:
        report(f"within {reach:g} px")
        x = _minimised(setup.problem(sigmas, reach), x, 1e-3)
    energy = 0.0
    for _ in range(3):
        sigmas = _noise(setup, x)
        report(f"noise {np.median(sigmas):.2f} px")
        problem = setup.problem(sigmas, _REACH)
        x = _minimised(problem, x, 1e-5)
        energy = float(sum(problem.energies(x).values()))
    setup, kept = _right(setup, x, sigmas)
    x = setup.variables()
    for _ in range(2):
        problem = setup.problem(sigmas, None, kept)
        x = _minimised(problem, x, 1e-9)
        sigmas = _noise_of_kept(setup, x, kept)
    return _outcome(setup, x, sigmas, kept, energy)


def _minimised(problem: BlockProblem, x: Variables, gain: float) -> Variables:
    return minimise(problem, x, steps=_STEPS, damping=1e-8, gain=gain).x


def _residuals(setup: Setup, x: Variables) -> list[Float]:
    terms, out = setup.problem(np.ones(len(setup.guess.lenses)), None).terms, dict[int, Float]()
    for group, term in zip(setup.groups, terms, strict=False):
        assert isinstance(term, SightingTerm)
        residuals = term.residuals(x)
        out |= {n: residuals[own] for n, own in zip(group, term.images, strict=True)}
    return [out[n] for n in range(len(setup.sightings))]


def _noise(setup: Setup, x: Variables) -> Float:
    """(C,) standard deviation of the points of each camera, px, whatever a quarter of the points of all say."""
    sizes = [np.linalg.norm(r, axis=1) / _expected(setup, s) for s, r in _by_sighting(setup, x)]
    return _scaled(setup, float(np.nanmedian(np.concatenate(sizes))) / _RAYLEIGH)


def _noise_of_kept(setup: Setup, x: Variables, kept: Sequence[Bool]) -> Float:
    """(C,) the same of the points that are kept, with the share of the numbers that were fitted to them."""
    parts = zip(_by_sighting(setup, x), kept, strict=True)
    sizes = np.concatenate([np.linalg.norm(r[k], axis=1) / _expected(setup, s) for (s, r), k in parts])
    free = max(2 * len(sizes) - x.dof, 0.1 * len(sizes))
    return _scaled(setup, float(np.sqrt(np.sum(sizes * sizes) / free)))


def _expected(setup: Setup, s: Sighting) -> float:
    return s.rough * setup.guess.noise[s.camera]


def _scaled(setup: Setup, factor: float) -> Float:
    return np.maximum(factor * np.array(setup.guess.noise), _SHARPEST)


def _by_sighting(setup: Setup, x: Variables) -> list[tuple[Sighting, Float]]:
    return list(zip(setup.sightings, _residuals(setup, x), strict=True))


def _right(setup: Setup, x: Variables, sigmas: Float) -> tuple[Setup, list[Bool]]:
    """The sightings with enough points that fit, and which points those are."""
    parts = _by_sighting(setup, x)
    off = [(s, np.nan_to_num(np.linalg.norm(r, axis=1), nan=np.inf) / (s.rough * sigmas[s.camera])) for s, r in parts]
    good = [(s, o < _KEPT) for s, o in off if np.sum(o < _KEPT) >= min(_FEWEST, len(o))]
    return replace(setup, guess=_reached(setup, x), sightings=tuple(s for s, _ in good)), [k for _, k in good]


def _reached(setup: Setup, x: Variables) -> Guess:
    cameras = range(len(setup.guess.lenses))
    boards = {m: x[block].poses[k].root for m, (block, k) in setup.frames.items() if m != SCENE}
    numbers = tuple(x[f"lens {c}"].values for c in cameras)
    places = tuple(x[f"place {c}"].camera.T_cam_world for c in cameras)
    late = tuple(float(x[f"clock {c}"].values[0]) for c in cameras)
    return replace(setup.guess, numbers=numbers, places=places, boards=boards, late=late)


def _outcome(setup: Setup, x: Variables, sigmas: Float, kept: list[Bool], energy: float) -> Adjustment:
    problem = setup.problem(sigmas, None, kept)
    shared = marginals(problem, x, [term for term in problem.terms if isinstance(term, SightingTerm)])
    start = x.slices["boards"].stop if "boards" in x.slices else 0

    def block(name: str) -> Float:
        if name not in x.slices:
            return np.zeros((x[name].dof, x[name].dof))
        own = slice(x.slices[name].start - start, x.slices[name].stop - start)
        return shared[own, own]

    cameras = range(len(setup.guess.lenses))
    shapes = {name: x[f"shape of {name}"].values for name in setup.solids}
    return Adjustment(
        _reached(setup, x), setup.sightings, tuple(kept), sigmas, setup.solids, shapes,
        tuple(block(f"place {c}") for c in cameras), tuple(block(f"lens {c}") for c in cameras),
        np.hypot([np.sqrt(block(f"clock {c}")[0, 0]) for c in cameras], _between_frames(setup)),
        {name: np.sqrt(np.diagonal(block(f"shape of {name}"))) for name in setup.solids},
        tuple(_residuals(setup, x)), energy,
    )  # fmt: skip


def _between_frames(setup: Setup) -> Float:
    """(C,) frames by which estimated clocks err since the board is no parabola between three frames.

    Of a swing sin ωt it is wrong by ω² t (1 − t²) / 6 of the speed, at the fraction t of a frame. There ω² is the mean
    square of the acceleration over that of the speed.
    """
    out = np.zeros(len(setup.guess.lenses))
    for c in setup.estimated_clocks:
        seen = [s.motion for s in setup.sightings if s.camera == c and s.motion is not None]
        speed, half = (float(np.sum(part * part)) for part in np.concatenate(seen, axis=1))
        out[c] = _PARABOLA * 4.0 * half / max(speed, 1e-12)
    return out


def _track(motions: Sequence[Float]) -> PoseTrack:
    return PoseTrack(tuple(Pose(T, np.zeros(0)) for T in motions), np.arange(float(len(motions))))
