"""Clocks from the tracked body: poses of all frames, and each camera's time offset and turn, in one least squares.

A point that moves at v is v·Δt off in the images of a camera whose clock is Δt off. Each image is compared with the
body at its own time, between two frames of the track. A camera that is turned a little, or whose contours are all drawn
to one side, must not pass for one that is late: so a small turn of each is found with its clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from twistcap import se3
from twistcap.adjust.cameras.fine import by_camera
from twistcap.adjust.refine.measure import SequenceImages
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.adjust.sequence import SmoothMotion, claimed_sigma, design_effect
from twistcap.arrays import Float
from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.errors import check
from twistcap.estimate import Estimate, Frame
from twistcap.predict.inertia import INFLATION
from twistcap.settings import Settings
from twistcap.solve import Arrow, minimise
from twistcap.solve.blocks import Moment, PoseTrack
from twistcap.terms import PointNormalTerm
from twistcap.terms.accumulate import normal_equations

_ROUNDS = 8
_COARSE_ROUNDS = 2
_SETTLED = 5e-5  # s by which clocks may still move in the last round
_LONGEST = 0.03  # s that a clock moves in one step
_WIDE = 0.1  # s, standard deviation of a clock before anything is seen
_TURNED = np.deg2rad(0.1)  # standard deviation of a camera's turn from its calibration, and of a bias like it
_DAMPING = 1e-3
_STEPS = 3  # of the solver in each round

Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Clocks:
    """How late the cameras are: what an image shows is `late` (C,) s after what its clock says.

    `sigma` (C,) are the standard deviations; those of the camera that stands for the time are 0. `poses` are those of
    the frames, all images at their own times.
    """

    late: Float
    sigma: Float
    poses: PoseTrack


def estimate_clocks(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], lags: Float, reference: int,
    tracker: Settings | None = None, report: Report | None = None,
) -> Clocks:  # fmt: skip
    """Clocks of all cameras against that of one, by the contours of a body that was tracked.

    Args:
        frames: those of the estimates, in order, with images as they were taken.
        body, rig, estimates: of the track; the cameras are those of the images.
        lags: (C, F) s, time of each image, by what is known of its clock, after that of its frame.
        reference: number of the camera whose clock is right.
        tracker: settings of the contour cue.
        report: is called with the progress.

    Raises InputError for fewer than three frames, or frames that are not those of the estimates.
    """
    check("clocks", len(estimates) >= 3, f"{len(estimates)} frames are tracked; at least 3 are needed")
    settings = replace(tracker or Settings(), method="direct")
    images, report = SequenceImages(rig.pinhole(), RefineConfig(), settings, body), report or (lambda *_: None)
    for done in images.read(frames, estimates):
        report("reading", done, len(estimates) * (1 + _ROUNDS))
    track = PoseTrack(tuple(e.pose for e in estimates), np.array([e.time for e in estimates]))
    x = Clocked(track, np.zeros(len(rig)), np.zeros((len(rig), 3)))
    moved, effect, solution = list[float](), 1.0, None
    while len(moved) < _ROUNDS:
        coarse = len(moved) < _COARSE_ROUNDS
        measured = images.contours(moments_posed(body, x, lags), coarse)
        contours = cast(Sequence[Sequence[PointNormalTerm | None]], measured)  # which the direct cue makes
        problem = ClockProblem(body, contours, lags, reference, images.rig, effect)
        solution = minimise(problem, x, _STEPS, _DAMPING)
        moved.append(float(np.abs(solution.x.late - x.late).max()))
        x, effect = solution.x, design_effect(problem.seen(solution.x))
        done = len(estimates) * (1 + len(moved))
        report(f"round {len(moved)} of at most {_ROUNDS}", done, len(estimates) * (1 + _ROUNDS))
        if not coarse and moved[-1] < _SETTLED:
            break
    assert solution is not None
    sigma = claimed_sigma(solution.system, effect)[: len(rig)]
    sigma[reference] = 0.0
    return Clocks(x.late, sigma, x.track)


@dataclass(frozen=True)
class Clocked:
    """The variables: the poses of all frames, (C,) s by which each camera is late, and (C, 3) rad by which it is turned
    from its calibration, in its own axes.
    """

    track: PoseTrack
    late: Float
    turns: Float


def moments_posed(body: Body, x: Clocked, lags: Float) -> list[list[Posed]]:
    """The body at the time of each image, by camera and frame."""
    times = x.track.times
    return [[Posed(body, x.track.at(float(t)).pose) for t in times + own + late]
            for own, late in zip(lags, x.late, strict=True)]  # fmt: skip


class ClockProblem:
    """Contours (C lists of F terms, None without one) of cameras as calibrated, limits, rest pose and smooth motion.

    Contours count at their own noise, and what is claimed of them is `INFLATION` times that, and the root of the design
    `effect`; so what is known of the cameras' turns is made narrower by as much.
    """

    def __init__(
        self, body: Body, contours: Sequence[Sequence[PointNormalTerm | None]], lags: Float, reference: int, rig: Rig,
        effect: float = 1.0,
    ) -> None:  # fmt: skip
        self.body, self.contours, self.lags, self.reference = body, contours, lags, reference
        self.motion, self.places = SmoothMotion(body), [camera.T_cam_world for camera in rig]
        self.known = np.repeat([_WIDE, _TURNED / (INFLATION * np.sqrt(effect))], (len(rig), 3 * len(rig)))

    def energies(self, x: Clocked) -> dict[str, float]:
        """By term."""
        contour = sum(term.energy(posed) for term, posed in self.seen(x))
        camera = 0.5 * float(np.sum((_shared(x) / self.known) ** 2))
        return {"contour": contour, "camera": camera, **self.motion.energies(x.track)}

    def linearised(self, x: Clocked) -> Arrow:
        """The quadratic of all poses' steps, and of the clocks' and turns'."""
        shared = _shared(x)
        arrow = Arrow(len(x.track.poses), x.track.pose_dof, len(shared), 2)
        arrow.longest, arrow.shared_longest = 0.5, _LONGEST
        twists = [_twist(x, camera) for camera in range(len(self.places))]
        turned = [(se3.exp(w) @ T, se3.left_jacobian(w)[:, :3]) for w, T in zip(twists, self.places, strict=True)]
        for camera, term, at in self._sights(x):
            self._add(arrow, x, camera, term, at, turned[camera])
        self.motion.add_to(arrow, x.track)
        arrow.value += 0.5 * float(np.sum((shared / self.known) ** 2))
        arrow.shared_pull += shared / self.known**2
        arrow.corner += np.diag(self.known**-2)
        self._hold(arrow)
        return arrow

    def retract(self, x: Clocked, step: Float) -> Clocked:
        """After a step (F D + 4 C,)."""
        poses, cameras = x.track.dof, len(x.late)
        late, turns = np.split(_shared(x) + step[poses:], [cameras])
        return Clocked(x.track.retract(step[:poses]), late, turns.reshape(cameras, 3))

    def seen(self, x: Clocked) -> Iterator[tuple[PointNormalTerm, Posed]]:
        """Each term, of the camera as it is turned, and the body at its image's time."""
        return ((term, Posed(self.body, at.pose)) for _, term, at in self._sights(x))

    def _sights(self, x: Clocked) -> Iterator[tuple[int, PointNormalTerm, Moment]]:
        for camera, terms in enumerate(self.contours):
            turn = np.linalg.inv(self.places[camera]) @ se3.exp(_twist(x, camera)) @ self.places[camera]
            for t, term in enumerate(terms):
                if term is not None:
                    time = float(x.track.times[t] + self.lags[camera, t] + x.late[camera])
                    yield camera, replace(term, P=term.P @ turn), x.track.at(time)

    def _hold(self, arrow: Arrow) -> None:
        """The reference's clock does not move."""
        k = self.reference
        arrow.border[:, :, k], arrow.corner[k], arrow.corner[:, k], arrow.shared_pull[k] = 0.0, 0.0, 0.0, 0.0
        arrow.corner[k, k] = 1.0

    def _add(
        self, arrow: Arrow, x: Clocked, camera: int, term: PointNormalTerm, at: Moment, turned: tuple[Float, Float]
    ) -> None:
        """Add an image's quadratic. The steps of two frames and the camera's clock move the pose at its time; `turned`
        are the camera's place (4, 4) and the derivative (6, 3) of its twist by its turn."""
        (t, u), (by_t, by_u), D = at.frames, at.by_frame, x.track.pose_dof
        posed = Posed(self.body, at.pose)
        energy, points, rows = term.rows(posed)
        by_turn = by_camera(turned[0], points.at(posed), rows.gradient) @ turned[1]
        gradient, hessian = normal_equations(posed, points, rows, by_turn)
        arrow.value += energy
        arrow.add_pose(t, by_t.T @ gradient[:D], by_t.T @ hessian[:D, :D] @ by_t)
        arrow.add_pose(u, by_u.T @ gradient[:D], by_u.T @ hessian[:D, :D] @ by_u)
        arrow.band[t, u - t] += by_u.T @ hessian[:D, :D] @ by_t
        moves = np.zeros((D + 3, 4))  # of the pose and the turn, by the clock and the turn
        moves[:D, 0], moves[D:, 1:] = at.velocity, np.eye(3)
        own, by_own = np.r_[camera, len(x.late) + 3 * camera + np.arange(3)], hessian @ moves
        arrow.border[t][:, own] += by_t.T @ by_own[:D]
        arrow.border[u][:, own] += by_u.T @ by_own[:D]
        arrow.corner[np.ix_(own, own)] += moves.T @ by_own
        arrow.shared_pull[own] += moves.T @ gradient


def _twist(x: Clocked, camera: int) -> Float:
    """(6,) left twist of a camera from where it was calibrated."""
    return np.concatenate([x.turns[camera], np.zeros(3)])


def _shared(x: Clocked) -> Float:
    """(4 C,) clocks, then turns."""
    return np.concatenate([x.late, x.turns.ravel()])
