"""An experiment: a scene for every seed, and arms that track it in different ways."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from twistcap._typing import AnyArray, Float
from twistcap.body import Pose, Posed
from twistcap.camera import Camera
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import Row
from twistcap.evaluate.parallel import Tell, one_thread_processes
from twistcap.studio import Capture
from twistcap.track import TrackerConfig, track


@dataclass(frozen=True)
class Arm:
    """One way of tracking."""

    name: str
    tracker: TrackerConfig


@dataclass(frozen=True)
class Shot:
    """A picture to be drawn: an image of a camera and the body as one arm had it there."""

    title: str
    image: AnyArray
    camera: Camera
    posed: Posed


@dataclass(frozen=True)
class Trace:
    """What one arm did on one seed.

    Attributes:
        arm, seed: which.
        errors: (N,) the experiment's error in each frame.
        estimates: N answers.
        shot: of the frame that shows most.
    """

    arm: str
    seed: int
    errors: Float
    estimates: Sequence[Estimate]
    shot: Shot


@dataclass(frozen=True)
class Findings:
    """What an experiment found: lines of its table; what its curves show, and those; none where only rows are drawn."""

    rows: list[Row]
    quantity: str
    traces: Sequence[Trace]


class Experiment(Protocol):
    """What `twistcap reproduce` can run beside its tables."""

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
    """

    id: str
    says: str
    quantity: str
    scene: Callable[[int], Capture]
    arms: tuple[Arm, ...]
    error: Callable[[Capture, Estimate], float]
    rows: Callable[[Sequence[Trace]], list[Row]]
    shown: tuple[int, int] = (-1, 0)

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """All arms on all seeds, two scenes at a time."""
        found: dict[int, list[Trace]] = {}
        with one_thread_processes(min(2, len(seeds))) as pool:
            waiting = {pool.submit(_traces, self, seed): seed for seed in seeds}
            for done, future in enumerate(as_completed(waiting), 1):
                found[waiting[future]] = future.result()
                progress(f"{self.id}, seed {waiting[future]}", done, len(seeds))
        traces = [trace for seed in seeds for trace in found[seed]]
        return Findings(self.rows(traces), self.quantity, traces)


def _traces(experiment: Comparison, seed: int) -> list[Trace]:
    scene = experiment.scene(seed)
    frames = [scene.frame(k) for k in range(scene.config.frames)]
    out: list[Trace] = []
    for arm in experiment.arms:
        estimates = list(track(frames, scene.body, scene.rig, scene.first_pose, arm.tracker))
        errors = np.array([experiment.error(scene, e) for e in estimates])
        k, camera = experiment.shown
        image = frames[k].images[camera]
        assert image is not None
        shot = Shot(
            f"{arm.name}, frame {frames[k].index}", image, scene.rig[camera], Posed(scene.body, estimates[k].pose)
        )
        slim = [replace(e, covariance=np.empty((0, 0))) for e in estimates]  # processes need not carry them
        out.append(Trace(arm.name, seed, errors, slim, shot))
    return out


def landmark_error_mm(scene: Capture, estimate: Estimate, names: Sequence[str]) -> float:
    """Mean distance of landmarks from their true places, mm."""
    truth: Pose = scene.true_poses[estimate.index]
    here, there = Posed(scene.body, estimate.pose).landmarks, Posed(scene.true_body, truth).landmarks
    ours, theirs = ([b.landmarks.index(name) for name in names] for b in (scene.body, scene.true_body))
    return 1000.0 * float(np.linalg.norm(here[ours] - there[theirs], axis=1).mean())


def by_arm(traces: Sequence[Trace], arm: str) -> list[Trace]:
    """The traces of one arm, one per seed."""
    return [trace for trace in traces if trace.arm == arm]
