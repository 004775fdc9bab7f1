"""Refinement of a whole track: measure all images, solve for all poses and the body's shape, and measure again.

Bregler and Malik refine a tracked sequence so (CVPR 1998, section 2.5, DOI 10.1109/CVPR.1998.698581). Contours,
perspective and joint centres are added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from twistcap.adjust.first_pose import girth_groups
from twistcap.adjust.refine.measure import SequenceImages, agreement, design_effect, support
from twistcap.adjust.refine.problem import RefineProblem, Standing, Track
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.adjust.refine.shape import Shape
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.cues.support import SupportRule
from twistcap.errors import InputError, check
from twistcap.estimate import Estimate, Frame
from twistcap.predict.inertia import INFLATION
from twistcap.search.flag import FlagRule, flag_groups, segment_deviations, support_signs
from twistcap.settings import Settings
from twistcap.solve import Arrow, Solution, minimise

_LEAST_FRAMES = 3
_WORSE = 0.01  # fraction of contour points: so many agree or not by chance
_HELD_ROUNDS = 6  # at most where joint centres are held: all else settles sooner (balance_4view: 6 as 14)
_SETTLED = 2.5e-4  # m, mean motion of the landmarks in a round: where it is less, the rounds end
_BRIDGE = 0.2  # s: lost spans that are shorter are bridged by motion alone in the first round
_DAMPING = 1e-3  # fraction by which the diagonal of the equations is raised in each step

# Design effect of the contours beyond which lengths and joint centres are held: where points of one part err together,
# the surface is not the person's, and both would make up for it (the pelvis 6 % longer, the radius 7 % shorter). In the
# studio it is 1.0 to two digits, on `balance_4view` with a fitted body 2.6 of 30 frames and 5 of 100.
_ALIKE = 1.5

Report = Callable[[str, int, int], None]
"""Takes a few words on the work in progress, how much is done, and of how much."""


@dataclass(frozen=True)
class Refined:
    """A refined track.

    Attributes:
        body: with the refined lengths, girths and joint centres.
        estimates: one for each given; their covariances contain the uncertainty of the shape.
        lengths, girths: factor of each group of segments against the body given.
        length_sigmas, girth_sigmas: standard deviations of the factors' logarithms.
        joint_shifts, joint_sigmas: (3,) m in the rest pose and standard deviations, by the segment below the joint.
        moved: m, mean motion of the landmarks in each round, over all frames.
        shape: where a refinement of another track with this body starts.
        design_effect: how far contours of one part err together; beyond `_ALIKE` lengths and joint centres were held.
        helped: whether the contours agree with the images at least as well as before; if not, this is the track given.
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
    tracker: Settings | None = None, report: Report | None = None, shape: Shape | None = None,
) -> Refined:  # fmt: skip
    """Refine the poses of all frames, segment lengths, girths and joint centres together.

    Refining does not recover a limb that was lost with the wrong body. Track again with the refined body and refine
    those estimates with the refined `shape`: the prior of the shape stays about the first body.

    Args:
        frames: those of the estimates, in order; read once, some 0.3 MB are kept of each image at half of full HD.
        body, rig, estimates: of the track; where a `shape` is given, only the coordinates of the body are used.
        config, tracker: settings of the refinement, and of cues and claimed covariance.
        report: is called with the progress.
        shape: to begin with, that of an earlier refinement; by default that of `body`.

    Raises InputError for fewer than three frames, frames that are not those of the estimates, poses that are not
    finite, or images that do not determine a number.
    """
    config, tracker = config or RefineConfig(), tracker or Settings()
    _check(body, estimates)
    given = Track(tuple(e.pose for e in estimates), shape or Shape.of(body, girth_groups(body), config))
    images = SequenceImages(rig.pinhole(), config, tracker, given.shape.body)
    report, count = report or (lambda note, done, total: None), len(estimates)
    for done in images.read(frames, estimates):
        report("reading", done, count * (1 + config.rounds))
    adjusted = _adjusted(images, given, estimates, report)
    if adjusted.design_effect > _ALIKE and given.shape.places_joints:
        given = replace(given, shape=given.shape.girths_alone())
        adjusted = _adjusted(images, given, estimates, report)
    all_frames = np.ones(count, dtype=np.bool_)
    before, after = (agreement(images.measure(x.posed, all_frames, coarse=False)) for x in (given, adjusted.solution.x))
    if after < before - _WORSE:
        return _refined(given.shape, given.shape.sigma, estimates, adjusted, False)
    return _answer(adjusted, estimates, tracker)


@dataclass(frozen=True)
class _Adjusted:
    """The last round, whether it moved less than `_SETTLED`, and m moved in each; effect 1 where no round was fine."""

    solution: Solution[Track, Arrow]
    problem: RefineProblem
    moved: tuple[float, ...]
    settled: bool
    design_effect: float


