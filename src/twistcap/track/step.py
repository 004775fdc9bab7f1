"""One frame: (state, frame, model) to (state, estimate). Nothing is changed in place."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, overload

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Posed
from twistcap.cues.observation import Fit
from twistcap.cues.view import despeckled, steadied, with_news
from twistcap.differential.model import DifferentialModel
from twistcap.differential.state import Track
from twistcap.differential.step import step as by_brightness
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.predict import Prediction
from twistcap.predict.claims import with_information
from twistcap.predict.history import Moment, jumped
from twistcap.search import with_cameras
from twistcap.search.flag import flag_groups, judged, segment_deviations, support_signs
from twistcap.search.memory import LostMemory
from twistcap.solve import inverse
from twistcap.stages import stage
from twistcap.threads import ahead
from twistcap.track.align import FrameProblem, align
from twistcap.track.model import Model
from twistcap.track.state import State

_log = logging.getLogger(__name__)


@overload
def step(state: State, frame: Frame, model: Model) -> tuple[State, Estimate]: ...
@overload
def step(state: Track, frame: Frame, model: DifferentialModel) -> tuple[Track, Estimate]: ...
def step(state: Any, frame: Frame, model: Model | DifferentialModel) -> tuple[Any, Estimate]:
    """Track one frame. Where its numbers cannot be computed, it has failed: it is lost, as if it had no image. Raises
    InputError for an image with a value that is not finite.
    """
    try:
        return _stepped(state, frame, model)
    except InputError:
        raise
    except (ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError
        _log.warning("frame %d failed (%s: %s); the pose is predicted.", frame.index, type(error).__name__, error)
    if isinstance(model, Model):
        model = replace(model, predictors=model.predictors[-1:])  # it always answers; another may be what failed
    after, blind = _stepped(state, replace(frame, images=(None,) * len(frame.images), keypoints=None), model)
    gone = frame.sorted_by(blind.sources).missing
    return after, replace(blind, status="failed", lost=True, support=0.0, missing=gone)


def _stepped(state: Any, frame: Frame, model: Model | DifferentialModel) -> tuple[Any, Estimate]:
    if isinstance(model, DifferentialModel):
        return by_brightness(state, frame, model)
    frame, prints = with_news(frame, state.prints, state.past.in_motion)
    frame = steadied(frame.sorted_by(state.sources), state.bumps, model.rig)
    frame, state = despeckled(frame), replace(state, prints=prints)
    prediction, state = predicted(state, frame, model)
    problem, nowhere = begun(posed_problem(state, frame, model, prediction), prediction)
    if nowhere or (not problem.views and frame.keypoints is None):
        return unseen(problem, prediction, gone=nowhere)
    fit = align(problem)
    if prediction.name == "motion" and frame.keypoints is None:
        problem = doubted(problem, fit)
        if not problem.trusted and problem.start is not prediction.pose:  # what a search finds in noise is no body
            fit = align(problem := replace(problem.at(prediction.pose), information=prediction.information))
            problem = doubted(problem, fit)
        if problem.trust == 0.0:
            return unseen(problem, prediction)
        fit = fit if problem.trusted else align(problem)
    problem, fit, jump = searched(problem, fit)
    if fit is None:
        return unseen(problem, prediction, gone=True)
    return learned(problem, fit, prediction, jump)


def predicted(state: State, frame: Frame, model: Model) -> tuple[Prediction, State]:
    """What the first predictor that answers expects."""
    memories = dict(state.predictors)
    for predictor in model.predictors:
        found, memories[predictor.name] = predictor.predict(memories[predictor.name], state.past, frame)
        if found is not None:
            return found, replace(state, predictors=memories)
    raise ValueError("model: the last predictor must always answer.")


def posed_problem(state: State, frame: Frame, model: Model, prediction: Prediction) -> FrameProblem:
    """The frame as a problem, with the images about the expected body."""
    left_out = frozenset(state.left_out)
    views = model.views(frame, prediction.pose, left_out=left_out)
    ahead(lambda: [(view.grey, view.features) for view in list(views.values())[::-1]])
    return FrameProblem(
        model, state, frame, prediction.pose, prediction.covariance, prediction.information, views, left_out=left_out
    )


def begun(problem: FrameProblem, prediction: Prediction) -> tuple[FrameProblem, bool]:
    """The problem, starting where a search has found the body; and whether it was found nowhere."""
    memories, beginning = dict(problem.state.searches), None
    for search in problem.model.searches if any(image is not None for image in problem.frame.images) else ():
        beginning, memories[search.name] = search.begin(memories[search.name], problem)
        if beginning is not None:
            break
    problem = replace(problem, state=replace(problem.state, searches=memories))
    if beginning is not None:
        problem = with_cameras(problem, beginning)
    if beginning is None or (prediction.name == "motion" and beginning.pose is None):
        return problem, False
    if beginning.pose is None:
        return problem, True
    found, pose = problem.at(beginning.pose), beginning.pose
    if prediction.name == "motion":  # which bridges the gap itself
        return found, False
    last = jumped(problem.past.moments[-1], pose.minus(problem.start), pose)  # a jump is no velocity
    return replace(found, state=found.state.with_past(found.past.with_last(last))), False


def doubted(problem: FrameProblem, fit: Fit) -> FrameProblem:
    """The problem with images believed as far as the body agrees with them; the prediction counts for more instead."""
    trust = problem.model.support.trust(fit.agreement)
    return replace(problem, trust=trust, information=problem.information / (trust or 1.0))


def searched(problem: FrameProblem, fit: Fit) -> tuple[FrameProblem, Fit | None, bool]:
    """The best of the fit and what the searches find, None if that is nowhere; and whether it has jumped there."""
    memories, jump, found = dict(problem.state.searches), False, fit
    for search in problem.model.searches:
        with stage("search"):
            revision, memories[search.name] = search.revise(memories[search.name], problem, fit)
        if revision is not None:
            found, jump = revision.fit, jump or revision.jumped
            problem = replace(problem, state=problem.state.with_past(problem.past.with_last(revision.last)))
            problem = problem.without_look() if revision.relit else problem
            problem = with_cameras(problem, revision)
            problem = problem if revision.left_out is None else problem.excluding(revision.left_out)
        if found is None:
            break
        fit = found
    return replace(problem, state=replace(problem.state, searches=memories)), found, jump


def learned(problem: FrameProblem, fit: Fit, prediction: Prediction, jump: bool) -> tuple[State, Estimate]:
    """The state after a frame, and its estimate."""
    model, state, frame = problem.model, problem.state, problem.frame
    lesson = model.learn_every if state.learned % model.learn_every == 0 else 0
    posterior, claimed = problem.uncertainty.after(fit, problem.trust)
    with stage("remember"):
        cues = {cue.name: cue.learn(state.cues[cue.name], fit, lesson) for cue in model.cues}
    past = state.past.tracked(prediction.pose, prediction.name, Moment(frame.time, fit.pose), jump)
    predictors = {p.name: p.learn(state.predictors[p.name], fit, past, frame) for p in model.predictors}
    support = problem.support(fit)
    after = State(
        past, posterior, claimed, support, _occluded(model, fit), tuple(sorted(problem.left_out)), state.bumps,
        frame.sources, state.prints, state.learned + 1, cues, predictors, state.searches
    )  # fmt: skip
    claims, least = _with_priors(model, fit.posed, claimed), float(support.min())
    by_part, probability = _loss(after, model, fit)
    return after, Estimate(
        frame.index, frame.time, fit.pose, claims, fit.energies, fit.status, fit.steps,
        probability >= model.flag.lost, least, prediction.name, probability, by_part, after.left_out, frame.missing,
        after.bumps, frame.sources, problem.relit, frame.brightness,
    )  # fmt: skip


def _loss(state: State, model: Model, fit: Fit) -> tuple[Float, float]:
    """(S,) probability that each part is lost, NaN in limbs that are not judged, and that any other limb is.

    It goes by the tracker's own covariance: what is claimed grows where a body does not fit, and a fit may be poor and
    not lost.
    """
    memory = next((m for m in state.searches.values() if isinstance(m, LostMemory)), None)
    groups = flag_groups(model.body) if memory is None else memory.groups
    if memory is None or memory.signs is None or memory.lately is None:
        signs = lately = support_signs(groups, state.support)
    else:
        signs, lately = memory.signs, memory.lately
    deviation = segment_deviations(fit.posed, state.covariance)
    limbs = model.flag.limbs(signs, lately, np.array([deviation[group].max() for group in groups]))
    lost = limbs >= model.flag.lost
    shown = fit.shown if lost.any() else np.zeros(groups.shape[1], np.bool_)  # needed of lost limbs alone; takes time
    said = judged(groups, model.body, fit.agreement, shown, lost)
    return np.where(said, limbs, np.nan)[groups.argmax(axis=0)], model.flag.whole(limbs[said], signs)


def _with_priors(model: Model, posed: Posed, known: Float) -> Float:
    """A covariance (6 + J, 6 + J) with what the priors claim of a pose."""
    claims = [claim for prior in model.priors if (claim := prior.claimed(posed)) is not None]
    return known if not claims or (information := inverse(known)) is None else with_information(information, claims)


def _occluded(model: Model, fit: Fit) -> Bool:
    """(S,) parts that no view shows now."""
    before, rule = fit.visibility.occluded, model.occlusion
    return before if rule is None else before | rule.now_occluded(before, fit.agreement, model.body)


def unseen(problem: FrameProblem, prediction: Prediction, gone: bool = False) -> tuple[State, Estimate]:
    """A frame that shows nothing: the estimate is the prediction; of a body that its images do not show, the last pose,
    unless other people's motion tells more. It is `gone` where it has been looked for in them: then no camera knows
    better than another, and all are believed again.
    """
    model, frame = problem.model, problem.frame
    blind = all(image is None for image in frame.images)
    pose = prediction.pose if blind or prediction.name == "motion" else problem.past.last
    after = problem.state.with_past(problem.past.advanced(Moment(frame.time, pose, seen=False)))
    after = replace(after, sources=frame.sources, left_out=() if gone else tuple(sorted(problem.left_out)))
    claimed = problem.state.claimed + problem.process_noise
    farthest = float(segment_deviations(Posed(model.body, pose), claimed).max())
    probability = model.flag.blind(frame.time - problem.past.seen_time, farthest, gone)
    status = "no_images" if blind else "not_found"
    return after, Estimate(
        frame.index, frame.time, pose, claimed, {}, status, 0,
        probability >= model.flag.lost, 0.0, prediction.name, probability, None, after.left_out, frame.missing,
        after.bumps, frame.sources, brightness=frame.brightness,
    )  # fmt: skip
