"""renderer: people that another renderer has filmed, in rooms and clothes that are not the studio's.

The captures `blender_*` have their truth. Each is tracked with the exact body, the humanoid, and the humanoid after
`body fit` to the same capture, in all four cameras; the first two also in each pair of neighbours. Seed 0 takes the
pictures as they are, each other seed adds its own noise of 1.5 grey levels.

    TWISTCAP_DATA=... python -m reproduce renderer --seeds 0-7
    TWISTCAP_DATA=... python -m reproduce renderer-starts      # the first pose from the images alone
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from reproduce.arms import Findings
from reproduce.faults.measures import delays
from reproduce.recorded import data_file
from reproduce.running import Tell, jobs, over_seeds
from twistcap.adjust.body_fit import Take, fit_body
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Posed
from twistcap.build import build
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.evaluate import Row, row
from twistcap.evaluate.metrics import LOST_FRAME_MM, distances_mm, within_sigmas, without_offset
from twistcap.hindsight import Hindsight
from twistcap.io.recording import Recording, body_of, floor_of, open_recording, rig_of, views_of
from twistcap.io.session import Session, load_session
from twistcap.io.unaided import found_unaided
from twistcap.io.video import Views
from twistcap.track import Tracker

CLIPS, BODIES = ("run", "kick", "spin"), {"exact": "glb.toml", "humanoid": "humanoid.toml"}
FITTED = "fitted humanoid"
JOINTS = tuple(f"{joint}_{side}" for joint in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist") for side in "rl")
CAMERAS = ("cam01", "cam02", "cam03", "cam04")
PAIRS = tuple(zip(CAMERAS, (*CAMERAS[1:], CAMERAS[0]), strict=True))
NOISE = 1.5  # grey levels
AFTER, WITHIN_MM = 10, 30.0  # the frame whose joints tell whether a first pose was right
SOON = 5  # frames within which a lost stretch should be flagged

Subject = tuple[str, str, tuple[str, ...]]
"""Clip, body, cameras."""
FOUR: tuple[Subject, ...] = tuple(product(CLIPS, (*BODIES, FITTED), (CAMERAS,)))
TWO: tuple[Subject, ...] = tuple(product(CLIPS, BODIES, PAIRS))


@dataclass(frozen=True)
class Tracked:
    """One subject's track: errors (N, J) mm raw and with the constant offset removed, frames (N,) flagged, and z-scores
    (N, J, 3) of the joints' places, offset removed.
    """

    raw: Float
    offset_removed: Float
    flagged: Bool
    z: Float

    @property
    def lost(self) -> Bool:
        """(N,) frames with a joint more than 150 mm off."""
        return self.raw.max(axis=1) > LOST_FRAME_MM


def tracked(subject: Subject, seed: int) -> Tracked:
    """A subject's track, in the pictures of a seed, against its truth."""
    clip, body, cameras = subject
    folder = data_file(f"blender_{clip}")
    recording, path = _subject(folder, body)
    session = load_session(path, {"cameras.use": list(cameras)} if cameras != CAMERAS else {})
    views = views_of(session, rig_of(session))
    return _from_first_pose(recording, session, views, noisy(views, seed))


def started(clip: str, body: str) -> Tracked:
    """The track from a first pose that is found in the images alone. Raises InputError where it is refused."""
    recording, path = _subject(data_file(f"blender_{clip}"), body)
    session = load_session(path)
    views = views_of(session, rig_of(session))
    person = recording.body if body == FITTED else body_of(session)  # not at the lengths that keypoints say
    proof = found_unaided(session, person, views, floor_of(session))
    recording = replace(recording, body=person, first_pose=proof.first)
    return _from_first_pose(recording, session, views, views)


def _from_first_pose(recording: Recording, session: Session, views: Views, frames: Iterable[Frame]) -> Tracked:
    tracker = Tracker(build(recording.body, views.image_rig, session.tracker_settings))
    tracker.start(recording.first_pose, recording.first_time)
    estimates = list(Hindsight(tracker).through(frames))
    with np.load(Path(session.source).parent / "truth.npz") as truth:
        places = dict(zip(truth["names"], truth["X"].transpose(1, 0, 2), strict=True))
    return _against(recording, estimates, np.stack([places[joint] for joint in JOINTS], axis=1))


@cache
def _subject(folder: Path, body: str) -> tuple[Recording, Path]:
    """The recording with a body and its first pose, and its session."""
    path = folder / BODIES.get(body, BODIES["humanoid"])
    recording = open_recording(load_session(path))
    if body == FITTED:
        take = Take(recording.views.image_rig, recording.views, recording.first_pose)
        fitted = fit_body(recording.body, [take])
        recording = replace(recording, body=fitted.body, first_pose=fitted.first_poses[0])
    return recording, path


