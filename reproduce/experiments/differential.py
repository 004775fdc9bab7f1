"""T-1 to T-3: walks followed from brightness alone, in one view and in three, and what support maps are worth.

After Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998: people walking across and
obliquely to one camera, and photographic plates in three views, about a dozen exposures in a cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from reproduce.arms import Findings, Shot, Trace
from reproduce.arrays import Float
from reproduce.running import Tell, over_seeds
from reproduce.scenes.walks import Walk
from twistcap.body import Body, Posed
from twistcap.body.ellipsoids import ellipsoid_body
from twistcap.body.simplify import NINETEEN, SIDE_VIEW, angles_of, side_view, simplified
from twistcap.differential.sequence import Limb, SequenceConfig, track_sequence
from twistcap.differential.settings import DifferentialConfig
from twistcap.differential.tracker import track
from twistcap.differential.view import ScaledView, State
from twistcap.differential.world import state_of, world_pose
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import JOINT_CENTRES, LOST_FRAME_MM, Row, lost_frames, row
from twistcap.studio import Capture, StudioConfig

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

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """All arms on all seeds, two scenes at a time."""
        found = over_seeds(partial(run_seed, self.id), seeds, progress, self.id)
        traces = [trace for arms in found for trace in arms]
        if out is not None and self.picture is not None:
            self.picture(out, self.walk, [t for t in traces if t.arm == self.arms[0][0]])
        return Findings(self.rows(traces), "error of hips and knees, deg", traces, "right knee, deg")


def run_seed(id: str, seed: int) -> list[Tracked]:
    """All arms of an experiment on one scene, which is rendered once."""
    trial = next(t for t in TRIALS if t.id == id)
    scene = trial.walk.scene(seed)
    images = [[image for image in frame.images if image is not None] for frame in scene.frames()]
    return [_trace(trial, name, config, scene, images) for name, config in trial.arms]


def _trace(
    trial: DifferentialTrial, arm: str, config: DifferentialConfig, scene: Capture, images: Sequence[Sequence[Float]]
) -> Tracked:
    model = trial.model(scene)
    start = state_of(scene.true_poses[0], scene.rig, config.perspective)
    first = State(start.views, angles_of(model, scene.body, start.q))
    if trial.sequence is None:
        states = [estimate.state for estimate in track(model, first, images, config)]
    else:
        states = track_sequence(model, first, images, config, trial.sequence)[1:]
    truth = [state_of(pose, scene.true_rig) for pose in scene.true_poses[1:]]
    q = np.array([state.q for state in states])
    true_q = angles_of(model, scene.true_body, np.array([pose.q for pose in scene.true_poses[1:]]))
    off = np.degrees(q - true_q)
    mm = np.array([_image_mm(model, s, scene, k + 1) for k, s in enumerate(states)])
    scale = np.array(
        [
            [a.scale / b.scale - 1 for a, b in zip(s.views, t.views, strict=True)]
            for s, t in zip(states, truth, strict=True)
        ]
    )
    estimates = [_estimate(k + 1, s, scene) for k, s in enumerate(states)]
    judged = [
        k for k, n in enumerate(model.coordinate_names) if n.removesuffix("_r").removesuffix("_l") in trial.judged
    ]
    knee = model.coordinate("knee_angle_r")
    return Tracked(
        arm,
        scene.config.seed,
        np.abs(off[:, judged]).mean(axis=1),
        mm,
        estimates,
        _shot(trial, arm, model, scene, images, states),
        np.degrees(q[:, knee]),
        np.degrees(true_q[:, knee]),
        off,
        model.coordinate_names,
        np.abs(scale).mean(axis=1),
        1.0 - float(lost_frames(mm, LOST_FRAME_MM).mean()),
    )


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


def _planar(scene: Capture) -> Body:
    """Trunk, head, and the right arm and leg, turning in the image plane."""
    at, axis = scene.first_pose.q, ScaledView.of(scene.rig[0], scene.first_pose.root).rotation[2]
    return ellipsoid_body(side_view(scene.body, "r", at=at, axis=axis))


def _both_legs(scene: Capture) -> Body:
    """Trunk, head, the near arm and both legs, since either leg hides the other; the surface of the body itself."""
    kept = [n for n in scene.body.coordinate_names if n.removesuffix("_r").removesuffix("_l") in SIDE_VIEW]
    far_arm = ("humerus_l", "ulna_l", "radius_l")
    kept = [n for n in kept if n not in ("arm_flex_l", "elbow_flex_l")]
    return simplified(scene.body, kept, at=scene.first_pose.q, without=far_arm)


def _nineteen(scene: Capture) -> Body:
    """Both sides with 19 joint angles, and the surface of the body itself."""
    return simplified(scene.body, NINETEEN, at=scene.first_pose.q)


@dataclass(frozen=True)
class _OneView:
    """Rows of T-1 and T-2: hip, knee, lost sequences, and how the scale was followed."""

    id: str
    most_deg: float
    most_scale: float | None = None

    def __call__(self, traces: Sequence[Tracked]) -> list[Row]:
        lost = [float(t.lost) for t in traces]
        out = [_errors(self.id, joint, traces, self.most_deg) for joint in ("hip_flexion", "knee_angle")]
        out += [_errors(self.id, joint, traces, None) for joint in ("ankle_angle", "arm_flex", "elbow_flex")]
        scale = [100.0 * float(np.mean(t.scale_error)) for t in traces if t.scale_error is not None]
        out.append(row(self.id, "error of the scale", float(np.mean(scale)), "%", at_most=self.most_scale, seeds=scale))
        out.append(row(self.id, "lost sequences", sum(lost), "sequences", at_most=0.0, seeds=lost, lost=int(sum(lost))))
        return out


def _errors(case: str, joint: str, traces: Sequence[Tracked], most: float | None) -> Row:
    values = [t.mean_deg(joint) for t in traces]
    return row(case, joint, float(np.mean(values)), "deg", at_most=most, seeds=values)


def _plate_rows(traces: Sequence[Tracked]) -> list[Row]:
    whole = [float(not t.lost) for t in traces]
    angles, share = [t.mean_deg() for t in traces], [t.share_tracked for t in traces]
    needed = 7 / 8 * len(traces)
    return [
        row(
            "T-3",
            "all exposures tracked",
            sum(whole),
            "sequences",
            at_least=needed,
            seeds=whole,
            lost=int(len(whole) - sum(whole)),
        ),
        row("T-3", "exposures tracked", float(np.mean(share)), "share", seeds=share),
        row("T-3", "all 19 angles", float(np.mean(angles)), "deg", at_most=5.0, seeds=angles),
        *(_errors("T-3", joint, traces, None) for joint in ("hip_flexion", "knee_angle", "arm_flex", "elbow_flex")),
    ]


def _support_rows(traces: Sequence[Tracked]) -> list[Row]:
    out: list[Row] = []
    for arm in dict.fromkeys(t.arm for t in traces):
        own = [t for t in traces if t.arm == arm]
        values, lost = [t.mean_deg("hip_flexion", "knee_angle") for t in own], sum(t.lost for t in own)
        out.append(row(f"T-EM {arm}", "hip and knee", float(np.mean(values)), "deg", seeds=values, lost=lost))
    on, off = (
        np.array([t.mean_deg("hip_flexion", "knee_angle") for t in traces if t.arm == arm]) for arm in (WITH, WITHOUT)
    )
    out.append(
        row("T-EM", "with maps to without", float(on.mean() / off.mean()), "ratio", at_most=2 / 3, seeds=list(on / off))
    )
    return out


def _norm_picture(out: Path, walk: Walk, traces: Sequence[Tracked]) -> None:
    from reproduce.norm_picture import norm_picture

    norm_picture(out / "T-1-norms.png", walk, traces)


def _reanimation(out: Path, walk: Walk, traces: Sequence[Tracked]) -> None:
    from reproduce.reanimated import reanimated

    trace = min(traces, key=lambda t: t.mean_deg())
    reanimated(out / f"T-3-seed-{trace.seed}.mp4", _nineteen(walk.scene(trace.seed)), [e.pose for e in trace.estimates])


WITH, ROBUST, WITHOUT = "support maps by EM", "robust weights", "the projected shape"
_SIDE = DifferentialConfig(turns="planar", colour=False)  # grey, as the paper's
_ARM = Limb(("arm_flex", "elbow_flex"), steps_deg=(8.0, 10.0), counts=(5, 7), stray_deg=(1.5, 2.5))  # at 60 fps
_LEG = Limb(("hip_flexion", "knee_angle"), steps_deg=(10.0, 18.0), counts=(5, 9), stray_deg=(4.0, 7.0))
_SIDE_STUDIO = StudioConfig(frames=101)
_PLATES = DifferentialConfig(levels=3, search_deg=30.0, carry=0.6, stray_deg=12.0, update=0.1)

T1 = DifferentialTrial(
    "T-1",
    "one view, walking across it, 100 frames: trunk, head, one arm and one leg of ellipsoids",
    Walk((-90.0,), 8.0, _SIDE_STUDIO),
    _planar,
    (("tracked", _SIDE),),
    _OneView("T-1", 3.0),
    picture=_norm_picture,
    sequence=SequenceConfig(passes=1, limbs=(_ARM,)),
)
T2 = DifferentialTrial(
    "T-2",
    "one view, walking obliquely towards it, 100 frames; the scale grows: trunk, head, one arm and both legs",
    Walk((-50.0,), 6.0, _SIDE_STUDIO),
    _both_legs,
    (("tracked", DifferentialConfig(colour=False, perspective=True)),),
    _OneView("T-2", 5.0, 3.0),
    sequence=SequenceConfig(passes=2, limbs=(_LEG, _ARM)),
)
T3 = DifferentialTrial(
    "T-3",
    "plates: three views, a dozen exposures in a cycle, grain, flicker, low contrast, 19 joint angles",
    Walk(
        (-90.0, -30.0, -150.0), 10.0, StudioConfig(frames=14, colour=False, plates=True, sensor_noise=0.0), per_cycle=12
    ),
    _nineteen,
    (("tracked", _PLATES),),
    _plate_rows,
    picture=_reanimation,
    sequence=SequenceConfig(),
)
T_EM = DifferentialTrial(
    "T-EM",
    "as T-1, the clothes loose and clutter moving behind: support maps on, against off",
    Walk((-90.0,), 8.0, replace(_SIDE_STUDIO, frames=61, cloth=0.012, passers=4)),
    _planar,
    ((WITH, _SIDE), (ROBUST, replace(_SIDE, support="robust")), (WITHOUT, replace(_SIDE, support="shape"))),
    _support_rows,
)
TRIALS = (T1, T2, T3, T_EM)
