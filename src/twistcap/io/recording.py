"""From a session to what the tracker takes: cameras, frames, body and first pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twistcap.adjust.first_pose import (
    fit_keypoints,
    fit_keypoints_sequence,
    girth_groups,
    pose_at,
    refine_on_silhouettes,
)
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose, Posed, rescaled
from twistcap.body.humanoid import humanoid
from twistcap.body.obj_rig import load_makehuman
from twistcap.body.rig import check_standing
from twistcap.camera import Camera, Rig
from twistcap.errors import InputError, naming
from twistcap.estimate import Keypoints
from twistcap.io.calibration import read_rig
from twistcap.io.cameras.axes import check_z_up, with_z_up
from twistcap.io.clocks import Clock, Timeline, image_times
from twistcap.io.detectors import detected
from twistcap.io.keypoints import (
    NoKeypoints,
    check_person,
    of_people,
    openpose_files,
    read_clicks,
    read_openpose,
    read_people,
)
from twistcap.io.masks import read_masks, rectified_masks
from twistcap.io.people import check_arrangement, same_person
from twistcap.io.plausible import check_plausible, check_upright
from twistcap.io.pose_file import body_at, read_pose
from twistcap.io.session import Session
from twistcap.io.session_tables import CameraGrid, DetectorTable, GlbBody, HumanoidBody, KeypointSet
from twistcap.io.start_report import StartReport, other_frame_in_words, start_report
from twistcap.io.unaided import found_unaided, start_in_words
from twistcap.io.video import Views, check_names, open_source, open_views

_RATES_ALIKE = 0.01  # of a frame rate, by which a video's header may differ


@dataclass(frozen=True)
class Recording:
    """A session ready to be tracked."""

    session: Session  # as read
    rig: Rig  # cameras as calibrated, in use
    views: Views  # the frames; `views.image_rig` are the cameras of their images
    body: Body  # at the fitted lengths
    first_pose: Pose  # the pose of the first frame
    note: str = ""  # how it was found, or of which frame it is, where that must be said
    report: StartReport | None = None  # how well it fits, where it was fitted to keypoints or clicks

    @property
    def first_time(self) -> float:
        """Time of the first frame, s."""
        return self.views.time(self.views.indices[0])


def open_recording(session: Session, body: Body | None = None) -> Recording:
    """Read everything a session names and check that it is possible; a `body` takes the place of ``[body]``. Raises
    InputError: whatever is missing, malformed or impossible, in one sentence.
    """
    rig = rig_of(session)
    views = views_of(session, rig)
    body = body_of(session) if body is None else body
    if not session.first_pose.unaided:
        start, pose = _first_pose(session, rig, body, views)
        return Recording(session, rig, views, start.body, pose, other_frame_in_words(session), start.report)
    check_z_up(rig, f"calibration {session.cameras.calibration}")
    shown = _shown_from(session, rig, views)
    proof = found_unaided(session, body, shown, floor_of(session))
    start = _with_girths(session, rig, _Start(body, (float(views.indices[0]),), (proof.first,)))
    check_first_pose(session, rig, start.body, proof.first)
    return Recording(session, rig, views, start.body, proof.first, start_in_words(proof, shown))


def _shown_from(session: Session, rig: Rig, views: Views) -> Views:
    """All frames of the session's file from the first on that is tracked: few tell little of where somebody is.

    By clocks that are tried, not all cameras may have all of them.
    """
    frames, together = session.whole.frames, views.timeline.together
    if session.frames == frames:
        return views
    frames = frames and (max(frames[0], together[0]), min(frames[1], together[-1]))
    whole = views_of(session.model_copy(update={"frames": frames}), rig).starting_at(views.indices[0])
    return whole if len(whole) > len(views) and whole.indices[0] == views.indices[0] else views


def open_together(sessions: Sequence[Session]) -> list[Recording]:
    """Recordings of one person: the body of the first, and its lengths, hold in all others. Raises InputError as
    `open_recording`, or where a later session has another kind of body.
    """
    first = open_recording(sessions[0])
    out = [first]
    for session in sessions[1:]:
        if body_of(session).coordinate_names != first.body.coordinate_names:
            raise InputError(f"session {session.title}: its body has other joints than that of {sessions[0].title}.")
        pose = session.first_pose.model_copy(update={"fit_lengths": False})
        session = session.model_copy(update={"first_pose": pose, "fit_girths": None})
        out.append(open_recording(session, first.body))
    return out


def image_masks(session: Session, rig: Rig) -> dict[int, tuple[Bool | None, ...]]:
    """The silhouettes of ``[fit_girths]`` by frame, as the tracker's images are: resized and rectified."""
    table = session.fit_girths
    return {} if table is None else {k: rectified_masks(table.masks, rig, k, session.scale) for k in table.frames}


