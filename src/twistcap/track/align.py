"""One frame as a least-squares problem: correspond and update in turn, until the body has settled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.camera.bump import after_both
from twistcap.cues.appearance import Appearance
from twistcap.cues.observation import (
    Alternation,
    Fit,
    Level,
    Measured,
    Sight,
    Visibility,
    contour_moved,
    total_agreement,
)
from twistcap.cues.view import View, steadied
from twistcap.estimate import Frame, Sources
from twistcap.features import Channels
from twistcap.predict.claims import Uncertainty
from twistcap.predict.history import Past
from twistcap.render import render, reprojected, visible_contour
from twistcap.solve import PoseProblem, minimise
from twistcap.stages import stage
from twistcap.terms import Term
from twistcap.threads import in_parallel
from twistcap.track.model import MARGIN, Model
from twistcap.track.state import State

# Damping of a step. What is told least, as the turn of the pelvis between trunk and thighs, has some 3e-4 of its own
# diagonal: with 1e-3 of that a look goes a quarter of the way, and the track lags. Far from the body steps are careful.
_FINE, _COARSE = 1e-4, 1e-3
_NO_TURN = 1e-9  # rad, what is left by rounding where a camera stands again as it did


@dataclass(frozen=True)
class FrameProblem:
    """One frame of a track.

    Attributes:
        model, state, frame: what is tracked, what is known, what is seen.
        start: where the body is expected, and the fit starts.
        process_noise: (6 + J, 6 + J) what the time since the last frame adds to the covariance.
        information: (6 + J, 6 + J) with which the pose is drawn there.
        views: the images about it, by camera.
        trust: how far the images are believed, 0 … 1.
        left_out, relit: cameras that are not believed; whether the look is learned again, in another light.
    """

    model: Model
    state: State
    frame: Frame
    start: Pose
    process_noise: Float
    information: Float
    views: Mapping[int, View]
    trust: float = 1.0
    left_out: frozenset[int] = frozenset()
    relit: bool = False

    @property
    def body(self) -> Body:
        return self.model.body

    @property
    def rig(self) -> Rig:
        return self.model.rig

    @property
    def bumps(self) -> Float:
        return self.state.bumps

    @property
    def channels(self) -> Channels:
        return self.model.channels

    @property
    def past(self) -> Past:
        return self.state.past

    @property
    def trusted(self) -> bool:
        return self.trust == 1.0

    def colours(self, camera_index: int, channels: int) -> Float:
        """See `search.Problem`."""
        known = self.state.cues["contour"]
        assert isinstance(known, Appearance)
        return known.of(camera_index, channels)

    def afresh(self, pose: Pose, margin: float) -> Fit:
        """See `search.Problem`."""
        model = replace(self.model, schedule=self.model.schedule.afresh)
        state = self.state.with_past(replace(self.past, started=False))
        other = self.at(pose, margin)
        return align(replace(other, model=model, state=state, information=np.zeros_like(self.information)))

    def at(self, pose: Pose, margin: float = MARGIN) -> FrameProblem:
        """The problem with the body expected elsewhere, and the images about it."""
        return replace(self, start=pose, views=self.model.views(self.frame, pose, margin, self.left_out))

    def without_look(self) -> FrameProblem:
        """See `search.Problem`."""
        cues = {cue.name: cue.start(self.body, self.rig) for cue in self.model.cues}
        return replace(self, state=replace(self.state, cues=cues, learned=0), relit=True)

    def excluding(self, left_out: frozenset[int]) -> FrameProblem:
        """See `search.Problem`."""
        return replace(self, left_out=left_out, views={i: v for i, v in self.views.items() if i not in left_out})

    def sorted_by(self, sources: Sources) -> FrameProblem:
        """See `search.Problem`."""
        bumps, swapped = self.state.bumps, {c for c, source in enumerate(sources) if source != c}
        frame = steadied(steadied(self.frame, -bumps, self.rig).sorted_by(sources), bumps, self.rig)
        return replace(self, frame=frame, left_out=self.left_out - swapped).at(self.start)

    def turned_back(self, bumps: Mapping[int, Float]) -> FrameProblem:
        """See `search.Problem`."""
        now, every = np.zeros_like(self.state.bumps), self.state.bumps.copy()
        for i, bump in bumps.items():
            now[i], turn = bump, after_both(every[i], bump)
            every[i] = turn if np.linalg.norm(turn) > _NO_TURN else 0.0
        frame = steadied(self.frame, now, self.rig)
        left_out, state = self.left_out - bumps.keys(), replace(self.state, bumps=every)
        return replace(self, frame=frame, state=state, left_out=left_out).at(self.start)

    def look(self, camera_index: int, posed: Posed) -> Sight | None:
        """See `search.Problem`."""
        others = frozenset(range(len(self.rig))) - {camera_index}
        views = self.model.views(self.frame, posed.pose, left_out=others)
        return _sight(posed, camera_index, views[camera_index], self.model.schedule.contour_spacing) if views else None

    def align(self, pose: Pose) -> Fit:
        """See `search.Problem`."""
        return align(self.at(pose))

    def measured(self, pose: Pose) -> Fit:
        """What the images say of a pose as it is."""
        return alternated(replace(self, start=pose), self.unfitted(pose), self.model.schedule.fine_level, steps=0)

    def support(self, fit: Fit) -> Float:
        """See `search.Problem`."""
        return self.model.support.updated(self.state.support, fit.agreement)

    def in_sight(self, fit: Fit) -> Float:
        """See `search.Problem`."""
        rule = self.model.occlusion
        if rule is None:
            return np.ones(len(self.body.segment_names))
        return rule.in_sight(fit.agreement, fit.visibility.occluded)

    @property
    def uncertainty(self) -> Uncertainty:
        """Before the images."""
        return Uncertainty(self.state.covariance, self.state.claimed, self.process_noise)

    def unfitted(self, pose: Pose) -> Fit:
        """A pose of which nothing has been measured yet."""
        occluded = self.state.occluded
        return Fit.started(Posed(self.body, pose), Visibility(occluded, np.zeros_like(occluded)))


def align(problem: FrameProblem) -> Fit:
    """Correspond and update in turn: fine where the prediction was good, else coarse until it settles."""
    model, state, schedule = problem.model, problem.state, problem.model.schedule
    fit, fine, started = problem.unfitted(problem.start), schedule.first, state.past.started
    if started:
        fit, fine = alternated(problem, fit, schedule.fine_level), schedule.fine - 1
    if model.occlusion is not None:
        fit = replace(fit, visibility=model.occlusion.after(fit.visibility, fit.measured, model.body))
    slipped = model.support.slipped(state.support, fit.agreement, schedule.slip)
    if not started or fit.visibility.reappeared.any() or fit.moved > schedule.surprise or slipped:
        for _ in range(schedule.coarse_rounds):
            fit = alternated(problem, fit, schedule.coarse_level)
            if fit.moved <= schedule.settled:
                break
        fine = schedule.fine if started else schedule.first
    for _ in range(fine):
        fit = alternated(problem, fit, schedule.fine_level)
    if fit.status == "failed":
        return fit
    return replace(fit, status="converged" if fit.moved < schedule.settled else "max_iterations")


def alternated(problem: FrameProblem, fit: Fit, level: Level, steps: int = 1) -> Fit:
    """One alternation: the body is rendered anew where it has moved, else its contour is carried along; then a step."""
    model, posed = problem.model, fit.posed
    again = not fit.sights or fit.drift > model.schedule.render_after
    if again:
        _ = posed.vertices, posed.vertex_normals  # once, not in each thread
    carried: Sequence[Sight | None] = [None] * len(problem.views) if again else fit.sights
    looked = in_parallel(lambda i, s: _looked(problem, posed, i, s, level), list(problem.views), carried)
    sights, measured = [sight for sight, _ in looked], [found for _, found in looked]
    standing, news = _prior_terms(problem, fit, measured)
    masked = [evidence for found in _masked(model, measured, fit.visibility) for evidence in found.values()]
    system = PoseProblem([*standing, *news, *(evidence.term for evidence in masked)])
    with stage("solve"):
        result = minimise(system, posed, steps=steps, damping=_FINE if level.fine else _COARSE)
    known = sum(system.quadratics[id(term)].hessian for term in standing)
    entered = [(evidence, *system.rows[id(evidence.term)]) for evidence in masked if id(evidence.term) in system.rows]
    moved = contour_moved(sights, result.x)
    return Fit(
        result.x, result.status, fit.steps + result.steps, result.energies, result.system, posed,
        fit.visibility, known, news, sights, measured, entered, moved, moved if again else fit.drift + moved,
    )  # fmt: skip


def _masked(model: Model, measured: Sequence[Measured], visibility: Visibility) -> Sequence[Measured]:
    if model.occlusion is None:
        return measured
    parts = len(model.body.segment_names)
    return [model.occlusion.masked(found, visibility, parts) for found in measured]


def _looked(
    problem: FrameProblem, posed: Posed, camera: int, before: Sight | None, level: Level
) -> tuple[Sight, Measured]:
    """One camera's sight of the body, new or carried along, and what the cues measure in it."""
    if before is None:
        sight = _sight(posed, camera, problem.views[camera], problem.model.schedule.contour_spacing)
    else:
        sight = replace(before, contour=reprojected(before.contour, posed, before.view.camera.P))
    found = {cue.name: cue.measure(sight, problem.state.cues[cue.name], level) for cue in problem.model.cues}
    return sight, {name: evidence for name, evidence in found.items() if evidence is not None}


def _sight(posed: Posed, camera: int, view: View, spacing_m: float) -> Sight:
    with stage("render"):
        seen = render(posed, view.camera)
    with stage("contour"):
        return Sight(camera, view, seen, visible_contour(seen, max(1.0, spacing_m * seen.px_per_m)))


def _prior_terms(problem: FrameProblem, fit: Fit, measured: Sequence[Measured]) -> tuple[list[Term], list[Term]]:
    """Terms of the priors: those that stand in every frame, and those that bring news."""
    known, concealed = np.ones(problem.body.dof - 6), 0.0
    if (rule := problem.model.occlusion) is not None:
        agreement = total_agreement(measured, len(problem.body.segment_names))
        known = rule.known(agreement, fit.visibility.occluded, problem.body)
        concealed = rule.concealed(agreement, fit.visibility.occluded)
    samples = sum(evidence.samples for found in measured for evidence in found.values())
    now = Alternation(fit.posed, problem.start, problem.information, problem.frame, samples, known, concealed)
    standing, news = list[Term](), list[Term]()
    for prior in problem.model.priors:
        (news if prior.news else standing).extend(prior.terms(now))
    return standing, news
