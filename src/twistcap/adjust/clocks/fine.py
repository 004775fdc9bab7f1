"""Clocks from the tracked body: poses of all frames and a time offset for each camera, in one least squares.

A point that moves at v is v·Δt off in the images of a camera whose clock is Δt off. Each image is compared with the
body at its own time, between two frames of the track.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.adjust.refine.measure import SequenceImages
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.adjust.sequence import SmoothMotion, claimed_sigma, design_effect
from twistcap.arrays import Float
from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.errors import check
from twistcap.estimate import Estimate, Frame
from twistcap.settings import Settings
from twistcap.solve import Arrow, minimise
from twistcap.solve.blocks import Moment, PoseTrack
from twistcap.terms import PointTerm

_ROUNDS = 8
_COARSE_ROUNDS = 2
_SETTLED = 5e-5  # s by which clocks may still move in the last round
_LONGEST = 0.03  # s that a clock moves in one step
_WIDE = 0.1  # s, standard deviation of a clock before anything is seen
_DAMPING = 1e-3
_STEPS = 3  # of the solver in each round

Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Clocks:
    """How late the cameras are: what an image shows is `late` (C,) s after what its clock says.

    `sigma` (C,) are the standard deviations; those of the camera that stands for the time are 0. `moved` are s by
    which the clocks moved in each round. `poses` are those of the frames, all images at their own times.
    """

    late: Float
    sigma: Float
    moved: tuple[float, ...]
    poses: PoseTrack


def estimate_clocks(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], lags: Float, reference: int,
    tracker: Settings | None = None, rounds: int = _ROUNDS, report: Report | None = None,
) -> Clocks:  # fmt: skip
    """Clocks of all cameras against that of one, by the contours of a body that was tracked.

    Args:
        frames: those of the estimates, in order, with images as they were taken.
        body, rig, estimates: of the track; the cameras are those of the images.
        lags: (C, F) s, time of each image, by what is known of its clock, after that of its frame.
        reference: number of the camera whose clock is right.
        tracker: settings of the contour cue.
        rounds: in which images are measured, at most.
        report: is called with the progress.

    Raises InputError for fewer than three frames, or frames that are not those of the estimates.
    """
    check("clocks", len(estimates) >= 3, f"{len(estimates)} frames are tracked; at least 3 are needed")
    settings = replace(tracker or Settings(), method="direct")
    images, report = SequenceImages(rig.pinhole(), RefineConfig(), settings, body), report or (lambda *_: None)
    for done in images.read(frames, estimates):
        report("reading", done, len(estimates) * (1 + rounds))
    track = PoseTrack(tuple(e.pose for e in estimates), np.array([e.time for e in estimates]))
    x, moved, effect, solution = Clocked(track, np.zeros(len(rig))), list[float](), 1.0, None
    while len(moved) < rounds:
        coarse = len(moved) < min(_COARSE_ROUNDS, rounds - 1)
        contours = images.contours(moments_posed(body, x, lags), coarse)
        problem = ClockProblem(body, contours, lags, reference)
        solution = minimise(problem, x, _STEPS, _DAMPING)
        moved.append(float(np.abs(solution.x.late - x.late).max()))
        x, effect = solution.x, design_effect(problem.seen(x))
        report(
            f"round {len(moved)} of at most {rounds}", len(estimates) * (1 + len(moved)), len(estimates) * (1 + rounds)
        )
        if not coarse and moved[-1] < _SETTLED:
            break
    assert solution is not None
    sigma = claimed_sigma(solution.system, effect)
    sigma[reference] = 0.0
    return Clocks(x.late, sigma, tuple(moved), x.track)


@dataclass(frozen=True)
class Clocked:
    """The variables: the poses of all frames, and (C,) s by which each camera is late."""

    track: PoseTrack
    late: Float


def moments_posed(body: Body, x: Clocked, lags: Float) -> list[list[Posed]]:
    """The body at the time of each image, by camera and frame."""
    times = x.track.times
    return [[Posed(body, x.track.at(float(t)).pose) for t in times + own + late]
            for own, late in zip(lags, x.late, strict=True)]  # fmt: skip


class ClockProblem:
    """Contours (C lists of F terms, None without one), limits, rest pose and smooth motion."""

    def __init__(self, body: Body, contours: Sequence[Sequence[PointTerm | None]], lags: Float, reference: int) -> None:
        self.body, self.contours, self.lags, self.reference = body, contours, lags, reference
        self.motion = SmoothMotion(body)

    def energies(self, x: Clocked) -> dict[str, float]:
        """By term."""
        contour = sum(term.energy(Posed(self.body, at.pose)) for _, term, at in self._sights(x))
        clock = 0.5 * float(np.sum((x.late / _WIDE) ** 2))
        return {"contour": contour, "clock": clock, **self.motion.energies(x.track)}

    def linearised(self, x: Clocked) -> Arrow:
        """The quadratic of all poses' steps and of the clocks'."""
        arrow = Arrow(len(x.track.poses), x.track.pose_dof, len(x.late), 2)
        arrow.longest, arrow.shared_longest = 0.5, _LONGEST
        for camera, term, at in self._sights(x):
            quadratic = term.linearize(Posed(self.body, at.pose))
            arrow.value += quadratic.value
            _add(arrow, at, camera, quadratic.gradient, quadratic.hessian)
        self.motion.add_to(arrow, x.track)
        arrow.value += 0.5 * float(np.sum((x.late / _WIDE) ** 2))
        arrow.shared_pull += x.late / _WIDE**2
        arrow.corner += np.eye(len(x.late)) / _WIDE**2
        self._hold(arrow)
        return arrow

    def retract(self, x: Clocked, step: Float) -> Clocked:
        """After a step (F D + C,)."""
        poses = x.track.dof
        return Clocked(x.track.retract(step[:poses]), x.late + step[poses:])

    def seen(self, x: Clocked) -> Iterator[tuple[PointTerm, Posed]]:
        """Each term, and the body at its image's time."""
        return ((term, Posed(self.body, at.pose)) for _, term, at in self._sights(x))

    def _sights(self, x: Clocked) -> Iterator[tuple[int, PointTerm, Moment]]:
        for camera, terms in enumerate(self.contours):
            for t, term in enumerate(terms):
                if term is not None:
                    yield camera, term, x.track.at(float(x.track.times[t] + self.lags[camera, t] + x.late[camera]))

    def _hold(self, arrow: Arrow) -> None:
        """The reference's clock does not move."""
        k = self.reference
        arrow.border[:, :, k], arrow.corner[k], arrow.corner[:, k], arrow.shared_pull[k] = 0.0, 0.0, 0.0, 0.0
        arrow.corner[k, k] = 1.0


def _add(arrow: Arrow, at: Moment, camera: int, gradient: Float, hessian: Float) -> None:
    """Add the quadratic of a pose between two frames, which their steps and the camera's clock move."""
    (t, u), (by_t, by_u), velocity = at.frames, at.by_frame, at.velocity
    arrow.add_pose(t, by_t.T @ gradient, by_t.T @ hessian @ by_t)
    arrow.add_pose(u, by_u.T @ gradient, by_u.T @ hessian @ by_u)
    arrow.band[t, u - t] += by_u.T @ hessian @ by_t
    by_time = hessian @ velocity
    arrow.border[t, :, camera] += by_t.T @ by_time
    arrow.border[u, :, camera] += by_u.T @ by_time
    arrow.corner[camera, camera] += velocity @ by_time
    arrow.shared_pull[camera] += velocity @ gradient