def rig_of(session: Session) -> Rig:
    """The cameras in use, in the order of ``[cameras] use`` or of the file."""
    rig = read_rig(session.cameras.calibration, session.cameras.unit, floor=None)
    if (up := session.cameras.up) is not None:
        rig = with_z_up(rig, up)
    elif floor_of(session) is not None:
        check_z_up(rig, f"calibration {session.cameras.calibration}")
    use = session.cameras.use or rig.names
    with naming(session.source):
        _check_use(session, rig, use)
    rig = Rig(tuple(_on_grid(rig[rig.names.index(name)], session.cameras.grid.get(name)) for name in use))
    check_plausible(rig, floor=floor_of(session), source=f"calibration {session.cameras.calibration}")
    return rig


def _check_use(session: Session, rig: Rig, use: Sequence[str]) -> None:
    for name in use:
        if name not in rig.names:
            missing = f"which {session.cameras.calibration} does not hold; it has {', '.join(rig.names)}"
            raise InputError(f"[cameras] use names {name!r}, {missing}.")
    for name in session.cameras.grid:
        if name not in use:
            raise InputError(f"[cameras.grid] names {name!r}, which is not in use; remove it.")


def _on_grid(camera: Camera, grid: CameraGrid | None) -> Camera:
    """The camera for a video whose pixels are not those of the calibration."""
    if grid is None:
        return camera
    A = np.diag([*grid.scale, 1.0])
    A[:2, 2] = grid.offset
    return replace(camera, K=A @ camera.K, size=grid.size or camera.size)


def floor_of(session: Session) -> float | None:
    """Height of the floor, m, or None where the session says that z is not upward."""
    return None if session.cameras.floor is False else float(session.cameras.floor)


def views_of(session: Session, rig: Rig) -> Views:
    """The frames of the session."""
    first, last = session.frames or (None, None)
    with naming(session.source):
        clocks, paths = _clocks(session), _videos(session, rig)
        check_names(paths, rig)
        _check_apart(paths)
    return open_views(paths, rig, first, last, session.step, session.scale, session.fps, session.time_offset, clocks)


def timeline_of(session: Session, rig: Rig) -> Timeline:
    """When each image of each camera was taken."""
    paths, clocks = _videos(session, rig), _clocks(session)
    return Timeline(tuple(image_times(open_source(paths[n]), clocks.get(n, Clock()), session.fps) for n in rig.names))


def _videos(session: Session, rig: Rig) -> dict[str, str]:
    return {name: path for name, path in session.videos.items() if session.cameras.use is None or name in rig.names}


def _check_apart(paths: Mapping[str, str]) -> None:
    taken = dict[Path, str]()
    for name, path in paths.items():
        if (first := taken.setdefault(Path(path).resolve(), name)) != name:
            raise InputError(f"[videos] gives {path} to {first!r} and to {name!r}; give each camera its own.")


def _clocks(session: Session) -> dict[str, Clock]:
    for name in session.clocks:
        if name not in session.videos:
            raise InputError(f"[clocks] names the camera {name!r}, which has no entry in [videos]; remove it.")
    return {name: Clock(**table.model_dump()) for name, table in session.clocks.items()}


def body_of(session: Session) -> Body:
    """The generic body of ``[body]``, before any fit. Raises InputError for a file that is no upright body."""
    body = session.body
    if isinstance(body, HumanoidBody):
        return humanoid(**body.model_dump(exclude={"kind"}))
    _check_files(session)
    if isinstance(body, GlbBody):
        loaded = body.described[0]
    else:
        targets: dict[Path | str, float] = {Path(path): weight for path, weight in body.targets.items()}
        loaded = load_makehuman(body.path, body.rig, body.weights, targets, body.spec)
    check_standing(loaded.landmarks.names, loaded.landmarks.points, loaded.vertices, f"body {body.path}")
    return rescaled(loaded, body.lengths, body.girths, body.stature)


