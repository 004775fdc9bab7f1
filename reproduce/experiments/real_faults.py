"""real-faults: the recording `balance_4view` with faults, and the same trial with a second person in the pictures.

- All images removed for 5, 20 and 60 frames at twelve phases each: is the man found again within ten frames?
- One camera turned by 2 degrees from frame 50 on: is it named, and does the track go on?
- Each camera in turn up to 5 frames late or 3 early from frame 30 on: is it left out, and does the track go on? With
  all cameras, and with three of them.
- The videos of two cameras of one size exchanged for 20 frames, with all cameras and with these two alone.
- `balance_two_people`: a second person hides the man in part. All four cameras, then each one left out.

The undisturbed track stands for the truth of gaps, bumps, clocks and swaps, the reference for two people.

    TWISTCAP_DATA=... python -m reproduce real-faults
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from reproduce.arms import Findings
from reproduce.experiments.real_gap import SESSION, without_images
from reproduce.experiments.real_recording import CAMERAS, CLOCK, FLAWED
from reproduce.recorded import data_file
from reproduce.running import Tell
from twistcap.arrays import Float
from twistcap.body import Body, Posed
from twistcap.build import build
from twistcap.camera import Rig
from twistcap.camera.bump import homography
from twistcap.estimate import Estimate, Frame
from twistcap.evaluate import Row, evaluate, row
from twistcap.evaluate.metrics import JOINT_CENTRES, LOST_FRAME_MM
from twistcap.hindsight import Hindsight
from twistcap.io.recording import Recording, open_recording, rig_of, views_of
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.session import load_session
from twistcap.io.video import Views
from twistcap.track import Model, State, Tracker

LENGTHS, PHASES, SOON = (5, 20, 60), 12, 10  # frames of a gap; where it begins; frames after it
FIRST, LAST = 12, 99  # frames between which gaps and what follows them lie
BUMPED, DEGREES = 50, 2.0  # from which frame on, by how much a camera is turned
SHIFTED, SHIFTS = 30, (-5, -3, -2, 2, 3)  # from which frame on a camera shows another one, and how much later that is
THREE, SHIFTS_OF_THREE = (CAMERAS[:3], CAMERAS[1:]), (-3, 2)
PAIRS, SWAPPED = ((0, 1), (2, 3)), range(50, 70)  # cameras that give each other's pictures, and when


_Seen = tuple[Model, Sequence[Frame], Sequence[Estimate], Sequence[State]]
"""Frames, with their undisturbed track and the state before each."""


@dataclass(frozen=True)
class RealFaults:
    """The experiment; see `Experiment`. Nothing in it is random, so that seeds change nothing."""

    id: str = "real-faults"
    says: str = "a real recording with gaps, with cameras bumped, out of step or swapped, and with two people"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows of gaps, bumps, clocks, swaps and two people; result files of two people go into the folder `out`.

        Raises:
            InputError: where TWISTCAP_DATA does not have the recordings.
        """
        del seeds
        data_file("balance_two_people")  # asked for before minutes of tracking
        recording = open_recording(load_session(SESSION))
        frames, rows = list(recording.views), list[Row]()
        progress("undisturbed", 0, 5)
        model = build(recording.body, recording.views.image_rig)
        plain, states = _undisturbed(model, recording, frames)
        rows += [self._gaps(model, frames, plain, states, length) for length in LENGTHS]
        progress("gaps", 1, 5)
        for camera in range(len(CAMERAS)):
            rows += self._bump(model, frames, plain, states, camera)
        progress("bumps", 2, 5)
        rows += [r for by in SHIFTS for r in self._shift(by, [(model, frames, plain, states)])]
        seen = [_seen_by(recording, names) for names in THREE]
        rows += [r for by in SHIFTS_OF_THREE for r in self._shift(by, seen)]
        progress("clocks", 3, 5)
        for pair in PAIRS:
            rows += self._swap(recording, pair, None)
            rows += self._swap(recording, pair, pair)
        progress("swaps", 4, 5)
        with TemporaryDirectory() as temporary:
            for without in (None, *CAMERAS):
                rows += self._two_people(recording, without, out or Path(temporary))
        progress("two people", 5, 5)
        return Findings(rows, "", ())

    def _gaps(
        self, model: Model, frames: Sequence[Frame], plain: Sequence[Estimate], states: Sequence[State],
        length: int,
    ) -> Row:  # fmt: skip
        """In how many of the phases the body is where it is without the gap, ten frames after it at the latest."""
        starts = np.linspace(FIRST, LAST - length - SOON, PHASES).round().astype(int)
        errors = list[float]()
        for start in starts:
            end = start + length
            shown = without_images(frames[start : end + SOON], start, end - 1)
            after = _tracked(model, states[start], shown)[length:]
            errors.append(min(_apart_mm(model.body, e, plain[end + k]) for k, e in enumerate(after)))
        found = float(np.mean(np.array(errors) <= LOST_FRAME_MM))
        return row(f"{self.id} {length} frames without images", "found within 10 frames", found, "of 12 phases",
                   at_least=1.0, seeds=errors)  # fmt: skip

    def _bump(
        self, model: Model, frames: Sequence[Frame], plain: Sequence[Estimate], states: Sequence[State],
        camera: int,
    ) -> list[Row]:  # fmt: skip
        case = f"{self.id} {CAMERAS[camera]} bumped"
        estimates = _tracked(model, states[BUMPED], bumped(frames[BUMPED:], model.rig, camera))
        apart = np.array([_apart_mm(model.body, e, p) for e, p in zip(estimates, plain[BUMPED:], strict=True)])
        named = [k for k, e in enumerate(estimates) if camera in (*e.left_out, *e.turned)]
        lost = apart > LOST_FRAME_MM
        silent = int(np.sum(lost & ~np.array([e.lost for e in estimates])))
        return [
            row(case, "named after", float(named[0]) if named else np.inf, "frames", at_most=30.0),
            row(case, "lost frames", float(lost.sum()), "frames", at_most=0.0),
            row(case, "lost and not flagged", float(silent), "frames"),
            row(case, "worst joint from the undisturbed track, at the end", float(apart[-SOON:].mean()), "mm"),
        ]

    def _shift(self, by: int, tracks: Sequence[_Seen]) -> list[Row]:
        """Lost frames where one camera, each in turn, shows later pictures than the others, or earlier ones."""
        right, others, lost, silent, runs = 0, 0, 0, 0, 0
        for model, frames, plain, states in tracks:
            for camera in range(len(model.rig)):
                estimates = _tracked(model, states[SHIFTED], shifted(frames, camera, by))
                apart = [_apart_mm(model.body, e, p) for e, p in zip(estimates, plain[SHIFTED:], strict=False)]
                gone = np.array(apart) > LOST_FRAME_MM
                right += any(camera in e.left_out for e in estimates)
                others += sum(bool({*e.left_out} - {camera}) for e in estimates)
                lost, silent = lost + int(gone.sum()), silent + int(np.sum(gone & [not e.lost for e in estimates]))
                runs += 1
        seen = "each camera" if runs == len(CAMERAS) else "each of three cameras"
        case = f"{self.id} {seen} {abs(by)} frames {'early' if by > 0 else 'late'}"
        return [
            row(case, "left out", float(right), f"of {runs}", at_least=float(runs)),
            row(case, "frames in which another one is left out", float(others), "frames"),
            row(case, "lost frames", float(lost), "frames", at_most=0.0),
            row(case, "lost and not flagged", float(silent), "frames"),
        ]

    def _swap(self, recording: Recording, pair: tuple[int, int], use: Sequence[int] | None) -> list[Row]:
        """The videos of a pair exchanged for a while, seen by some cameras, or by all."""
        names = [CAMERAS[c] for c in use or range(len(CAMERAS))]
        views = _views_of(names)
        one, other = (CAMERAS[c] for c in pair)
        order = [names.index({one: other, other: one}.get(name, name)) for name in names]
        frames, exchanged = list(views), list(replace(views, sources=tuple(views.sources[k] for k in order)))
        model = build(recording.body, views.image_rig)
        plain, states = _undisturbed(model, recording, frames)
        first, end = SWAPPED.start, SWAPPED.stop
        estimates = _tracked(model, states[first], [*exchanged[first:end], *frames[end:]])
        apart = [_apart_mm(model.body, e, p) for e, p in zip(estimates, plain[first:], strict=True)]
        swapped = [len(e.swapped) == 2 for e in estimates]
        case = f"{self.id} {one} and {other} swapped" + ("" if use is None else ", they alone")
        right = [said == (k in SWAPPED) for k, said in enumerate(swapped, first)]
        return [
            row(case, "frames in which that is known", float(np.sum(right)), f"of {len(right)}",
                at_least=float(len(right))),
            row(case, "lost frames", float(np.sum(np.array(apart) > LOST_FRAME_MM)), "frames", at_most=0.0),
            row(case, "worst joint from the undisturbed track, meanwhile", float(np.max(apart[: end - first])), "mm"),
        ]  # fmt: skip

    def _two_people(self, recording: Recording, without: str | None, folder: Path) -> list[Row]:
        """The man by his reference, from the body and the first pose of `balance_4view`."""
        use = [name for name in CAMERAS if name != without]
        session = load_session(SESSION, {"data": str(data_file("balance_two_people")), "cameras.use": use})
        views = views_of(session, rig_of(session))
        tracker, path = Tracker(build(recording.body, views.image_rig)), folder / f"two people without {without}.h5"
        tracker.start(recording.first_pose, recording.first_time)
        with ResultWriter(path, recording.body, rig_of(session), {}) as writer:
            for estimate in Hindsight(tracker).through(views):
                writer.append(estimate)
        result, reference = read_result(path), data_file("balance_4view") / "reference" / "keypoints3d_world.npz"
        found = evaluate(result, reference, CLOCK, exclude=FLAWED)
        lost = np.isin(result.indices, found.lost_frames)
        case = f"{self.id} two people" + ("" if without is None else f", without {without}")
        median = next(r["value"] for r in found.rows if r["metric"] == "joints, median")
        return [
            row(case, "lost frames", float(lost.sum()), "frames", at_most=0.0 if without is None else 5.0),
            row(case, "lost and not flagged", float((lost & ~result.lost).sum()), "frames", at_most=0.0),
            row(case, "flagged falsely", float((result.lost & ~lost).sum()), "frames", at_most=0.0),
            row(case, "joints, median", float(median or np.inf), "mm", at_most=30.0),
        ]