def _adjusted(images: SequenceImages, given: Track, estimates: Sequence[Estimate], report: Report) -> _Adjusted:
    """Rounds until one settles; only to the first fine round where contours err together too much."""
    config, x, moved, total = images.config, given, list[float](), len(estimates) * (1 + images.config.rounds)
    most = config.rounds if given.shape.moved else min(config.rounds, _HELD_ROUNDS)
    inflation, times, trusted = INFLATION**2, [e.time for e in estimates], ~_bridged(estimates)
    while True:
        coarse = len(moved) < config.coarse_rounds
        rounds = images.measure(x.posed, trusted, coarse)
        effect = design_effect(rounds, x.posed, inflation)
        # Images are counted at their own noise, of which the claimed one is a multiple; so must the shape's prior be.
        standing = Standing(times, config.hinge, effect * inflation, config.contour)
        problem = RefineProblem(x, rounds, standing)
        solution = minimise(problem, x, 1, _DAMPING)
        moved.append(_mean_move(x, solution.x))
        x, trusted = solution.x, np.ones(len(estimates), dtype=np.bool_)
        report(f"round {len(moved)} of at most {most}", len(estimates) * (1 + len(moved)), total)
        settled = not coarse and moved[-1] < _SETTLED
        together = not coarse and effect > _ALIKE and given.shape.places_joints
        if settled or together or len(moved) >= most:
            return _Adjusted(solution, problem, tuple(moved), settled, 1.0 if coarse else effect)


def _check(body: Body, estimates: Sequence[Estimate]) -> None:
    given = len(estimates)
    check("refine", given >= _LEAST_FRAMES, f"{given} frames are given; give at least {_LEAST_FRAMES}")
    for e in estimates:
        if len(e.pose.q) != len(body.coordinate_names):
            raise InputError(f"refine: frame {e.index} has {len(e.pose.q)} joint coordinates; give the body tracked.")
        if not (np.all(np.isfinite(e.pose.root)) and np.all(np.isfinite(e.pose.q))):
            raise InputError(f"refine: the pose of frame {e.index} is not finite; leave the frame out with --frames.")


def _bridged(estimates: Sequence[Estimate]) -> Bool:
    """(F,) whether a frame is in a lost span of at most `_BRIDGE` seconds between tracked frames."""
    out = np.zeros(len(estimates), dtype=np.bool_)
    kept = [t for t, e in enumerate(estimates) if not e.lost]
    for before, after in pairwise(kept):
        if estimates[after].time - estimates[before].time <= _BRIDGE:
            out[before + 1 : after] = True
    return out


def _mean_move(before: Track, after: Track) -> float:
    """Mean distance (m) by which the landmarks, or where there are none the segments, moved."""
    old, new = (np.stack([p.landmarks if len(p.landmarks) else p.segment_middles for p in track.posed])
                for track in (before, after))  # fmt: skip
    return float(np.linalg.norm(new - old, axis=2).mean())


def _answer(adjusted: _Adjusted, estimates: Sequence[Estimate], tracker: Settings) -> Refined:
    solution, effect = adjusted.solution, adjusted.design_effect
    shape, marginals = solution.x.shape, solution.system.marginals()
    # The shape's information was counted `effect` times; its covariance is that much larger.
    sigma = INFLATION * np.sqrt(effect * np.diagonal(marginals.shared))
    return _refined(shape, sigma, _estimates(adjusted, marginals.poses, estimates, tracker), adjusted, True)


def _refined(shape: Shape, sigma: Float, estimates: Iterable[Estimate], adjusted: _Adjusted, helped: bool) -> Refined:
    """With a shape and standard deviations of its parameters (K,)."""
    *logs, joints = shape.parts(shape.total)
    lengths, girths = ({name: float(np.exp(value)) for name, value in log.items()} for log in logs)
    by_length, by_girth, by_joint = shape.parts(sigma)
    out = tuple(estimates), lengths, by_length, girths, by_girth, joints, by_joint
    return Refined(shape.body, *out, adjusted.moved, shape, adjusted.design_effect, helped)


def _estimates(
    adjusted: _Adjusted, covariances: Float, estimates: Sequence[Estimate], tracker: Settings
) -> Iterator[Estimate]:
    """The estimates with pose, claimed covariance, energies and support of the last round."""
    x, problem = adjusted.solution.x, adjusted.problem
    energies: list[dict[str, float]] = [{} for _ in estimates]
    for name, t, value in problem.parts(x):
        energies[t][name] = energies[t].get(name, 0.0) + value
    supported = None if tracker.method == "differential" else support(problem.rounds)
    status = "converged" if adjusted.settled else "max_iterations"
    for t, e in enumerate(estimates):
        own = replace(
            e, pose=x.poses[t], covariance=INFLATION**2 * covariances[t], energies=energies[t],
            iterations=len(adjusted.moved), status=status if e.seen else e.status,
        )  # fmt: skip
        if supported is None or not e.seen:  # without contours the tracker's own support stays
            yield own
        else:
            yield with_support(own, x.posed[t], supported[t])


def with_support(estimate: Estimate, posed: Posed, support: Float) -> Estimate:
    """With the support (S,) of its parts. What the tracker lost stays lost, unless the contours agree so well by now
    that they alone do not make a loss probable. One camera alone is not enough for that."""
    least, flag = float(support.min()), FlagRule()
    own = replace(estimate, support=least, lost=estimate.lost or least < SupportRule().least)
    if not estimate.lost or least < SupportRule().sure or estimate.single_view:
        return own
    groups, deviations = flag_groups(posed.body), segment_deviations(posed, estimate.covariance)
    signs, farthest = support_signs(groups, support), np.array([deviations[group].max() for group in groups])
    limbs = flag.limbs(signs, signs, farthest)
    probability = flag.whole(limbs)
    return replace(own, probability=probability, part_probability=limbs @ groups, lost=probability >= flag.lost)
