"""D-1 to D-5: tracking goes on through missing and noisy images by motion of the same kind.

Each seed is another person and room, and begins elsewhere in the recorded motion, so that the images fail in another
phase of the cycle. The library never holds the tracked stretch. After Rosenhahn, Brox and
others on scaled motion dynamics for markerless motion capture.

    TWISTCAP_DATA=... python -m reproduce D-1 --seeds 0-7 --out out/D-1        # D-1-speed … D-5 alike
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from reproduce.arms import Arm, Comparison, Trace, by_arm
from reproduce.recorded import Recording
from twistcap.body import Posed
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import LOST_SEQUENCE_MM, Row, row
from twistcap.motion import MotionKind, MotionLibrary
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.scene import default_body
from twistcap.track import Settings

RATE = 60.0
KNEES = ("knee_angle_r", "knee_angle_l")
JUDGED = 10  # the last of them, by which it is judged whether the track goes on

_OPENSIM = "opensim_gait/Pipelines"
WALK = f"{_OPENSIM}/Gait10dof18musc/OutputReference/IK/subject01_walk_IK.mot"
RUN = f"{_OPENSIM}/Hamner/outputReference/ResultsIK/subject02_running_ik.mot"
CMU, MIMIC = "motions/cmu", "motions/deepmimic/humanoid3d"

UNDISTURBED = Arm("undisturbed", Settings(), undisturbed=True)


def _arm(kind: MotionKind) -> Arm:
    return Arm(kind, Settings(predictor="motion", motion=kind))


@dataclass(frozen=True)
class Gaps:
    """Scenes of a recorded motion whose images fail.

    Attributes:
        tracked: the motion.
        trained: of the library; mirrored copies are added.
        views: cameras.
        spans: first and last frame of each span without images.
        frames: of a scene.
        step: frames by which each seed begins later in the motion.
        noise: knots over the frames of the fraction of pixels that noise replaces.
    """

    tracked: Recording
    trained: tuple[Recording, ...]
    views: int
    spans: tuple[tuple[int, int], ...]
    frames: int
    step: int
    noise: tuple[float, ...] = (0.0,)

    def scene(self, seed: int) -> Capture:
        """The capture of a seed."""
        config = StudioConfig(
            seed=seed, views=self.views, frames=self.frames, fps=RATE, dropped=self.spans, uniform_noise=self.noise
        )
        body = default_body(config)
        poses = self.tracked.clip(body, RATE).poses()
        begin = self.step * seed % max(1, len(poses) - self.frames + 1)
        return capture(config, body, poses[begin : begin + self.frames])

    def library(self, scene: Capture) -> MotionLibrary:
        """The training motion in the coordinates of the tracked body."""
        return MotionLibrary.of([clip.clip(scene.body, RATE) for clip in self.trained], RATE, mirrored=True)


def _gap(
    tracked: Recording, trained: Sequence[Recording], views: int, before: int, gap: int, step: int, after: int = 20
) -> Gaps:
    return Gaps(tracked, tuple(trained), views, ((before, before + gap - 1),), before + gap + after, step)


def knees_deg(scene: Capture, estimate: Estimate) -> float:
    """Mean error of both knees."""
    truth = scene.true_poses[estimate.index]
    ours, theirs = ([b.coordinate(name) for name in KNEES] for b in (scene.body, scene.true_body))
    return float(np.degrees(np.abs(estimate.pose.q[ours] - truth.q[theirs]).mean()))


def right_knee(posed: Posed) -> float:
    """Its angle, deg."""
    return float(np.degrees(posed.pose.q[posed.body.coordinate(KNEES[0])]))


def resumed(trace: Trace) -> bool:
    """Whether the body is where it should be in the last frames."""
    return float(trace.joints_mm[-JUDGED:].mean()) <= LOST_SEQUENCE_MM


Bars = dict[str, tuple[float | None, float | None]]
"""By arm: most degrees of knee error, and least fraction of the seeds that resume; None asks nothing."""


@dataclass(frozen=True)
class _Failing:
    """Rows: knee error in the frames in which images failed, and how many tracks went on."""

    id: str
    arms: tuple[str, ...]
    bars: Bars
    missing: slice

    def __call__(self, traces: Sequence[Trace]) -> list[Row]:
        out: list[Row] = []
        for arm in self.arms:
            found, (most, least) = by_arm(traces, arm), self.bars.get(arm, (None, None))
            knees = [float(t.errors[self.missing].mean()) for t in found]
            kept = [float(resumed(t)) for t in found]
            lost = len(kept) - int(sum(kept))
            case, error = f"{self.id} {arm}", float(np.mean(knees))
            out.append(row(case, "knees while images fail", error, "deg", at_most=most, seeds=knees))
            share = float(np.mean(kept))
            out.append(row(case, "tracks on", share, "share", at_least=least, seeds=kept, lost=lost))
        return out


@dataclass(frozen=True)
class _ToUndisturbed:
    """Rows of D-5: the right knee beside that of the undisturbed run, over all frames."""

    most: float

    def __call__(self, traces: Sequence[Trace]) -> list[Row]:
        out: list[Row] = []
        for arm in ("followed", "scaled"):
            pairs = zip(by_arm(traces, arm), by_arm(traces, UNDISTURBED.name), strict=True)
            apart = [_apart(a, b) for a, b in pairs]
            kept = [float(resumed(t)) for t in by_arm(traces, arm)]
            most = self.most if arm == "followed" else None
            out.append(
                row(f"D-5 {arm}", "to the undisturbed run", float(np.mean(apart)), "deg", at_most=most, seeds=apart)
            )
            lost = len(kept) - int(sum(kept))
            out.append(row(f"D-5 {arm}", "tracks on", float(np.mean(kept)), "share", seeds=kept, lost=lost))
        return out


def _apart(a: Trace, b: Trace) -> float:
    assert a.course is not None
    assert b.course is not None
    return float(np.abs(a.course - b.course).mean())


def _experiment(
    id: str, says: str, scenes: Gaps, kinds: Sequence[MotionKind], rows: Callable[..., list[Row]]
) -> Comparison:
    span = scenes.spans[0] if len(scenes.spans) == 1 else None
    return Comparison(
        id, says, "error of the knees, deg", scenes.scene, (UNDISTURBED, *map(_arm, kinds)), knees_deg, rows,
        watched="right knee, deg", course=right_knee, span=span, motions=scenes.library,
    )  # fmt: skip


def _one_gap(
    id: str, says: str, scenes: Gaps, followed: tuple[float | None, float | None], kinds: Sequence[MotionKind]
) -> Comparison:
    first, last = scenes.spans[0]
    rows = _Failing(id, (UNDISTURBED.name, *kinds), {"followed": followed}, slice(first, last + 1))
    return _experiment(id, says, scenes, kinds, rows)


_WALKING: tuple[MotionKind, ...] = ("followed", "scaled")
_RUNNING: tuple[MotionKind, ...] = ("followed", "scaled", "unscaled", "standard")
_RUN, _RAN = Recording(RUN, first=280), Recording(RUN, last=260)
_08_02, _08_04, _07_02 = (Recording(f"{CMU}/{name}.amc") for name in ("08_02", "08_04", "07_02"))

D1 = _one_gap(
    "D-1",
    "walking, 2 views, 25 frames without images, another stretch of the same recording known",
    _gap(Recording(WALK, first=75), [Recording(WALK, last=76)], 2, 22, 25, 2, after=12),
    (2.58, 1.0),
    _WALKING,
)


def _other_walk(id: str, whose: str, known: Recording, khe_deg: float) -> Comparison:
    says = f"walking, 2 views, 25 frames without images, {whose} known"
    return _one_gap(id, says, _gap(_08_02, [known], 2, 45, 25, 9), (khe_deg, 1.0), _WALKING)


D1_SPEED = _other_walk("D-1-speed", "the same person at another speed", _08_04, 3.5)
D1_OTHER = _other_walk("D-1-other", "another person's walk", _07_02, 6.0)
D2 = _experiment(
    "D-2",
    "walking, 2 views, uniform noise from 0 to all pixels and back to 0",
    Gaps(_08_02, (_08_04,), 2, (), 92, 8, noise=(0.0, 1.0, 0.0)),
    _WALKING,
    _Failing("D-2", (UNDISTURBED.name, *_WALKING), {"followed": (2.83, 1.0)}, slice(None)),
)
D3 = _one_gap(
    "D-3",
    "running, 4 views, 45 frames without images, another stretch of the same recording known",
    _gap(_RUN, [_RAN], 4, 60, 45, 6),
    (6.0, 1.0),
    _RUNNING,
)
D3_OTHERS = _one_gap(
    "D-3-others",
    "running, 4 views, 45 frames without images, running and jogging of others known",
    _gap(_RUN, [Recording(f"{MIMIC}_{name}.txt", cycles=5) for name in ("run", "jog")], 4, 60, 45, 6),
    (6.0, 7 / 8),
    _RUNNING,
)
D4 = _one_gap(
    "D-4",
    "as D-3, every second frame: twice the speed",
    _gap(replace(_RUN, every=2), [_RAN], 4, 60, 45, 5),
    (6.0, 1.0),
    _RUNNING,
)
D5 = _experiment(
    "D-5",
    "running, 4 views, four spans of 25 frames without images",
    Gaps(_RUN, (_RAN,), 4, ((50, 74), (105, 129), (160, 184), (215, 239)), 260, 8),
    _WALKING,
    _ToUndisturbed(7.3),
)
