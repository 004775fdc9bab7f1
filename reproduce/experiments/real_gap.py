"""real-gap: fifteen frames of a real recording without their images, and how well the tracker is back behind them.

`balance_4view` of shared data at half size, generic body. The library holds other people's standing, stepping, walking
and jumping (CMU, DeepMimic), never this recording. IoU is that with the hand-mended masks of the frames after the gap,
and with the undisturbed run's own silhouettes. The search draws at random: its draws are of the seed.

    TWISTCAP_DATA=... python -m reproduce real-gap --seeds 0-7
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.autoregressive import with_autoregression
from reproduce.recorded import Recording, data_file
from reproduce.running import Tell
from twistcap.body import Body, Posed
from twistcap.build import build
from twistcap.camera import Rig
from twistcap.estimate import Estimate, Frame
from twistcap.evaluate import Row, row
from twistcap.evaluate.metrics import iou
from twistcap.hindsight import tracked
from twistcap.io import recording as recordings
from twistcap.io.masks import read_masks
from twistcap.io.session import load_session
from twistcap.motion import MotionLibrary
from twistcap.render import render
from twistcap.search.body import BodyRule
from twistcap.search.lost import LostBody
from twistcap.search.placing import PlacingRule
from twistcap.track import Model, Settings

SESSION = Path(__file__).parents[2] / "examples" / "balance_4view.toml"
GAP = (43, 57)  # first and last frame without images
LAST = 90  # frame at which tracking ends
MASKED = (60, 80)  # frames behind the gap of which there are masks
CMU = ("01_01.amc", "07_02.amc", "08_02.amc", "08_04.amc", "11_01.amc")
MIMIC = ("walk", "jump", "kick", "punch")

Track = Sequence[Estimate]
"""One estimate for each frame."""

UNDISTURBED, LINEAR = "undisturbed", "autoregressive"
ARMS = {
    UNDISTURBED: Settings(),
    "guarded": Settings(predictor="motion", motion="guarded"),
    "followed": Settings(predictor="motion", motion="followed"),
    "scaled (paper)": Settings(predictor="motion", motion="scaled"),
    LINEAR: Settings(predictor="motion"),
    "constant velocity": Settings(),
}


def drawn(model: Model, seed: int) -> Model:
    """The model with the searches' draws of a seed."""
    return replace(model, searches=(LostBody(whole=BodyRule(placing=PlacingRule(seed=seed))),))


@dataclass(frozen=True)
class RealGap:
    """The experiment; see `Experiment`."""

    id: str = "real-gap"
    says: str = "a real recording, 4 views, 15 frames without images, other people's motion known: overlap after them"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows of every arm; those that search run once for each seed."""
        del out
        data_file("balance_4view")
        recording = recordings.open_recording(load_session(SESSION, {"frames": [0, LAST]}))
        body, rig, frames = recording.body, recording.views.image_rig, list(recording.views)
        motions = library(body, recording.views.fps)
        rows, reference = list[Row](), list[Estimate]()
        for done, (name, config) in enumerate(ARMS.items(), 1):
            shown = frames if name == UNDISTURBED else list(without_images(frames, *GAP))
            used = motions if config.predictor == "motion" else None
            draws, model = seeds if name == "guarded" else seeds[:1], build(body, rig, config, motions=used)
            model = with_autoregression(model, motions) if name == LINEAR else model
            runs = [list(tracked(shown, drawn(model, seed), recording.first_pose)) for seed in draws]
            reference = reference or runs[0]
            rows += self._rows(name, body, recording.rig, rig.pinhole(), runs, reference)
            progress(name, done, len(ARMS))
        return Findings(rows, "", ())

    def _rows(self, arm: str, body: Body, rig: Rig, seen: Rig, runs: Sequence[Track], reference: Track) -> list[Row]:
        case, behind = f"{self.id} {arm}", GAP[1] + 1
        masks = [overlap_with_masks(body, rig, run) for run in runs]
        gap = [overlap(body, seen, run[GAP[0] : behind], reference[GAP[0] : behind]) for run in runs]
        after = [overlap(body, seen, run[behind:], reference[behind:]) for run in runs]
        lost = [float(sum(e.lost for e in run)) for run in runs]
        measured = (
            ("IoU with masks after the gap", masks, "share"),
            ("IoU with the undisturbed run, in the gap", gap, "share"),
            ("IoU with the undisturbed run, after it", after, "share"),
            ("lost frames", lost, "frames"),
        )
        return [row(case, name, float(np.mean(values)), unit, seeds=values) for name, values, unit in measured]


def library(body: Body, rate: float) -> MotionLibrary:
    """Motion of other people."""
    clips = [Recording(f"motions/cmu/{name}") for name in CMU]
    clips += [Recording(f"motions/deepmimic/humanoid3d_{name}.txt") for name in MIMIC]
    return MotionLibrary.of([clip.clip(body, rate) for clip in clips], rate, mirrored=True)


def without_images(frames: Sequence[Frame], first: int, last: int) -> Iterator[Frame]:
    """The frames, those from `first` to `last` without their images."""
    for frame in frames:
        missing = first <= frame.index <= last
        yield replace(frame, images=tuple(None for _ in frame.images)) if missing else frame


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
                if mask is not None
            ]
        )
    )


def overlap(body: Body, rig: Rig, ours: Sequence[Estimate], theirs: Sequence[Estimate]) -> float:
    """Mean IoU of two runs' silhouettes over cameras and frames."""
    return float(
        np.mean(
            [
                iou(render(Posed(body, a.pose), camera).mask, render(Posed(body, b.pose), camera).mask)
                for a, b in zip(ours, theirs, strict=True)
                for camera in rig
            ]
        )
    )


REAL_GAP = RealGap()
