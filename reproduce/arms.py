"""An experiment: a scene for every seed, and arms that track it in different ways."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from reproduce.cases import Training
from reproduce.running import Tell, over_seeds
from reproduce.sequence import joint_errors_mm, prior_of
from twistcap.arrays import AnyArray, Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.build import build
from twistcap.camera import Camera, Rig
from twistcap.estimate import Estimate, Frame
from twistcap.evaluate.metrics import Row, lost_sequence
from twistcap.hindsight import tracked
from twistcap.motion import MotionLibrary
from twistcap.priors import ParzenPrior
from twistcap.studio import Capture
from twistcap.track import Model, Settings


@dataclass(frozen=True)
class Arm:
    """One way of tracking.

    Attributes:
        name: of it.
        tracker: settings.
        prior: what a pose prior has learnt from; None without one.
        undisturbed: whether it gets all images, without noise.
        changed: what is changed of the model that the settings make, for what no setting names.
    """

    name: str
    tracker: Settings
    prior: Training | None = None
    undisturbed: bool = False
    changed: Callable[[Model], Model] | None = None

    def model(self, body: Body, rig: Rig, prior: ParzenPrior | None, motions: MotionLibrary | None) -> Model:
        """What this arm tracks with."""
        model = build(body, rig, self.tracker, prior, motions)
        return model if self.changed is None else self.changed(model)


def unsearched(model: Model) -> Model:
    """Without the search for what is lost, which would mend what an arm is to show."""
    return replace(model, searches=tuple(s for s in model.searches if s.name != "lost body"))


@dataclass(frozen=True)
class Shot:
    """A picture to be drawn: an image of a camera, the body as one arm had it there, and its true silhouette (H, W)."""

    title: str
    image: AnyArray
    camera: Camera
    posed: Posed
    truth: Bool


@dataclass(frozen=True)
class Trace:
    """What one arm did on one seed.

    Attributes:
        arm, seed: which.
        errors: (N,) the experiment's error in each frame.
        joints_mm: (N, K) errors of the joint centres.
        course, true_course: (N,) what the experiment watches, as it was tracked and as it was; None where nothing is.
        estimates: N answers.
        shot: of the frame that shows most.
    """

    arm: str
    seed: int
    errors: Float
    joints_mm: Float
    estimates: Sequence[Estimate]
    shot: Shot
    course: Float | None = None
    true_course: Float | None = None

    @property
    def lost(self) -> bool:
        """Whether the sequence was lost, as everywhere: by its mean joint error."""
        return lost_sequence(self.joints_mm)


@dataclass(frozen=True)
class Findings:
    """What an experiment found: lines of its table; what its curves show, and those; none where only rows are drawn.

    Attributes:
        rows, quantity, traces: these.
        watched: what the traces' courses are; empty where they have none.
        span: first and last frame of what the curves are about, to be shaded.
        text: a table of its own, shown to people instead of the rows.
    """

    rows: list[Row]
    quantity: str
    traces: Sequence[Trace]
    watched: str = ""
    span: tuple[int, int] | None = None
    text: str = ""


class Experiment(Protocol):
    """What can be run beside the tables."""

    @property
    def id(self) -> str:
        """As in the table of experiments: "C-3"."""
        ...

    @property
    def says(self) -> str:
        """Claim and scene in one line."""
        ...

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Run it on seeds of the studio; one that draws its own pictures puts them into the folder `out`."""
        ...


