"""A session checked as far as it can be without a fit: all that it names is opened and read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from twistcap.camera import Rig
from twistcap.errors import InputError, naming
from twistcap.io.detectors import check_detector
from twistcap.io.exports import check_installed
from twistcap.io.keypoints import read_clicks
from twistcap.io.masks import read_masks
from twistcap.io.new_session import ENDS
from twistcap.io.pose_file import body_at, read_pose
from twistcap.io.recording import body_of, keypoints_of, rig_of, rig_of_lengths, views_of
from twistcap.io.session import Session
from twistcap.io.video import Views


def check_session(session: Session) -> Views:
    """Read what a track of the session would read before its first fit; its frames. Raises InputError for whatever is
    missing.
    """
    with naming(session.source):
        for key, path in _named(session):
            if path is not None and not Path(path).exists():
                raise InputError(f"{key}: {path} does not exist; check its path.")
        rig = rig_of(session)
        views, body, start = views_of(session, rig), body_of(session), session.first_pose
        for index in views.indices[-ENDS:]:
            views.recorded(index)  # a file that was cut off has lost its end
        _ = session.pose_prior, session.motion_library, session.output.gait_norms
        check_installed(session.output.exports)
        if start.file is not None:
            read_pose(start.file, body_at(start.file, body), start.frame)
        if start.clicks is not None:
            read_clicks(start.clicks, rig.names, body.landmarks.names)
        _check_keypoints(session, rig, views)
        if (girths := session.fit_girths) is not None:
            for frame in girths.frames:
                read_masks(girths.masks, rig, frame)
    return views


def _check_keypoints(session: Session, rig: Rig, views: Views) -> None:
    start = session.first_pose
    if start.keypoints is not None:
        keypoints_of(start.keypoints, rig, views)
    for extra in start.lengths_from:
        keypoints_of(extra, rig_of_lengths(extra, rig), first=False)
    if start.detector is not None:
        check_detector(start.detector.model, start.detector.people)


def _named(session: Session) -> Iterator[tuple[str, str | None]]:
    """Key and path of what the tables name, but for videos, calibration, body and models, which are told elsewhere."""
    start = session.first_pose
    yield from ((f"[first_pose] {key}", getattr(start, key)) for key in ("file", "clicks", "plates", "masks"))
    for table in (*([start.keypoints] if start.keypoints else []), *start.lengths_from):
        yield from ((f"keypoint folders of {camera}", folder) for camera, folder in table.folders.items())
    yield from ((f"[{key}] path", table.path) for key in ("prior", "motions") if (table := getattr(session, key)))
    yield "[output] norms", session.output.norms
    yield "[fit_girths] masks", session.fit_girths.masks if session.fit_girths else None
