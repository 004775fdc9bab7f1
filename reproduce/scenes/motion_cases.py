"""Motions of shared data, as cases for predictions without any image."""

from __future__ import annotations

from dataclasses import dataclass, replace

from reproduce.recorded import Recording
from twistcap.body.humanoid import humanoid
from twistcap.motion import MotionClip

BODY = humanoid("legs")
RATE = 60.0
_OPENSIM = "opensim_gait/Pipelines"
WALK = f"{_OPENSIM}/Gait10dof18musc/OutputReference/IK/subject01_walk_IK.mot"
RUN = f"{_OPENSIM}/Hamner/outputReference/ResultsIK/subject02_running_ik.mot"
MIMIC = "motions/deepmimic/humanoid3d"


@dataclass(frozen=True)
class Case:
    """A clip that is tracked, what is learnt from, and how long the gaps are (frames)."""

    name: str
    tracked: MotionClip
    training: tuple[MotionClip, ...]
    gap: int


def part(clip: MotionClip, start: int, end: int) -> MotionClip:
    """Poses start … end − 1."""
    return replace(clip, name=f"{clip.name} {start}-{end}", roots=clip.roots[start:end], q=clip.q[start:end])


def opensim_cases() -> list[Case]:
    """Walking and running, each from another stretch of its own recording."""
    walk, run = Recording(WALK).clip(BODY, RATE), Recording(RUN).clip(BODY, RATE)
    return [
        Case("walk, second half", part(walk, 75, len(walk)), (part(walk, 0, 76),), 25),
        Case("walk, first half", part(walk, 0, 76), (part(walk, 75, len(walk)),), 25),
        Case("run, 25 frames", part(run, 280, 560), (part(run, 0, 260),), 25),
        Case("run, 45 frames", part(run, 280, 560), (part(run, 0, 260),), 45),
    ]


def other_cases() -> list[Case]:
    """CMU and DeepMimic, retargeted: from another speed, another person, and with one clip left out."""
    walk = {k: Recording(f"motions/cmu/{k}").clip(BODY, RATE) for k in ("07_02.amc", "08_02.amc", "08_04.amc")}
    mimic = {k: Recording(f"{MIMIC}_{k}.txt", cycles=4).clip(BODY, RATE) for k in ("walk", "run", "jog")}
    ran = part(Recording(RUN).clip(BODY, RATE), 0, 260)
    a, b, c = walk.values()
    return [
        Case("08_02 from 08_04", b, (c,), 25),
        Case("08_04 from 08_02", c, (b,), 25),
        Case("08_02 from 07_02", b, (a,), 25),
        Case("08_04 from 07_02", c, (a,), 25),
        Case("07_02 from the rest", a, (b, c, mimic["walk"]), 25),
        Case("08_02 from the rest", b, (a, c, mimic["walk"]), 25),
        Case("08_04 from the rest", c, (a, b, mimic["walk"]), 25),
        Case("DeepMimic's walk", mimic["walk"], (a, b, c), 25),
        Case("DeepMimic's run", mimic["run"], (ran, mimic["jog"]), 25),
        Case("DeepMimic's jog", mimic["jog"], (ran, mimic["run"]), 25),
    ]
