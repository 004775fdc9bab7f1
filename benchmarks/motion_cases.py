"""Motions of shared data, as cases for `motion_prediction`."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from motion_prediction import Case

from twistcap.body.humanoid import humanoid
from twistcap.io.motion_files import poses_from_mot, read_mot
from twistcap.motion import MotionClip

DATA = Path(os.environ.get("TWISTCAP_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))
BODY = humanoid("legs")
WALK = "opensim_gait/Pipelines/Gait10dof18musc/OutputReference/IK/subject01_walk_IK.mot"
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