def rate_in_words(session: Session, views: Views) -> str:
    """Which video's own frame rate the session's `fps` replaces by another; "" for none."""
    for source in views.sources:
        if session.fps and source.fps and abs(session.fps / source.fps - 1.0) > _RATES_ALIKE:
            its = f"not the {source.fps:.4g} of video {source.name}"
            return f"fps = {session.fps:g} of the session is believed, {its}: all times and speeds go by it."
    return ""


def body_in_words(session: Session) -> str:
    """Of a GLB, where the meaning of its joints is from; "" for other bodies. Raises InputError as `body_of`."""
    if not isinstance(session.body, GlbBody):
        return ""
    _check_files(session)
    return session.body.described[1]


def _check_files(session: Session) -> None:
    files = session.body.model_dump(include={"path", "rig", "weights", "spec"}, exclude_none=True)
    for key, path in files.items():
        if not Path(path).exists():
            raise InputError(f"{session.source or 'body'}: [body] {key}: {path} does not exist; check its path.")


def _first_pose(session: Session, rig: Rig, body: Body, views: Views) -> tuple[_Start, Pose]:
    """Body (at the fitted lengths and girths) and pose of the first frame, checked against floor and cameras."""
    start = _start(session, rig, body, views)
    first = views.indices[0]
    check_first_pose(session, rig, start.body, start.at(first))
    start = _with_girths(session, rig, start)
    pose = start.at(first)
    if session.first_pose.masks is not None and session.first_pose.refine:
        masks = read_masks(session.first_pose.masks, rig, first)
        pose = refine_on_silhouettes(start.body, rig, [pose], [masks]).poses[0]
    check_first_pose(session, rig, start.body, pose)
    return start, pose


def check_first_pose(session: Session, rig: Rig, body: Body, pose: Pose) -> None:
    """Above ground, in view, and upright unless the session says otherwise."""
    points = Posed(body, pose).landmarks
    marks = points if len(points) else Posed(body, pose).vertices
    source = f"calibration {session.cameras.calibration}"
    check_plausible(rig, marks, floor_of(session), source)
    if session.first_pose.upright and floor_of(session) is not None:
        check_upright(dict(zip(body.landmarks.names, points, strict=True)))


@dataclass(frozen=True)
class _Start:
    """The body and its poses at one or more (fractional) frames near the first."""

    body: Body
    frames: tuple[float, ...]
    poses: tuple[Pose, ...]
    sigmas: tuple[Float, ...] = ()  # (6 + J,) of each, where known
    report: StartReport | None = None

    def at(self, frame: float) -> Pose:
        return self.poses[0] if len(self.poses) == 1 else pose_at(self.poses, self.frames, frame, self.sigmas or None)


def _start(session: Session, rig: Rig, body: Body, views: Views) -> _Start:
    """From a file, from clicks, or from keypoints near the first frame, read or detected."""
    table, first = session.first_pose, float(views.indices[0])
    if table.file is not None:
        body = body if table.fit_lengths is False else body_at(table.file, body)
        return _Start(body, (first,), (read_pose(table.file, body, table.frame),))
    if table.clicks is not None:
        clicks = read_clicks(table.clicks, rig.names, body.landmarks.names)
        fit = fit_keypoints(body, rig, clicks, fit_lengths=session.fits_lengths)
        return _Start(fit.body, (first,), (fit.pose,), report=start_report(session, rig, body, clicks, fit))
    with naming(session.source):
        if table.detector is not None:
            numbers = table.detector.frames or (views.indices[0],)
            own, frames = detections_of(table.detector, rig, views), tuple(map(float, numbers))
        else:
            assert table.keypoints is not None
            own = keypoints_of(table.keypoints, rig, views)
            frames = tuple(number + table.keypoints.offset for number in table.keypoints.frames)
    return _from_instants(session, rig, body, own, frames, first)


