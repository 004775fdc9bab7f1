"""Refinement of a whole track: look, sum, solve for all frames and the body's shape, and look again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap._typing import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.shape import RestMotion
from twistcap.camera import Rig
from twistcap.cues.appearance import Appearance
from twistcap.cues.view import crop_view, despeckled
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.firstpose import girth_groups
from twistcap.refine.evidence import Instant, Sight, add_brightness, add_contour, blur_of, followed_points, mean_joint_shift
from twistcap.refine.motion import add_accelerations
from twistcap.refine.settings import RefineConfig, Shape
from twistcap.refine.system import Arrow, Solution
from twistcap.render import render, visible_contour
from twistcap.settings import TrackerConfig
from twistcap.terms import LimitTerm, RestTerm

Tell = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Refined:
    """A refined track.

    Attributes:
        body: with the refined lengths, girths and joint centres.
        estimates: one for each given, with covariances that count the shape's uncertainty.
        lengths, girths: factor of each group of segments against the body given.
        length_sigmas: standard deviation of each log-length.
        joint_shifts: (3,) m in the rest pose, by the segment below the joint; joint_sigmas: their standard deviations.
        moved: m that the landmarks moved in each round, mean over all frames.
    """

    body: Body
    estimates: tuple[Estimate, ...]
    lengths: Mapping[str, float]
    length_sigmas: Mapping[str, float]
    girths: Mapping[str, float]
    joint_shifts: Mapping[str, Float]
    joint_sigmas: Mapping[str, Float]
    moved: tuple[float, ...]


def refine(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], config: RefineConfig | None = None,
    tracker: TrackerConfig | None = None, tell: Tell | None = None,
) -> Refined:  # fmt: skip
    """Refine the poses of all frames, segment lengths, girths and joint centres together.

    Args:
        frames: those of the estimates, in order; they are gone through once in every round.
        body, rig: that were tracked with.
        estimates: of the track, one per frame.
        config: settings of the refinement.
        tracker: settings of the cues and of the claimed covariance.
        tell: is told the frames done, the rounds done and how far (m) the last one moved the landmarks.

    Raises:
        InputError: for fewer than three frames, or frames that are not those of the estimates.
    """
    run = _Run(rig.pinhole(), config or RefineConfig(), tracker or TrackerConfig(), tell or (lambda *_: None))
    return run.refined(frames, body, estimates)


class _Run:
    def __init__(self, rig: Rig, config: RefineConfig, tracker: TrackerConfig, tell: Tell) -> None:
        self.rig, self.config, self.tracker, self.tell = rig, config, tracker, tell
        self.contour = tracker.contour
        self.appearance: Appearance | None = None

    def refined(self, frames: Iterable[Frame], body: Body, estimates: Sequence[Estimate]) -> Refined:
        shape = Shape.of(body, girth_groups(body), self.config)
        poses, times = [e.pose for e in estimates], [e.time for e in estimates]
        moved: list[float] = []
        while True:
            n = len(moved)
            coarse = n < self.config.coarse_rounds
            system, energies = self.equations(frames, shape, poses, times, coarse, n)
            solution = system.solve(self.config.damping)
            before = [Posed(shape.body, pose) for pose in poses]
            shape = shape.stepped(np.clip(solution.shared, -0.1, 0.1))
            poses = [self.retracted(body, pose, step) for pose, step in zip(poses, solution.poses, strict=True)]
            moved.append(mean_joint_shift(before, [Posed(shape.body, pose) for pose in poses]))
            self.tell(0, n + 1, moved[-1])
            if n + 1 >= self.config.rounds or (not coarse and moved[-1] < self.config.settled):
                return self.answer(shape, poses, estimates, solution, energies, moved)

    def retracted(self, body: Body, pose: Pose, step: Float) -> Pose:
        """The pose after a step, which no linearisation holds beyond half a radian."""
        return pose.retract(step / max(1.0, 2.0 * float(np.abs(step[6:]).max(initial=0.0))))

    def equations(
        self, frames: Iterable[Frame], shape: Shape, poses: Sequence[Pose], times: Sequence[float], coarse: bool, n: int
    ) -> tuple[Arrow, list[dict[str, float]]]:
        """The normal equations at the present poses and shape; energies by frame."""
        config, motion = self.config, shape.motion()
        reach = max(2, *config.strides)
        system = Arrow(len(poses), shape.body.dof, len(shape.sigma), reach)
        energies: list[dict[str, float]] = [{} for _ in poses]
        recent: list[Instant] = []
        parts = len(shape.body.segment_names)
        known = self.appearance or Appearance(len(self.rig), parts, self.tracker.appearance)
        learnt = Appearance(len(self.rig), parts, replace(self.tracker.appearance, memory=1.0))
        count = 0
        for t, (frame, pose) in enumerate(zip(frames, poses, strict=True)):
            instant = self.looked(frame, t, Posed(shape.body, pose))
            self.add_contours(system, instant, motion, coarse, known, learnt, energies[t])
            for earlier in recent:
                if t - earlier.number in config.strides:
                    blur = blur_of(self.tracker.brightness, coarse)
                    e = add_brightness(system, earlier, instant, motion, self.tracker.brightness, blur, 1.0 / len(config.strides))
                    energies[t]["photometric"] = energies[t].get("photometric", 0.0) + e
            recent = [*recent, instant][-reach:]
            for term in (LimitTerm(), RestTerm(float(np.deg2rad(self.tracker.rest_sigma_deg)))):
                q = term.linearize(instant.posed)
                system.add_pose(t, q.gradient, q.hessian)
                energies[t][term.name] = q.value
            count += 1
            self.tell(t + 1, n, np.nan)
        self.appearance = learnt
        add_accelerations(system, poses, times, config.noise)
        # Images are counted at their own noise, of which the claimed one is a multiple; so must the prior be.
        information = self.tracker.inflation**2 / shape.sigma**2
        system.corner[np.diag_indices(len(information))] += information
        system.shared_pull += information * shape.total
        return system, energies

    def looked(self, frame: Frame, number: int, posed: Posed) -> Instant:
        frame = despeckled(frame, self.tracker.despeckle)
        sights: dict[int, Sight] = {}
        for i, image in enumerate(frame.images):
            view = None if image is None else crop_view(image, self.rig[i], posed, self.tracker.margin, self.tracker.channels)
            if view is not None:
                seen = render(posed, view.camera)
                sights[i] = Sight(view, seen, followed_points(view, seen, self.config.points))
        return Instant(number, posed, sights)

    def add_contours(self, system: Arrow, instant: Instant, motion: RestMotion, coarse: bool, known: Appearance, learnt: Appearance, energies: dict[str, float]) -> None:
        for i, sight in instant.sights.items():
            contour = visible_contour(sight.seen, max(1.0, self.tracker.contour_spacing * sight.seen.px_per_m))
            colours = known.of(i, sight.view.features.shape[2])
            found = self.contour.measure(sight.view, sight.seen, contour, self.config.coarse if coarse else 1.0, colours)
            energies["contour"] = energies.get("contour", 0.0) + add_contour(system, instant, motion, found)
            learnt.learn(i, sight.view, sight.seen, np.ones(len(instant.posed.body.segment_names)), 1)

    def answer(
        self, shape: Shape, poses: Sequence[Pose], estimates: Sequence[Estimate], solution: Solution,
        energies: Sequence[dict[str, float]], moved: Sequence[float],
    ) -> Refined:  # fmt: skip
        scale = self.tracker.inflation**2
        status = "converged" if moved[-1] < self.config.settled else "max_iterations"
        out = tuple(
            replace(e, pose=pose, covariance=scale * covariance, energies=energy, status=status, iterations=len(moved))
            for e, pose, covariance, energy in zip(estimates, poses, solution.covariances, energies, strict=True)
        )
        along, across, joints = shape.parts(shape.total)
        sigma_along, _, sigma_joints = shape.parts(self.tracker.inflation * np.sqrt(np.diagonal(solution.shared_covariance)))
        return Refined(
            shape.body, out, {k: float(np.exp(v)) for k, v in along.items()}, sigma_along,
            {k: float(np.exp(v)) for k, v in across.items()}, joints, sigma_joints, tuple(moved),
        )  # fmt: skip
