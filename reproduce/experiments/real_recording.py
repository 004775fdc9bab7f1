"""recording, chapter: the tracker on the real recording `balance_4view`, against its reference and its masks.

`recording` gives the tracker fewer frames per second, or two cameras; body and first pose are those of four cameras in
every arm. `chapter` is the system of Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", Fig.
11.9: level set, no brightness, prediction by flow, prior; its arms are the channels and statistics of the regions.

    TWISTCAP_DATA=... python -m reproduce recording
    TWISTCAP_DATA=... TWISTCAP_PRIOR=walk.npz python -m reproduce chapter --out out/chapter
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import cv2
import numpy as np

from reproduce.arms import Findings
from reproduce.recorded import data_file
from reproduce.running import Tell
from twistcap.body import Pose
from twistcap.build import build
from twistcap.cues.levelset import LevelSetContour
from twistcap.evaluate import Row, evaluate, row
from twistcap.hindsight import Hindsight
from twistcap.io.recording import open_recording, rig_of, views_of
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.session import load_session
from twistcap.track import Model, Tracker

EXAMPLES = Path(__file__).parents[2] / "examples"
Settings = Mapping[str, Any]
"""Settings of a session that an arm changes, by dotted name."""

CAMERAS = ("cam01", "cam02", "cam03", "cam04")
RATES: dict[str, Settings] = {f"{60 // step} fps": {"step": step} for step in (1, 2, 3)}
PAIRS: dict[str, Settings] = {"+".join(pair): {"cameras.use": list(pair)} for pair in combinations(CAMERAS, 2)}
REGIONS: dict[str, Settings] = {
    f"{channels}, {statistics}": {"tracker.channels": channels, "tracker.statistics": statistics}
    for statistics in ("part", "whole")
    for channels in ("grey", "lab", "grey+texture", "lab+texture")
}

CLOCK = 0.02167  # s that the reference's clock is behind
FLAWED = ("wrist_r:75-79", "wrist_r:86-92")  # of the reference
MEASURES = {
    "IoU": ("IoU, mean", "share"),
    "joints": ("joints, median", "mm"),
    "offset removed": ("joints, median, offset removed", "mm"),
    "lost": ("lost frames, by the reference", "frames"),
    "by itself": ("lost frames, by the tracker itself", "frames"),
}


@dataclass(frozen=True)
class RealRecording:
    """Arms that track one session; an `Experiment`. It draws no numbers at random, so that seeds change nothing.

    Attributes:
        id, says: as of every experiment.
        session: file among the examples.
        arms: what each arm changes in it.
        changed: what is changed of the model that a session makes, for what no setting names.
    """

    id: str
    says: str
    session: str
    arms: Mapping[str, Settings]
    changed: Callable[[Model], Model] = lambda model: model

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows of all arms; result files go into the folder `out`.

        Raises:
            InputError: where TWISTCAP_DATA does not have the recording.
        """
        del seeds
        data_file("balance_4view")  # asked for before minutes of tracking
        cv2.setNumThreads(1)
        rows: list[Row] = []
        with TemporaryDirectory() as temporary:
            folder = out or Path(temporary)
            for done, (arm, changed) in enumerate(self.arms.items(), 1):
                path = folder / f"{arm}.h5"
                ms = tracked(EXAMPLES / self.session, changed, path, self.changed)
                rows += [*against_reference(f"{self.id} {arm}", path), row(f"{self.id} {arm}", "frame", ms, "ms")]
                progress(arm, done, len(self.arms))
        return Findings(rows, "", ())


def widened(model: Model) -> Model:
    """The chapter's level set for this person in a cap: EM, all of a part's pixels, a gap for what the cap covers.

    Narrow windows lose the head at once. A part that agrees less than it used to is looked for farther off.
    """
    cue = next(cue for cue in model.cues if isinstance(cue, LevelSetContour))
    wide = replace(cue, rounds=2, prior_mass=1.0, gap=0.015)
    return replace(model.with_cue(wide), schedule=replace(model.schedule, slip=0.85))


def tracked(
    file: Path, changed: Settings, path: Path, modified: Callable[[Model], Model] = lambda model: model,
    started: Callable[[Pose], Pose] = lambda pose: pose,
) -> float:  # fmt: skip
    """Track a session into a result file, from the body and first pose of all its cameras, `modified` and `started`.

    Returns:
        the median of a frame, ms, decoding apart.
    """
    session, start = load_session(file, dict(changed)), open_recording(load_session(file))
    rig = rig_of(session)
    views = views_of(session, rig)
    tracker = Tracker(modified(build(start.body, views.image_rig, session.tracker_settings, session.pose_prior)))
    tracker.start(started(start.first_pose), start.first_time)
    hindsight, times = Hindsight(tracker), list[float]()
    with ResultWriter(path, start.body, rig, session.model_dump(mode="json")) as writer:
        for frame in views:
            began = perf_counter()
            corrected, estimate = hindsight.step(frame)
            times.append(1000.0 * (perf_counter() - began))
            writer.append(estimate)
            writer.correct(corrected)
    return float(np.median(times[1:]))


def against_reference(case: str, path: Path) -> list[Row]:
    """Overlap, joints and lost frames of a result file, also in cameras that it was not tracked in."""
    data, result = data_file("balance_4view"), read_result(path)
    rig = rig_of(load_session(EXAMPLES / RECORDING.session))
    result = replace(result, rig=rig, sources=np.tile(np.arange(len(rig)), (len(result.indices), 1)))
    points = evaluate(result, data / "reference" / "keypoints3d_world.npz", CLOCK, exclude=FLAWED)
    found = {r["metric"]: r["value"] for r in (*points.rows, *evaluate(result, data / "masks").rows)}
    frames = row(case, "frames", float(len(result.indices)), "frames")
    return [frames, *(row(case, name, float(found[of] or 0.0), unit) for name, (of, unit) in MEASURES.items())]


RECORDING = RealRecording(
    "recording", "a real recording at 60, 30 and 20 frames per second, and in each pair of its four cameras",
    "balance_4view.toml", RATES | PAIRS,
)  # fmt: skip
CHAPTER = RealRecording(
    "chapter", "the chapter's own system on a real recording: channels of the regions, statistics by part or whole",
    "balance_4view_chapter.toml", REGIONS, widened,
)  # fmt: skip