def _from_instants(
    session: Session, rig: Rig, body: Body, own: Sequence[Keypoints], frames: tuple[float, ...], first: float
) -> _Start:
    """One fit over the keypoints of these frames and of those that only serve the lengths."""
    instants, rigs = list(own), [rig] * len(own)
    for extra in session.first_pose.lengths_from:
        theirs = rig_of_lengths(extra, rig)
        instants += keypoints_of(extra, theirs, first=False)
        rigs += [theirs] * (len(instants) - len(rigs))
    fits = fit_keypoints_sequence(body, rigs, instants, fit_lengths=session.fits_lengths)[: len(own)]
    near = int(np.argmin(np.abs(np.array(frames) - first)))
    report = start_report(session, rig, body, own[near], fits[near])
    sigmas = tuple(np.sqrt(np.diag(fit.covariance)) for fit in fits)
    return _Start(fits[0].body, frames, tuple(fit.pose for fit in fits), sigmas, report)


def rig_of_lengths(table: KeypointSet, rig: Rig) -> Rig:
    """The cameras of keypoints that only give lengths: their own, or the session's."""
    if not table.calibration:
        return rig
    return read_rig(table.calibration, table.unit, floor=None, key="calibration of [first_pose] lengths_from")


def _with_girths(session: Session, rig: Rig, start: _Start) -> _Start:
    """One girth factor per kind of segment, on the masks of ``[fit_girths]``."""
    table = session.fit_girths
    if table is None:
        return start
    far = [f for f in table.frames if not start.frames[0] - 5 <= f <= start.frames[-1] + 5]
    if far:
        raise InputError(f"[fit_girths] frames: frame {far[0]} is too far from the first pose; give frames near it.")
    poses = [start.at(frame) for frame in table.frames]
    masks = [read_masks(table.masks, rig, frame) for frame in table.frames]
    fitted = refine_on_silhouettes(start.body, rig, poses, masks, groups=girth_groups(start.body))
    return replace(start, body=fitted.body)


def keypoints_of(table: KeypointSet, rig: Rig, views: Views | None = None, first: bool = True) -> Sequence[Keypoints]:
    """The keypoints of every instant of a set.

    With the frames of a recording, `table.frames` count the images of the camera whose images are its frames; the
    others' files are those of the same time. Where they are to give the `first` pose, cameras that are exchanged are
    refused; later on some may show nobody.
    """
    pinned = table.person if isinstance(table.person, dict) else {}
    for name in (*table.folders, *table.grid, *pinned):
        if name not in rig.names:
            raise InputError(f"[first_pose] keypoints name the camera {name!r}, which is not in use; remove it.")
    if isinstance(table.person, int):
        files = [_files_at(table, rig, frame, views) for frame in table.frames]
        return [read_openpose(each, rig.names, table.format, table.person, table.grid) for each in files]
    out, before = list[Keypoints](), None
    for frame in table.frames:
        files = _files_at(table, rig, frame, views)
        people = read_people(files, rig.names, table.format, table.grid)
        for name, persons in zip(rig.names, people, strict=True):
            if name in pinned and len(persons):
                check_person(files[name], pinned[name], len(persons))
        if first and not pinned and not out:
            check_arrangement(rig, people)
        choice, joints = same_person(rig, people, pinned, before)
        before = joints if np.isfinite(joints).any() else before
        out.append(of_people(people, choice, table.format))
    return out


def detections_of(table: DetectorTable, rig: Rig, views: Views, first: bool = True) -> list[Keypoints]:
    """What a detector finds in each of its frames, by default the first one; `first` as `keypoints_of` takes it.

    Raises InputError as `detected`, or for a frame after the end.
    """
    frames = table.frames or (views.indices[0],)
    if max(frames) >= len(views.sources[views.timeline.reference]):
        raise InputError(
            f"[first_pose] detector: frame {max(frames)} is after the end of the video; name earlier ones."
        )
    images = map(views.recorded, frames)
    return [detected(table.model, each, rig, table.people, first and k == 0) for k, each in enumerate(images)]


def _files_at(table: KeypointSet, rig: Rig, frame: int, views: Views | None) -> dict[str, Path]:
    if views is None or views.timeline.in_step:
        return openpose_files(table.folders, frame)
    if not 0 <= frame < len(views.sources[views.timeline.reference]):
        raise NoKeypoints(f"[first_pose] keypoints: frame {frame} is after the end of the video; name earlier frames.")
    numbers = {name: k for name, k in zip(rig.names, views.numbers(frame), strict=True) if k is not None}
    folders = {name: folder for name, folder in table.folders.items() if name in numbers}
    return openpose_files(folders, numbers)
