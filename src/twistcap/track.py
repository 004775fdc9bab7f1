"""The tracker: one frame after the other, predict, then alternate correspond and update.

ARCHITECTURE.md walks through one frame; the settings of each cue stand with the cue.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from twistcap._typing import Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.appearance import Appearance
from twistcap.cues.evidence import ContourEvidence
from twistcap.cues.flow import Followed
from twistcap.cues.limbs import LimbSearch
from twistcap.cues.memory import Memory
from twistcap.cues.reacquire import ReacquireRule
from twistcap.cues.rivals import Judge, Rivals
from twistcap.cues.sight import Fit, Sight, contour_moved
from twistcap.cues.support import part_tally, summed
from twistcap.cues.view import View, crop_view, despeckled
from twistcap.estimate import Estimate, Frame
from twistcap.motion import MotionLibrary
from twistcap.predict import Leeway, Moment, MotionNoise, PredictorName, jumped, predict, rested
from twistcap.priors import ParzenPrior, PriorTerm, matched
from twistcap.render import render, reprojected, visible_contour
from twistcap.settings import TrackerConfig
from twistcap.solve import SolveResult, covariance, energies_at, inverse, least_squares
from twistcap.stages import next_frame, stage
from twistcap.terms import GaussianTerm, LimitTerm, Quadratic, RestTerm, Term

_REMEMBERED = 128  # moments of the history


class Tracker:
    """Follows one body through a recording; `step` once per frame, in order."""

    def __init__(
        self, body: Body, rig: Rig, config: TrackerConfig | None = None, prior: ParzenPrior | None = None,
        motions: MotionLibrary | None = None,
    ) -> None:  # fmt: skip
        self.body, self.rig, self.config = body, rig.pinhole(), config or TrackerConfig()
        self._given_rig = rig  # keypoints come in its pixels, images rectified
        self._contour = self.config.contour
        self._rest = RestTerm(float(np.deg2rad(self.config.rest_sigma_deg)))
        self._motions = self.config.motion_from(motions, body)
        self._prior = None if prior is None else matched(prior, body)
        self._yields = prior is not None or self.config.hidden.alone
        self._reset()

    def _reset(self) -> None:
        parts, views, config = len(self.body.segment_names), len(self.rig), self.config
        self._history: list[Moment] = []
        self._seen_time = 0.0
        self._started = False
        self._frames = 0  # remembered since the start
        self._covariance = np.zeros((self.body.dof, self.body.dof))  # of what images and motion tell; no prior in it
        self._leeway = Leeway(config.noise, self.body.dof)
        self._templates: list[Memory | None] = [None] * views
        self._appearance = Appearance(views, parts, config.appearance)
        self._colours: dict[int, Float] = {}  # of this frame's views
        self._last: Followed | None = None
        self._support = np.ones(parts)
        self._gone = np.zeros(parts, dtype=np.bool_)  # parts that no view shows
        self._back = np.zeros_like(self._gone)  # those of which a view shows something again, in this frame
        self._rivals = Rivals(self.body, config.rivals)
        self._limbs = None if config.limbs is None else LimbSearch(self.body, config.limbs)

    def start(self, pose: Pose, time: float = 0.0) -> None:
        """Take the pose from which the first frame is tracked."""
        self._reset()
        self._history, self._seen_time = [Moment(time, pose)], time

    def restore(self, estimates: Sequence[Estimate]) -> None:
        """Go on after a track's last estimate, as `--resume` does; brightness and colours are learnt anew."""
        last = estimates[-1]
        self.start(last.pose, last.time)
        self._history = [Moment(e.time, e.pose, e.status != "no_images") for e in estimates[-_REMEMBERED:]]
        self._covariance = last.covariance
        self._started = True

    def step(self, frame: Frame) -> Estimate:
        """Track one frame."""
        next_frame()
        config = self.config
        frame = despeckled(frame, config.despeckle)
        self._back[:] = False
        guess, predicted, strayed, information = self._predicted(frame)
        posed = Posed(self.body, guess)
        found = self._keypoints(frame, posed)
        rule = config.seeking(frame.time - self._seen_time) if self._started else None
        views = self._views(frame, posed, rule.margin if rule else config.margin)
        if not views and not found:
            return self._unseen(frame, guess, strayed, predicted)
        self._colours = {i: self._appearance.of(i, view.features.shape[2]) for i, view in views.items()}
        if rule is not None and views:
            posed = self._sought(rule, posed, views, self._covariance + strayed)
            if self._motions is None:  # which bridges the gap itself; a jump is no velocity
                self._history[-1] = jumped(self._history[-1], posed.pose.minus(guess), posed.pose)
        fit, trust = self._fit(posed, views, self._fixed(posed.pose, information, found)), 1.0
        if predicted == "motion" and not found and (trust := config.support.trust(fit.tallies)) < 1.0:
            if trust == 0.0:
                return self._unseen(frame, guess, strayed, predicted)
            information = information / trust
            fit = self._fit(posed, views, self._fixed(posed.pose, information))
        if self._limbs is not None and self._started and views and trust == 1.0:  # noise shows limbs anywhere
            fit = self._limbs_sought(self._limbs, fit, frame, guess, information, found)
        told = self._claimed(fit, strayed, information, trust)
        with stage("rivals"):
            rival = self._rival(fit, self._familiar(told, fit), information, found)
        if rival is not None:
            jump = rival.result.pose.minus(fit.result.pose)
            self._history[-1] = jumped(self._history[-1], jump, rival.result.pose)
            fit, told = rival, self._claimed(rival, strayed, information, trust)
        elif self._started and predicted != "motion":
            self._leeway.learn(guess, fit.result.pose, *self._since(frame.time))
        self._covariance = told
        with stage("remember"):
            self._remember(fit)
        self._advance(frame.time, fit.result.pose)
        self._seen_time = frame.time
        self._last = Followed(fit.result.posed, frame.time, frame.images)
        support = float(self._support.min())
        return Estimate(
            frame.index, frame.time, fit.result.pose, self._familiar(told, fit), fit.result.energies,
            fit.result.status, fit.result.steps, support < config.support.least_share, support, predicted,
        )  # fmt: skip

    def _unseen(self, frame: Frame, guess: Pose, strayed: Float, predicted: PredictorName) -> Estimate:
        """The estimate of a frame that shows nothing: the prediction."""
        self._advance(frame.time, guess, seen=False)
        claimed = self._covariance + strayed
        return Estimate(frame.index, frame.time, guess, claimed, {}, "no_images", support=0.0, predicted=predicted)

    def _predicted(self, frame: Frame) -> tuple[Pose, PredictorName, Float, Float]:
        """The expected pose, what told it, the covariance that is claimed of the step from it, and the solve's inverse.

        Training motion or optic flow tell it where they are asked for and can be trusted, else the history does.
        """
        config, history = self.config, self._history
        if self._motions is not None and self._started and sum(moment.seen for moment in history) > 1:
            with stage("motion"):
                told = self._motions.predict(history, frame.time)
            name = "constant_velocity" if told.match is None else "motion"
            return told.pose, name, told.covariance, told.information
        moving = len(history) > 1 and config.predictor != "hold"
        guess = predict(history, frame.time, config.predictor, config.decay)
        base: PredictorName = "constant_velocity" if moving else "hold"
        flowed = None
        if self._last is not None and (
            config.predictor == "flow" or (config.start_by_flow and config.predictor != "hold" and not moving)
        ):
            dt = frame.time - self._last.time
            _, information = config.noise.covariance(self.body.dof, dt, "hold", guess.root[:3, 3])
            with stage("flow"):
                flowed = config.flow.predict(self._last, frame.images, self.rig, guess, information)
        pose = guess if flowed is None else flowed
        expected, information = self._expected(pose, frame.time)
        return pose, base if flowed is None else "flow", config.inflation**2 * expected, information

    def _fit(self, guess: Posed, views: dict[int, View], fixed: Sequence[Term]) -> Fit:
        """Alternate correspond and update: fine where the prediction was good, else coarse until it settles."""
        config = self.config
        fit = Fit(SolveResult(guess, "max_iterations", 0, {}, Quadratic.zero(self.body.dof)))
        fine = config.first_iterations
        if self._started:
            fit, fine = self._alternate(fit, views, fixed, coarse=False), self._contour.alternations - 1
        returning = self._returning(fit)
        if not self._started or returning or fit.moved > config.surprise or self._slipping(fit):
            for _ in range(config.coarse_rounds):
                fit = self._alternate(fit, views, fixed, coarse=True)
                if fit.moved <= config.settled:
                    break
            fine = self._contour.alternations if self._started else config.first_iterations
        for _ in range(fine):
            fit = self._alternate(fit, views, fixed, coarse=False)
        return fit.judged(config.settled)

    def _slipping(self, fit: Fit) -> bool:
        """Whether a part's contour agrees with the images much less than it used to."""
        slip = self._contour.slip
        if slip == 0.0:
            return False
        good, seen = summed(fit.tallies, len(self._support))
        return bool(np.any((seen >= self.config.support.least_points) & (good < slip * self._support * seen)))

    def _returning(self, fit: Fit) -> bool:
        """Whether parts that were gone are seen again; they may have been carried off their place meanwhile."""
        if not self._gone.any():
            return False
        gone = self.config.hidden.now_gone(self._gone, fit.found, self.body)
        self._back, self._gone = self._gone & ~gone, gone
        return bool(self._back.any())

    def _rival(self, fit: Fit, claimed: Float, information: Float, found: Sequence[Term]) -> Fit | None:
        """A fit elsewhere that explains the images clearly better than `fit` does, where a limb is in doubt."""
        config, posed, views = self.config, fit.result.posed, {s.camera_index: s.view for s in fit.sights}
        shown = config.hidden.trust(fit.found, self._gone) if self._yields else 1.0
        poses = self._rivals.poses(posed, claimed, shown) if self._started and views else []
        if not poses:
            return None
        judge = self._judge(views, posed)
        evidence = [judge.evidence(pose) for pose in poses]
        if max(evidence) < config.rivals.promising:
            return None
        best = Posed(self.body, poses[int(np.argmax(evidence))])
        fixed = self._fixed(best.pose, information, found)
        other = self._fit(best, views, fixed)
        fitted = judge.evidence(other.result.pose)
        if fitted < max(evidence):  # the fit has lost it again: the images' judgement stands
            energies = energies_at([*fixed, *other.terms], best)
            other = replace(other, result=replace(other.result, posed=best, energies=energies))
        return other if self._rivals.takes_over(posed, other.result.pose, max(fitted, *evidence)) else None

    def _alternate(self, fit: Fit, views: dict[int, View], fixed: Sequence[Term], coarse: bool) -> Fit:
        """One alternation; the body is rendered anew where it has moved, else its contour is carried along."""
        config, posed = self.config, fit.result.posed
        again = not fit.sights or fit.strayed > config.render_after
        if again:
            sights = [self._look(posed, camera, view) for camera, view in views.items()]
        else:
            sights = [replace(s, contour=reprojected(s.contour, posed, s.view.camera.P)) for s in fit.sights]
        earlier = [None] * len(sights) if again else fit.found
        evidence = [self._evidence(s, coarse, found) for s, found in zip(sights, earlier, strict=True)]
        terms = [term for by_view, _ in evidence for term in by_view]
        if self._prior is not None:
            terms.append(self._familiarity(self._prior, posed, [found for _, found in evidence]))
        with stage("solve"):
            result = least_squares(posed, [*fixed, *terms], steps=config.solver_steps)
        moved = contour_moved(sights, result.posed)
        result = replace(result, steps=fit.result.steps + result.steps)
        strayed = moved if again else fit.strayed + moved
        parts, rule = len(self._support), config.support
        found = [found for _, found in evidence]
        tallies = [part_tally(e, s.view.camera.K[0, 0], parts, rule) for s, e in zip(sights, found, strict=True)]
        return Fit(result, sights, terms, found, tallies, moved, strayed)

    def _familiarity(self, prior: PriorTerm, posed: Posed, found: Sequence[ContourEvidence]) -> PriorTerm:
        """The pose prior beside what the images show: how much it counts, and by which joints it knows the pose."""
        rule, hidden = self.config.prior, self.config.hidden
        points = sum(len(one.contour.part) for one in found)
        term = prior.weighted(rule, points, hidden.concealed(found, self._gone))
        return term.told_by(hidden.known(found, self._gone, self.body), rule, posed)

    def _look(self, posed: Posed, camera_index: int, view: View) -> Sight:
        with stage("render"):
            seen = render(posed, view.camera)
        with stage("contour"):
            spacing = max(1.0, self.config.contour_spacing * seen.px_per_m)
            return Sight(camera_index, view, seen, visible_contour(seen, spacing))

    def _evidence(
        self, sight: Sight, coarse: bool, earlier: ContourEvidence | None
    ) -> tuple[list[Term], ContourEvidence]:
        """Terms of one camera: its contour, and the brightness of what it saw in the frame before."""
        config = self.config
        with stage("statistics"):
            wide, colours = config.coarse if coarse else 1.0, self._colours[sight.camera_index]
            found = self._contour.measure(sight.view, sight.seen, sight.contour, wide, colours, earlier)
        terms: list[Term] = [found.term]
        template = self._templates[sight.camera_index]
        if config.photometric and template is not None:
            level = 0 if coarse else len(config.brightness.blurs) - 1
            with stage("photometric"):
                terms.append(config.brightness.term(sight.view, sight.seen, template, level))
        return (config.hidden.yielded(terms, found, self._gone, self._back) if self._yields else terms), found

    def _expected(self, guess: Pose, time: float) -> tuple[Float, Float]:
        """Covariance of the prediction, or of the given first pose, and its inverse."""
        config, centre = self.config, guess.root[:3, 3]
        if not self._started:
            turn = float(np.deg2rad(config.first_sigma_deg))
            given = MotionNoise(joint_speed=turn, turn_speed=turn, shift_speed=config.first_sigma_m)
            return given.covariance(self.body.dof, 1.0, "hold", centre)
        return self._leeway.covariance(*self._since(time), centre)  # open-loop through dropped frames

    def _since(self, time: float) -> tuple[float, PredictorName]:
        """Seconds over which the next prediction runs, and by what; one pose alone has no velocity."""
        return time - self._seen_time, self.config.predictor if len(self._history) > 1 else "hold"

    def _sought(self, rule: ReacquireRule, guess: Posed, views: dict[int, View], strayed: Float) -> Posed:
        """Where the images show the body after a gap."""
        judge = self._judge(views, guess)
        last = [moment.pose for moment in self._history if moment.seen][-1:]
        with stage("reacquire"):
            return Posed(self.body, rule.sought(judge, guess.pose, strayed, last))

    def _limbs_sought(
        self, search: LimbSearch, fit: Fit, frame: Frame, guess: Pose, information: Float, found: Sequence[Term]
    ) -> Fit:
        """The fit, or one with limbs elsewhere where those that slipped off the images are found there."""
        if not search.slipped(fit.tallies):
            return fit
        gone, back = self._gone, self._back
        with stage("limbs"):
            judge = self._judge(self._known(frame, fit.result.posed, search.rule.margin), fit.result.posed)
            pose, limbs = search.sought(judge, fit.result.pose, (guess, self._history[-1].pose))
            if not limbs:
                return fit
            views = self._known(frame, posed := Posed(self.body, pose), self.config.margin)
            other = self._fit(posed, views, self._fixed(pose, information, found))
        if search.borne_out(judge, limbs, fit, other):
            self._history[-1] = rested(self._history[-1], other.result.pose, search.regained(limbs))
            return other
        self._gone, self._back = gone, back
        return fit

    def _known(self, frame: Frame, posed: Posed, margin: float) -> dict[int, View]:
        """The views whose colours were asked for in this frame, about another body."""
        return {i: view for i, view in self._views(frame, posed, margin).items() if i in self._colours}

    def _judge(self, views: dict[int, View], posed: Posed) -> Judge:
        return self._rivals.judge(list(views.values()), [self._colours[i] for i in views], posed)

    def _fixed(self, expected: Pose, information: Float, found: Sequence[Term] = ()) -> tuple[Term, ...]:
        """What is known without contours: limits, the rest pose, the prediction, keypoints."""
        return LimitTerm(), self._rest, GaussianTerm(expected, information), *found

    def _views(self, frame: Frame, guess: Posed, margin: float) -> dict[int, View]:
        views: dict[int, View] = {}
        for i, image in enumerate(frame.images):
            if image is None:
                continue
            view = crop_view(image, self.rig[i], guess, margin, self.config.channels)
            if view is not None:
                views[i] = view
        return views

    def _keypoints(self, frame: Frame, guess: Posed) -> Sequence[Term]:
        if frame.keypoints is None:
            return ()
        return self.config.keypoints.terms(frame.keypoints, self._given_rig, guess)

    def _remember(self, fit: Fit) -> None:
        """Learn from the settled frame: brightness of the surface, colours of the parts, and how well they agree."""
        rule, cue = self.config.support, self.config.brightness
        every = self.config.learn_every
        lesson, self._frames = self._frames % every == 0, self._frames + 1
        for sight, (good, points) in zip(fit.sights, fit.tallies, strict=True):
            i = sight.camera_index
            if self.config.photometric:
                self._templates[i] = cue.remember(sight.view, sight.seen, fit.result.posed, self._templates[i], lesson)
            if lesson:
                self._appearance.learn(i, sight.view, sight.seen, good / np.maximum(points, 1), every)
        good, seen = summed(fit.tallies, len(self._support))
        if self._yields:
            self._gone |= self.config.hidden.now_gone(self._gone, fit.found, self.body)
        judged = seen >= rule.least_points  # a part that is hardly seen keeps the support it had
        self._support[judged] *= rule.memory
        self._support[judged] += (1.0 - rule.memory) * good[judged] / seen[judged]

    def _advance(self, time: float, pose: Pose, seen: bool = True) -> None:
        if not self._started:
            self._history = []
        self._history = [*self._history, Moment(time, pose, seen)][-_REMEMBERED:]
        self._started = True

    def _claimed(self, fit: Fit, strayed: Float, information: Float, trust: float) -> Float:
        """Covariance of the answer: what this frame's images add to what was known, as a Kalman filter would have it.

        A limb that nothing shows grows less certain from frame to frame. Where the solve failed, only that happens.
        """
        scale = self.config.inflation**2 / trust
        before = self._covariance + strayed
        if fit.result.status == "failed":
            return before
        # The solve held the prediction against its own spread alone; put the uncertainty of the past in its place.
        # What a pose prior says is no news of this frame: taken in anew in every frame it would add up.
        of_images = fit.result.quadratic.hessian - information
        of_images -= sum(term.hessian(self.body.dof) for term in fit.terms if isinstance(term, PriorTerm))
        known, zero = inverse(before), np.zeros(self.body.dof)
        return before if known is None else covariance(Quadratic(0.0, zero, of_images / scale + known))

    def _familiar(self, known: Float, fit: Fit) -> Float:
        """A covariance with what the pose prior knows added, once; it does not go on to the next frame."""
        if self._prior is None or (information := inverse(known)) is None:
            return known
        return covariance(Quadratic(0.0, np.zeros(len(known)), information + self._prior.claimed(fit.result.posed)))


def track(
    frames: Iterable[Frame], body: Body, rig: Rig, first_pose: Pose, config: TrackerConfig | None = None,
    prior: ParzenPrior | None = None, motions: MotionLibrary | None = None,
) -> Iterator[Estimate]:  # fmt: skip
    """Track a body through frames, one estimate each."""
    tracker = Tracker(body, rig, config, prior, motions)
    for k, frame in enumerate(frames):
        if k == 0:
            tracker.start(first_pose, frame.time)
        yield tracker.step(frame)