@dataclass(frozen=True)
class Comparison:
    """Arms that track the same scenes.

    Attributes:
        id, says: as of an `Experiment`.
        quantity: what `error` is, with its unit.
        scene: the capture of a seed.
        arms: ways of tracking it.
        error: of an estimate, by capture and frame number.
        rows: the table's lines from the traces of all arms and seeds.
        shown: frame and camera of the picture.
        watched, course: a quantity, with its unit, whose course is drawn beside the true one, and its value at a pose.
        span: first and last frame to be shaded in the curves.
        motions: training motion for the arms that predict by it.
    """

    id: str
    says: str
    quantity: str
    scene: Callable[[int], Capture]
    arms: tuple[Arm, ...]
    error: Callable[[Capture, Estimate], float]
    rows: Callable[[Sequence[Trace]], list[Row]]
    shown: tuple[int, int] = (-1, 0)
    watched: str = ""
    course: Callable[[Posed], float] | None = None
    span: tuple[int, int] | None = None
    motions: Callable[[Capture], MotionLibrary] | None = None

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """All arms on all seeds, two scenes at a time."""
        found = over_seeds(partial(run_seed, self), seeds, progress, self.id)
        traces = [trace for arms in found for trace in arms]
        return Findings(self.rows(traces), self.quantity, traces, self.watched, self.span)


def run_seed(experiment: Comparison, seed: int) -> list[Trace]:
    """All arms on one scene, which is rendered once."""
    scene = experiment.scene(seed)
    clear = replace(scene, config=replace(scene.config, dropped=(), uniform_noise=0.0))
    frames = {
        disturbed: [shown.frame(k) for k in range(scene.config.frames)]
        for disturbed, shown in ((True, scene), (False, clear))
        if any(arm.undisturbed != disturbed for arm in experiment.arms)
    }
    motions = None if experiment.motions is None else experiment.motions(scene)
    return [_trace(experiment, arm, scene, frames[not arm.undisturbed], motions) for arm in experiment.arms]


def _trace(
    experiment: Comparison, arm: Arm, scene: Capture, frames: Sequence[Frame], motions: MotionLibrary | None
) -> Trace:
    given = (prior_of(arm.prior, scene), motions if arm.tracker.predictor == "motion" else None)
    estimates = list(tracked(frames, arm.model(scene.body, scene.rig, *given), scene.first_pose))
    errors = np.array([experiment.error(scene, e) for e in estimates])
    joints = joint_errors_mm(scene, scene.body, [e.pose for e in estimates], [e.index for e in estimates])
    index, camera = experiment.shown
    shot = shot_of(arm.name, scene, frames[index], Posed(scene.body, estimates[index].pose), camera)
    trace = Trace(arm.name, scene.config.seed, errors, joints, slim(estimates), shot)
    if experiment.course is None:
        return trace
    course = np.array([experiment.course(Posed(scene.body, e.pose)) for e in estimates])
    truth = np.array([experiment.course(Posed(scene.true_body, scene.true_poses[e.index])) for e in estimates])
    return replace(trace, course=course, true_course=truth)


def shot_of(arm: str, scene: Capture, frame: Frame, posed: Posed, camera: int = 0) -> Shot:
    """The picture of an arm's body in a frame."""
    image = frame.images[camera]
    assert image is not None
    truth = scene.masks(frame.index)[camera]
    return Shot(f"{arm}, frame {frame.index}", image, scene.rig[camera], posed, truth)


def slim(estimates: Sequence[Estimate]) -> list[Estimate]:
    """The estimates without covariances, which processes need not carry to each other."""
    return [replace(e, covariance=np.empty((0, 0))) for e in estimates]


def landmark_error_mm(scene: Capture, estimate: Estimate, names: Sequence[str]) -> float:
    """Mean distance of landmarks from their true places, mm."""
    truth: Pose = scene.true_poses[estimate.index]
    here, there = Posed(scene.body, estimate.pose).landmarks, Posed(scene.true_body, truth).landmarks
    ours, theirs = ([b.landmarks.index(name) for name in names] for b in (scene.body, scene.true_body))
    return 1000.0 * float(np.linalg.norm(here[ours] - there[theirs], axis=1).mean())


def by_arm(traces: Sequence[Trace], arm: str) -> list[Trace]:
    """The traces of one arm, one per seed."""
    return [trace for trace in traces if trace.arm == arm]
