"""Refinement of a whole track: look, sum, solve for all frames and the body's shape, and look again.

What Bregler and Malik do to a tracked sequence (CVPR 1998, section 2.5, DOI 10.1109/CVPR.1998.698581), with contours,
perspective and joint centres beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from twistcap._typing import Bool, Float
from twistcap.adjust.first_pose import girth_groups
from twistcap.adjust.refine.common_error import design_effect
from twistcap.adjust.refine.look import Eyes, agreement, support
from twistcap.adjust.refine.problem import RefineProblem, Standing, Track
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.adjust.refine.shape import Shape
from twistcap.body import Body
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.predict.inertia import INFLATION
from twistcap.priors.standing import RestPose
from twistcap.settings import Settings
from twistcap.solve import Arrow, Solution, minimise
from twistcap.track.visibility import SupportRule

_LEAST_FRAMES = 3
_WORSE = 0.01  # fraction of contour points: so many agree or not by chance
_HELD_ROUNDS = (
    6  # at most where joint centres are held: poses and lengths settle sooner (balance_4view: 6, 8, 14 alike)
)


class Tell(Protocol):
    """Is told how far the work is."""

    def __call__(self, note: str, done: int = 0, total: int | None = None) -> None: ...


@dataclass(frozen=True)
class Refined:
    """A refined track.

    Attributes:
        body: with the refined lengths, girths and joint centres.
        estimates: one for each given; their covariances count what is not known of the shape.
        lengths, girths: factor of each group of segments against the body given.
        length_sigmas, girth_sigmas: standard deviations of the factors' logarithms.
        joint_shifts, joint_sigmas: (3,) m in the rest pose and standard deviations, by the segment below the joint.
        moved: m that the landmarks moved in each round, mean over all frames.
        shape: what a refinement of another track with this body goes on from.
        design_effect: by how much contours of one part err together, 1 for not at all; see `common_error`. Beyond
            `RefineConfig.alike` joint centres were held.
        helped: whether the contours agree with the images as well as those of the track given, or better; where they
            do not, that track is what this is.
    """

    body: Body
    estimates: tuple[Estimate, ...]
    lengths: Mapping[str, float]
    length_sigmas: Mapping[str, float]
    girths: Mapping[str, float]
    girth_sigmas: Mapping[str, float]
    joint_shifts: Mapping[str, Float]
    joint_sigmas: Mapping[str, Float]
    moved: tuple[float, ...]
    shape: Shape
    design_effect: float
    helped: bool


def refine(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], config: RefineConfig | None = None,
    tracker: Settings | None = None, tell: Tell | None = None, shape: Shape | None = None,
) -> Refined:  # fmt: skip
    """Refine the poses of all frames, segment lengths, girths and joint centres together.

    A limb that the wrong body has lost is not found again by refining. Track once more with the refined body, and give
    those estimates here with the `shape` found: what is known of the shape beforehand stays that about the first body.

    Args:
        frames: those of the estimates, in order; they are gone through once. What is about the body is kept, some 0.3
            MB for each image at half of full HD.
        body, rig: that were tracked with; of the body, where a `shape` is given, its coordinates alone are looked at.
        estimates: of the track, one per frame.
        config: settings of the refinement.
        tracker: settings of the cues and of the claimed covariance.
        tell: is told how far it is.
        shape: to begin with, that of an earlier refinement; that of `body` by default.

    Raises:
        InputError: for fewer than three frames, frames that are not those of the estimates, poses that are not
            finite, or images that leave a number open.
    """
    config, tracker = config or RefineConfig(), tracker or Settings()
    _check(body, estimates)
    given = Track(tuple(e.pose for e in estimates), shape or Shape.of(body, girth_groups(body), config))
    eyes = Eyes(rig.pinhole(), config, tracker, given.shape.body)
    tell, count = tell or _untold, len(estimates)
    for done in eyes.read(frames, estimates):
        tell("reading", done, count * (1 + config.rounds))
    adjusted = _adjusted(eyes, given, estimates, tell)
    if adjusted.design_effect > config.alike and given.shape.moved:
        given = replace(given, shape=given.shape.without_joints())
        adjusted = _adjusted(eyes, given, estimates, tell)
    all_frames = np.ones(count, dtype=np.bool_)
    before, after = (agreement(eyes.look(x.posed, all_frames, coarse=False)) for x in (given, adjusted.found.x))
    if after < before - _WORSE:
        return _kept(given, estimates, adjusted)
    return _answer(adjusted, estimates, tracker)


@dataclass(frozen=True)
class _Adjusted:
    """How far the rounds have come.

    Attributes:
        found: of the last round; `problem` is what it solved.
        moved: m of the landmarks in each round.
        settled: whether the last moved less than it must.
        design_effect: by which contours err together; 1 where no round was fine.
    """

    found: Solution[Track, Arrow]
    problem: RefineProblem
    moved: tuple[float, ...]
    settled: bool
    design_effect: float


def _adjusted(eyes: Eyes, given: Track, estimates: Sequence[Estimate], tell: Tell) -> _Adjusted:
    """Rounds of looking and solving, until one settles; to the first fine one where contours err together too much."""
    config, x, moved, total = eyes.config, given, list[float](), len(estimates) * (1 + eyes.config.rounds)
    most = config.rounds if given.shape.moved else min(config.rounds, _HELD_ROUNDS)
    inflation, standing = INFLATION**2, _standing(estimates, config)
    trusted = ~_bridged(estimates, config.bridge)
    while True:
        coarse = len(moved) < config.coarse_rounds
        rounds = eyes.look(x.posed, trusted, coarse)
        effect = design_effect(rounds, x.posed, inflation)
        # Images are counted at their own noise, of which the claimed one is a multiple; so must the shape's prior be.
        problem = RefineProblem(x, rounds, replace(standing, shape_weight=effect * inflation))
        found = minimise(problem, x, 1, config.damping)
        moved.append(_mean_move(x, found.x))
        x, trusted = found.x, np.ones(len(estimates), dtype=np.bool_)
        tell(f"round {len(moved)} of at most {most}", len(estimates) * (1 + len(moved)), total)
        settled = not coarse and moved[-1] < config.settled
        together = not coarse and effect > config.alike and bool(given.shape.moved)
        if settled or together or len(moved) >= most:
            return _Adjusted(found, problem, tuple(moved), settled, 1.0 if coarse else effect)


def _untold(note: str, done: int = 0, total: int | None = None) -> None:
    """Nobody is told."""


def _standing(estimates: Sequence[Estimate], config: RefineConfig) -> Standing:
    """What is known without the images."""
    rest = float(np.deg2rad(RestPose().sigma_deg))
    return Standing([e.time for e in estimates], config.noise, rest, config.hinge, 1.0, config.contour)


def _check(body: Body, estimates: Sequence[Estimate]) -> None:
    if len(estimates) < _LEAST_FRAMES:
        raise InputError(f"refine: {len(estimates)} frames are given; it takes at least {_LEAST_FRAMES}.")
    for e in estimates:
        if len(e.pose.q) != len(body.coordinate_names):
            raise InputError(f"refine: frame {e.index} has {len(e.pose.q)} joint coordinates; give the body tracked.")
        if not (np.all(np.isfinite(e.pose.root)) and np.all(np.isfinite(e.pose.q))):
            raise InputError(f"refine: the pose of frame {e.index} is not finite; leave the frame out with --frames.")


def _bridged(estimates: Sequence[Estimate], longest: float) -> Bool:
    """(F,) which frames are lost in spans shorter than so many seconds, with others at both ends."""
    out = np.zeros(len(estimates), dtype=np.bool_)
    kept = [t for t, e in enumerate(estimates) if not e.lost]
    for before, after in pairwise(kept):
        if estimates[after].time - estimates[before].time <= longest:
            out[before + 1 : after] = True
    return out


def _mean_move(before: Track, after: Track) -> float:
    """Mean distance (m) by which the landmarks, or where there are none the segments, moved."""
    old, new = (np.stack([p.landmarks if len(p.landmarks) else p.segment_middles for p in track.posed])
                for track in (before, after))  # fmt: skip
    return float(np.linalg.norm(new - old, axis=2).mean())


def _answer(adjusted: _Adjusted, estimates: Sequence[Estimate], tracker: Settings) -> Refined:
    found, effect = adjusted.found, adjusted.design_effect
    shape, marginals = found.x.shape, found.system.marginals()
    lengths, girths, joints = shape.parts(shape.total)
    # The shape's information was counted `effect` times; its covariance is that much larger.
    sigmas = shape.parts(INFLATION * np.sqrt(effect * np.diagonal(marginals.shared)))
    out = tuple(_judged(adjusted, marginals.poses, estimates, tracker))
    girth, joint = (_exp(girths), sigmas[1]), (joints, sigmas[2])
    return Refined(shape.body, out, _exp(lengths), sigmas[0], *girth, *joint, adjusted.moved, shape, effect, True)


def _kept(given: Track, estimates: Sequence[Estimate], adjusted: _Adjusted) -> Refined:
    """The track as it was."""
    lengths, girths, joints = given.shape.parts(given.shape.total)
    sigma = given.shape.parts(given.shape.sigma)
    girth, joint = (_exp(girths), sigma[1]), (joints, sigma[2])
    found = (adjusted.moved, given.shape, adjusted.design_effect, False)
    return Refined(given.shape.body, tuple(estimates), _exp(lengths), sigma[0], *girth, *joint, *found)


def _judged(
    adjusted: _Adjusted, covariances: Float, estimates: Sequence[Estimate], tracker: Settings
) -> Iterator[Estimate]:
    """The estimates with pose, claimed covariance, energies and support as the last round has them."""
    x, problem = adjusted.found.x, adjusted.problem
    energies: list[dict[str, float]] = [{} for _ in estimates]
    for name, t, value in problem.parts(x):
        energies[t][name] = energies[t].get(name, 0.0) + value
    supported = None if tracker.method == "differential" else support(problem.rounds)
    status = "converged" if adjusted.settled else "max_iterations"
    for t, e in enumerate(estimates):
        own = replace(
            e, pose=x.poses[t], covariance=INFLATION**2 * covariances[t], energies=energies[t],
            iterations=len(adjusted.moved), status=status if e.status != "no_images" else e.status,
        )  # fmt: skip
        if supported is None or e.status == "no_images":  # without contours the tracker's own judgement stands
            yield own
        else:
            yield replace(own, support=float(supported[t]), lost=bool(supported[t] < SupportRule().least))


def _exp(logs: Mapping[str, float]) -> dict[str, float]:
    return {name: float(np.exp(value)) for name, value in logs.items()}