def noisy(frames: Any, seed: int) -> Iterator[Frame]:
    """The frames with a seed's noise; those of seed 0 are as they are."""
    rng = np.random.default_rng(seed)
    for frame in frames:
        yield frame if seed == 0 else replace(frame, images=tuple(_noisy(image, rng) for image in frame.images))


def _noisy(image: Any, rng: np.random.Generator) -> Any:
    if image is None:
        return None
    return np.clip(image + NOISE * rng.standard_normal(image.shape), 0, 255).round().astype(np.uint8)


def _against(recording: Recording, estimates: Sequence[Estimate], truth: Float) -> Tracked:
    posed = [Posed(recording.body, e.pose) for e in estimates]
    marks = [recording.body.landmarks.index(joint) for joint in JOINTS]
    difference = np.stack([p.landmarks[marks] for p in posed]) - truth[: len(posed)]
    rest = without_offset(difference)
    sigma = np.stack([_sigma(recording.body, p, e.covariance, marks) for p, e in zip(posed, estimates, strict=True)])
    return Tracked(distances_mm(difference), distances_mm(rest), np.array([e.lost for e in estimates]), rest / sigma)


def _sigma(body: Body, posed: Posed, covariance: Float, marks: Sequence[int]) -> Float:
    """(J, 3) m standard deviations of joints."""
    places = body.landmarks
    J = posed.point_jacobian(places.segments[marks, None], np.ones((len(marks), 1)), places.points[marks])
    return np.sqrt(np.maximum(np.einsum("kij,jl,kil->ki", J, covariance, J), 1e-12))


def _rows(case: str, runs: Sequence[Tracked], views: int) -> list[Row]:
    """Of all runs of a subject."""
    lost, flagged = (np.concatenate([getattr(r, name) for r in runs]) for name in ("lost", "flagged"))
    per_run = [float(r.lost.sum()) for r in runs]
    late = sum(d > SOON for r in runs for d in delays(r.lost, r.flagged))
    found = {
        "lost frames": (float(np.mean(per_run)), "frames"),
        "lost and not flagged": (float((lost & ~flagged).sum()) / len(runs), "frames"),
        f"lost stretches not flagged within {SOON} frames": (late / len(runs), "stretches"),
        "flagged falsely": (100.0 * float((flagged & ~lost).mean()), "% of frames"),
        "joints, mean": (float(np.mean([r.raw.mean() for r in runs])), "mm"),
        "joints, mean, offset removed": (float(np.mean([r.offset_removed.mean() for r in runs])), "mm"),
        "joints within 2σ": (within_sigmas(np.concatenate([r.z.ravel() for r in runs]), 2.0), "share"),
    }
    bars = {"lost frames": 5.0 if "spin" in case else 0.0} if views == 4 else {}
    each = {"lost frames": per_run}
    return [row(case, name, *value, at_most=bars.get(name), seeds=each.get(name)) for name, value in found.items()]


@dataclass(frozen=True)
class AnotherRenderer:
    """The experiment; see `Experiment`."""

    id: str = "renderer"
    says: str = "people that another renderer has filmed: exact body, humanoid, and that after body fit"
    subjects: Sequence[Subject] = FOUR

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows of every clip, body and choice of cameras; as many seeds at once as the environment variable JOBS says.

        Raises:
            InputError: where TWISTCAP_DATA does not have the captures.
        """
        del out
        data_file("blender_run")
        rows: list[Row] = []
        for clip, body, cameras in self.subjects:
            case = f"{self.id} {clip}, {body}" + ("" if cameras == CAMERAS else f", {'+'.join(cameras)}")
            runs = over_seeds(partial(tracked, (clip, body, cameras)), seeds, progress, case, jobs(1))
            rows += _rows(case, runs, len(cameras))
        return Findings(rows, "", ())


@dataclass(frozen=True)
class Starts:
    """The experiment; see `Experiment`."""

    id: str = "renderer-starts"
    says: str = "the first pose of these people from the images alone: joints after ten frames"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows of every clip and body; seeds change nothing. A first pose that is refused has NaN.

        Raises:
            InputError: where TWISTCAP_DATA does not have the captures.
        """
        del seeds, out
        data_file("blender_run")
        rows: list[Row] = []
        for clip, body in product(CLIPS, (*BODIES, FITTED)):
            case = f"{self.id} {clip}, {body}"
            progress(case)
            bar = None if body == "humanoid" else WITHIN_MM  # whose limbs are as long as most people's, not as these
            try:
                raw = started(clip, body).raw
            except InputError:
                raw = np.full((AFTER + 1, 1), np.nan)
            rows += [
                row(case, "joints in the first frame", float(raw[0].mean()), "mm"),
                row(case, "joints after ten frames", float(raw[AFTER].mean()), "mm", at_most=bar),
            ]
        return Findings(rows, "", ())


RENDERER, RENDERER_STARTS = AnotherRenderer(), Starts()
RENDERER_PAIRS = replace(
    RENDERER, id="renderer-pairs", says="the same in each pair of neighbouring cameras", subjects=TWO
)
