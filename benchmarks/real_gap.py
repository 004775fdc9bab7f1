"""The real recording with images missing in its middle: does the track go on, and as well as undisturbed?

    python benchmarks/real_gap.py [--first 43] [--frames 15] [--seed 0] [--json]

`balance_4view` of shared data at half size, generic body. The library holds other people's standing, stepping, walking
and jumping (CMU, DeepMimic), never this recording. IoU is that with the hand-mended masks of the frames after the gap,
and with the undisturbed run's own silhouettes in every frame after it. The search draws at random: --seed.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from reproduce.recorded import Recording, data_file
from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.cues.limbs import LimbRule
from twistcap.cues.reacquire import ReacquireRule
from twistcap.estimate import Estimate, Frame
from twistcap.evaluate.metrics import iou
from twistcap.io.masks import read_masks
from twistcap.io.recording import open_recording
from twistcap.io.session import load_session
from twistcap.motion import MotionLibrary
from twistcap.render import render
from twistcap.track import TrackerConfig, track

SESSION = Path(__file__).parents[1] / "examples" / "balance_4view.toml"
DATA = Path(os.environ.get("TWISTCAP_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))
MASKED = (60, 80)  # frames behind the gap of which there are masks
CMU = ("01_01.amc", "07_02.amc", "08_02.amc", "08_04.amc", "11_01.amc")
MIMIC = ("walk", "jump", "kick", "punch")
ARMS = {
    "undisturbed": TrackerConfig(),
    "followed": TrackerConfig(predictor="motion", motion="followed"),
    "guarded": TrackerConfig(predictor="motion", motion="guarded"),
    "guarded, sought": TrackerConfig(predictor="motion", motion="guarded", reacquire=ReacquireRule()),
    "guarded, sought, limbs too": TrackerConfig(
        predictor="motion", motion="guarded", reacquire=ReacquireRule(), limbs=LimbRule()
    ),
    "scaled (paper)": TrackerConfig(predictor="motion", motion="scaled"),
    "autoregressive": TrackerConfig(predictor="motion", motion="autoregressive"),
    "constant velocity": TrackerConfig(),
}


def library(body: Body, rate: float) -> MotionLibrary:
    """Motion of other people."""
    clips = [Recording(f"motions/cmu/{name}") for name in CMU]
    clips += [Recording(f"motions/deepmimic/humanoid3d_{name}.txt") for name in MIMIC]
    return MotionLibrary.of([clip.clip(body, rate) for clip in clips], rate, mirrored=True)


def without_images(frames: Sequence[Frame], first: int, last: int) -> Iterator[Frame]:
    """The frames, those from `first` to `last` without their images."""
    for frame in frames:
        gone = first <= frame.index <= last
        yield replace(frame, images=tuple(None for _ in frame.images)) if gone else frame


def overlap_with_masks(body: Body, rig: Rig, estimates: Sequence[Estimate]) -> float:
    """Mean IoU over cameras and masked frames."""
    found = {e.index: Posed(body, e.pose) for e in estimates}
    folder = str(data_file("balance_4view") / "masks")
    return float(
        np.mean(
            [
                iou(render(found[k], camera.pinhole()).mask, mask)
                for k in MASKED
                for camera, mask in zip(rig, read_masks(folder, rig, k), strict=True)
            ]
        )
    )


def overlap(body: Body, rig: Rig, ours: Sequence[Estimate], theirs: Sequence[Estimate]) -> list[float]:
    """Mean IoU over cameras of two runs' silhouettes, by frame."""
    out: list[float] = []
    for a, b in zip(ours, theirs, strict=True):
        masks = [[render(Posed(body, e.pose), camera).mask for camera in rig] for e in (a, b)]
        out.append(float(np.mean([iou(x, y) for x, y in zip(*masks, strict=True)])))
    return out


def main() -> None:
    """One row per arm."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--first", type=int, default=43)
    parser.add_argument("--frames", type=int, default=15)
    parser.add_argument("--last", type=int, default=90, help="frame at which tracking ends")
    parser.add_argument("--arms", nargs="*", default=list(ARMS), choices=list(ARMS))
    parser.add_argument("--seed", type=int, default=0, help="of the search's draws")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    os.environ.setdefault("TWISTCAP_DATA", str(DATA.resolve()))
    recording = open_recording(load_session(SESSION, {"frames": [0, given.last]}))
    body, rig, frames = recording.body, recording.views.image_rig, list(recording.views)
    motions, behind = library(body, recording.views.fps), given.first + given.frames
    rows, undisturbed = list[dict[str, object]](), list[Estimate]()
    for name in given.arms:
        config = ARMS[name]
        if config.reacquire is not None:
            config = replace(config, reacquire=replace(config.reacquire, seed=given.seed))
        if config.limbs is not None:
            config = replace(config, limbs=replace(config.limbs, seed=given.seed))
        last = -1 if name == "undisturbed" else behind - 1
        shown = without_images(frames, given.first, last)
        used = motions if config.predictor == "motion" else None
        estimates = list(track(shown, body, rig, recording.first_pose, config, motions=used))
        undisturbed = undisturbed or estimates
        same = overlap(body, rig.pinhole(), estimates[behind:], undisturbed[behind:])
        gap = overlap(body, rig.pinhole(), estimates[given.first : behind], undisturbed[given.first : behind])
        row = {
            "arm": name,
            "IoU with masks after the gap": overlap_with_masks(body, recording.rig, estimates),
            "with the undisturbed run, in the gap": float(np.mean(gap)),
            "first frames after it": [round(v, 3) for v in same[:5]],
            "all frames after it": float(np.mean(same)),
            "lost": sum(e.lost for e in estimates),
        }
        rows.append(row)
        if not given.json:
            print(row, flush=True)
    if given.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
