"""Motions of shared data, as cases for `motion_prediction`."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from motion_prediction import Case

from reproduce.recorded import Recording
from twistcap.body.humanoid import humanoid
from twistcap.io.motion_files import poses_from_mot, read_mot
from twistcap.motion import MotionClip

DATA = Path(os.environ.get("TWISTCAP_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))
BODY = humanoid("legs")
WALK = "opensim_gait/Pipelines/Gait10dof18musc/OutputReference/IK/subject01_walk_IK.mot"
MIMIC = "motions/deepmimic/humanoid3d"
RUN = "opensim_gait/Pipelines/Hamner/outputReference/ResultsIK/subject02_running_ik.mot"


def clip_of(path: str, rate: float = 60.0) -> MotionClip:
    """A MOT of shared data in our coordinates."""
    table = read_mot(DATA / path)
    poses, _ = poses_from_mot(table, BODY)
    fps = (len(table.times) - 1) / float(table.times[-1] - table.times[0])
    roots, q = np.array([pose.root for pose in poses]), np.array([pose.q for pose in poses])
    return MotionClip(Path(path).stem, BODY.coordinate_names, fps, roots, q).resampled(rate)


def part(clip: MotionClip, start: int, end: int) -> MotionClip:
    """Poses start … end − 1."""
    return replace(clip, name=f"{clip.name} {start}-{end}", roots=clip.roots[start:end], q=clip.q[start:end])


def opensim_cases() -> list[Case]:
    """Walking and running, each from another stretch of its own recording."""
    walk, run = clip_of(WALK), clip_of(RUN)
    return [
        Case("walk, second half", part(walk, 75, len(walk)), (part(walk, 0, 76),), 25),
        Case("walk, first half", part(walk, 0, 76), (part(walk, 75, len(walk)),), 25),
        Case("run, 25 frames", part(run, 280, 560), (part(run, 0, 260),), 25),
        Case("run, 45 frames", part(run, 280, 560), (part(run, 0, 260),), 45),
    ]


def other_cases() -> list[Case]:
    """CMU and DeepMimic, retargeted: from another speed, another person, and with one clip left out."""
    walk = {k: Recording(f"motions/cmu/{k}").clip(BODY, 60.0) for k in ("07_02.amc", "08_02.amc", "08_04.amc")}
    mimic = {k: Recording(f"{MIMIC}_{k}.txt", cycles=4).clip(BODY, 60.0) for k in ("walk", "run", "jog")}
    ran = part(clip_of(RUN), 0, 260)
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