def _seen_by(recording: Recording, names: Sequence[str]) -> _Seen:
    """The undisturbed track as some cameras see it."""
    views = _views_of(names)
    model, frames = build(recording.body, views.image_rig), list(views)
    return model, frames, *_undisturbed(model, recording, frames)


def _views_of(names: Sequence[str]) -> Views:
    """The recording seen by some cameras."""
    session = load_session(SESSION, {"cameras.use": list(names)})
    return views_of(session, rig_of(session))


def bumped(frames: Sequence[Frame], rig: Rig, camera: int) -> Iterator[Frame]:
    """The frames as if one camera had been turned about its own vertical."""
    turn = homography(rig[camera].K, np.deg2rad([0.0, DEGREES, 0.0]))
    for frame in frames:
        images = list(frame.images)
        image = images[camera]
        if image is not None:
            images[camera] = cv2.warpPerspective(image, turn, rig[camera].size, borderMode=cv2.BORDER_REPLICATE)
        yield replace(frame, images=tuple(images))


def shifted(frames: Sequence[Frame], camera: int, by: int) -> Iterator[Frame]:
    """The frames from `SHIFTED` on with the pictures of one camera from `by` frames later."""
    for k in range(SHIFTED, min(len(frames), len(frames) - by)):
        images = list(frames[k].images)
        images[camera] = frames[k + by].images[camera]
        yield replace(frames[k], images=tuple(images))


def _undisturbed(model: Model, recording: Recording, frames: Sequence[Frame]) -> tuple[list[Estimate], list[State]]:
    """The track of all frames, and the state before each of them."""
    tracker = Tracker(model)
    tracker.start(recording.first_pose, recording.first_time)
    estimates, states = list[Estimate](), list[State]()
    for frame in frames:
        states.append(tracker.state)
        estimates.append(tracker.step(frame))
    return estimates, states


def _tracked(model: Model, state: State, frames: Iterable[Frame]) -> list[Estimate]:
    """The track that goes on from a state."""
    tracker = Tracker(model)
    tracker.state = state
    return list(Hindsight(tracker).through(frames))


def _apart_mm(body: Body, one: Estimate, other: Estimate) -> float:
    """How far the farthest joint centre of two poses is apart."""
    marks = [body.landmarks.index(name) for name in JOINT_CENTRES]
    a, b = (Posed(body, e.pose).landmarks[marks] for e in (one, other))
    gaps: Float = np.linalg.norm(a - b, axis=1)
    return 1000.0 * float(gaps.max())


REAL_FAULTS = RealFaults()
