"""Walks followed from brightness alone, in scaled views: what T-1 to T-3 and T-EM share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from reproduce.arms import Findings, Shot, Trace
from reproduce.passes import SequenceConfig, track_sequence
from reproduce.plates import angles_of
from reproduce.running import Tell, over_seeds
from reproduce.scenes.walks import Walk
from twistcap.arrays import Float
from twistcap.body import Body, Posed
from twistcap.camera import ScaledView
from twistcap.differential.model import DifferentialModel
from twistcap.differential.settings import DifferentialConfig, Rule
from twistcap.differential.state import State, state_of, world_pose
from twistcap.differential.step import track
from twistcap.estimate import Estimate
from twistcap.evaluate import Row
from twistcap.evaluate.metrics import JOINT_CENTRES, lost_frames
from twistcap.studio import Capture

Model = Callable[[Capture], Body]
"""The body that is tracked in a scene."""


@dataclass(frozen=True)
class Tracked(Trace):
    """What one arm did on one seed.

    Attributes:
        angles_deg: (N, J) signed errors of the model's joints.
        names: J names.
        scale_error: (N,) relative error of the views' scales, mean size.
        share_tracked: of the frames, those in which no joint is farther off than 150 mm in any image.
    """

    angles_deg: Float | None = None
    names: tuple[str, ...] = ()
    scale_error: Float | None = None
    share_tracked: float = 1.0

    @property
    def lost(self) -> bool:
        """Whether any frame is lost: a joint more than 150 mm from its true image."""
        return self.share_tracked < 1.0

    def mean_deg(self, *stems: str) -> float:
        """Mean size of the errors of some joints, sides left out; of all by default."""
        assert self.angles_deg is not None
        columns = [k for k, n in enumerate(self.names) if not stems or n.removesuffix("_r").removesuffix("_l") in stems]
        return float(np.abs(self.angles_deg[:, columns]).mean())


@dataclass(frozen=True)
class DifferentialTrial:
    """Scenes of walking and ways of following them; an `Experiment`.

    Attributes:
        id, says: as of every experiment.
        walk: the scenes.
        model: what is tracked.
        arms: settings by name.
        rows: the table's lines.
        judged: joints whose mean error is drawn over the frames.
        picture: draws more pictures into a folder, from the walk and the first arm's traces.
        shown: frame (counted from the second) and camera of the picture.
        sequence: the passes over all frames after the first; None makes none.
        rule: of all arms.
    """

    id: str
    says: str
    walk: Walk
    model: Model
    arms: tuple[tuple[str, DifferentialConfig], ...]
    rows: Callable[[Sequence[Tracked]], list[Row]]
    judged: tuple[str, ...] = ("hip_flexion", "knee_angle")
    picture: Callable[[Path, Walk, Sequence[Tracked]], None] | None = None
    shown: tuple[int, int] = (-1, 0)
    sequence: SequenceConfig | None = None
    rule: Rule = field(default_factory=Rule)

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """All arms on all seeds, two scenes at a time."""
        found = over_seeds(partial(run_seed, self), seeds, progress, self.id)
        traces = [trace for arms in found for trace in arms]
        if out is not None and self.picture is not None:
            self.picture(out, self.walk, [t for t in traces if t.arm == self.arms[0][0]])
        return Findings(self.rows(traces), "error of hips and knees, deg", traces, "right knee, deg")


def run_seed(trial: DifferentialTrial, seed: int) -> list[Tracked]:
    """All arms of an experiment on one scene, which is rendered once."""
    scene = trial.walk.scene(seed)
    images = [[image for image in frame.images if image is not None] for frame in scene.frames()]
    return [_trace(trial, name, config, scene, images) for name, config in trial.arms]


def _states(
    trial: DifferentialTrial, config: DifferentialConfig, model: Body, scene: Capture, images: Sequence[Sequence[Float]]
) -> list[State]:
    """The states of all frames but the first, which is given."""
    start = state_of(scene.true_poses[0], scene.rig, config.perspective)
    first = State(start.views, angles_of(model, scene.body, start.q))
    followed = DifferentialModel(model, config, trial.rule)
    if trial.sequence is None:
        return [estimate.state for estimate in track(followed, first, images)]
    return track_sequence(followed, first, images, trial.sequence)[1:]


def _trace(
    trial: DifferentialTrial, arm: str, config: DifferentialConfig, scene: Capture, images: Sequence[Sequence[Float]]
) -> Tracked:
    model = trial.model(scene)
    states = _states(trial, config, model, scene, images)
    q = np.array([state.q for state in states])
    true_q = angles_of(model, scene.true_body, np.array([pose.q for pose in scene.true_poses[1:]]))
    error, names = np.degrees(q - true_q), model.coordinate_names
    mm = np.array([_image_mm(model, s, scene, k + 1) for k, s in enumerate(states)])
    judged = [k for k, n in enumerate(names) if n.removesuffix("_r").removesuffix("_l") in trial.judged]
    knee = model.coordinate("knee_angle_r")
    return Tracked(
        arm, scene.config.seed, np.abs(error[:, judged]).mean(axis=1), mm,
        [_estimate(k + 1, s, scene) for k, s in enumerate(states)],
        _shot(trial, arm, model, scene, images, states), np.degrees(q[:, knee]), np.degrees(true_q[:, knee]),
        angles_deg=error, names=names, scale_error=_scale_error(scene, states),
        share_tracked=1.0 - float(lost_frames(mm).mean()),
    )  # fmt: skip


def _scale_error(scene: Capture, states: Sequence[State]) -> Float:
    """(N,) relative error of the views' scales in each frame, mean size."""
    truth = [state_of(pose, scene.true_rig) for pose in scene.true_poses[1:]]
    pairs = zip(states, truth, strict=True)
    off = np.array([[a.scale / b.scale - 1 for a, b in zip(s.views, t.views, strict=True)] for s, t in pairs])
    return np.abs(off).mean(axis=1)


def _image_mm(model: Body, state: State, scene: Capture, frame: int) -> Float:
    """(K,) largest distance over the views of each joint's image from the true one, mm at the true scale."""
    names = [name for name in JOINT_CENTRES if name in model.landmarks.names]
    ours, theirs = ([b.landmarks.index(name) for name in names] for b in (model, scene.true_body))
    here, there = state.posed(model).landmarks[ours], scene.landmarks[frame][theirs]
    out: list[Float] = []
    for view, camera in zip(state.views, scene.true_rig, strict=True):
        scale = ScaledView.of(camera, scene.true_poses[frame].root).scale
        out.append(1000.0 * np.linalg.norm(view.pixels(here) - camera.project(there)[0], axis=1) / scale)
    return np.max(out, axis=0)


def _estimate(index: int, state: State, scene: Capture) -> Estimate:
    return Estimate(index, index / scene.config.fps, world_pose(state, list(scene.rig)), np.empty((0, 0)))


def _shot(
    trial: DifferentialTrial,
    arm: str,
    model: Body,
    scene: Capture,
    images: Sequence[Sequence[Float]],
    states: Sequence[State],
) -> Shot:
    k, camera = trial.shown
    frame = range(len(states))[k] + 1
    view = states[k].views[camera]
    posed = Posed(model, replace(world_pose(states[k], list(scene.rig)), root=view.root(scene.rig[camera])))
    truth = scene.masks(frame)[camera]
    return Shot(f"{arm}, frame {frame}", images[frame][camera], scene.rig[camera], posed, truth)
