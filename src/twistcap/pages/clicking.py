"""The first pose by clicking: the page's questions, the fit, and the file that the session reads."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.adjust.first_pose import FirstPose, Proportions, fit_keypoints
from twistcap.arrays import UInt8
from twistcap.body import Body, Pose, Posed, rescaled
from twistcap.body.rig_spec import RIG_MEND
from twistcap.camera import Camera, Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.keypoints import clicked
from twistcap.io.pose_file import write_pose
from twistcap.io.recording import check_first_pose
from twistcap.io.session import Session
from twistcap.io.start_report import StartReport, start_report
from twistcap.io.tidy import write_rows
from twistcap.io.unaided import Silhouette
from twistcap.pages.assemble import jpeg
from twistcap.pages.outlines import body_outlines, flat
from twistcap.pages.server import Answer, mapping_of, numbers_of
from twistcap.region.compare import iou
from twistcap.render.view import render

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe")
MAIN_JOINTS = ("head_top", "neck", *(f"{joint}_{side}" for side in "rl" for joint in _LIMBS))
LEAST_IOU = 0.3
"""Overlap of body and silhouette in a view without clicks below which Save warns. A pose that is 0.3 m off has less;
a right one 0.7 or more if the person walks, and 0.39 in one recording of a person who stays in place."""
_KNOWN = 0.3  # of the body's size that a silhouette has at least: who stays in place does not stand out
_NEAR = 0.5  # of the body's size about it that counts: others may move elsewhere
Clicks = dict[str, dict[str, tuple[float, float]]]
"""Pixels by camera and joint."""


@dataclass(frozen=True)
class Target:
    """Where the pose is written."""

    path: Path  # a pose file (JSON), or a file of clicks
    kind: str  # "file" or "clicks", as in ``[first_pose]``; a file of clicks keeps no slider
    note: str = ""  # what the user still has to do so that the session reads it; empty where it does


@dataclass
class Clicking:
    """One person's clicks and the body that follows them."""

    session: Session
    rig: Rig  # as calibrated, full size
    images: tuple[UInt8 | None, ...]  # of the first frame, one per camera, RGB as recorded; None where it was dropped
    generic: Body  # before any fit
    target: Target
    silhouettes: tuple[Silhouette | None, ...] = ()  # of the first frame, one per camera; none: nothing to hold against
    clicks: Clicks = field(default_factory=lambda: dict[str, dict[str, tuple[float, float]]]())
    fitted: Clicks = field(default_factory=lambda: dict[str, dict[str, tuple[float, float]]]())  # that gave `shown`
    shown: Posed | None = None  # body and pose at present; None before the first fit
    proportions: Proportions = field(default_factory=lambda: Proportions({}, {}))
    last: tuple[Keypoints, FirstPose] | None = None  # clicks and what was fitted to them; sliders may have moved it
    reported: StartReport | None = None  # on what was saved last
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def answers(self) -> Mapping[str, Answer]:
        """Answers to the page's questions, by path; one at a time."""

        def alone(answer: Answer, question: Mapping[str, Any]) -> Mapping[str, Any]:
            with self._lock:
                return answer(question)

        answers = {"/fit": self.fit, "/pose": self.slide, "/save": self.save}
        return {path: partial(alone, answer) for path, answer in answers.items()}

    def document(self) -> dict[str, Any]:
        """What the page starts with, as JSON data."""
        joints, names = self.generic.landmarks.names, self.generic.coordinate_names
        main = [name for name in MAIN_JOINTS if name in joints]
        limits = np.rad2deg(self.generic.limits).round(1).tolist()
        return {
            "cameras": [
                {"name": c.name, "size": list(c.size), "image": None if image is None else jpeg(image, 1920, 88)}
                for c, image in zip(self.rig, self.images, strict=True)
            ],
            "joints": main, "more": [name for name in joints if name not in main], "clicks": self.clicks,
            "coordinates": [{"name": n, "limits": pair} for n, pair in zip(names, limits, strict=True)],
            "sliders": self.target.kind == "file", "least_iou": LEAST_IOU, "target": str(self.target.path),
            "state": None if self.shown is None else self._state(),
        }  # fmt: skip

    def fit(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Fit the body to ``{"clicks": {camera: {joint: [x, y]}}, "held": {coordinate: degrees}}``. Raises InputError
        for an unknown camera, joint or coordinate, a number that is not finite, or too few clicks.
        """
        self.clicks = self._checked_clicks(question.get("clicks"))
        held = self._checked_angles(question.get("held") or {})
        if not self.clicks:
            self.shown = None
            raise InputError("no joint is clicked; click a handful of joints in two views.")
        fit = self._fitted(held, self.shown.pose if self.shown else None)
        residual = round(float(np.median(fit.residual_px[np.isfinite(fit.residual_px)])), 2)
        return {**self._state(), "residual_px": residual, "rejected": [list(pair) for pair in fit.rejected]}

    def slide(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Set joint angles without a fit: ``{"held": {coordinate: degrees}}``. Raises InputError as `fit`; before a
        first fit.
        """
        if self.shown is None:
            raise InputError("there is no pose to change yet; click a handful of joints in two views first.")
        q = self.shown.pose.q.copy()
        for name, angle in self._checked_angles(question.get("held") or {}).items():
            q[self.generic.coordinate(name)] = angle
        self.shown = Posed(self.shown.body, Pose(self.shown.pose.root, q))
        return self._state()

    def save(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Write pose or clicks, after the checks that the tracker would make. Raises InputError before a first fit, for
        a pose that cannot be true, or a file that cannot be written.
        """
        if self.shown is None:
            raise InputError("there is nothing to save yet; click a handful of joints in two views first.")
        if self.clicks != self.fitted:
            raise InputError("the pose shown is not of these clicks, which could not be fitted; mend them first.")
        if self.target.kind == "clicks":
            self._fitted({}, None)  # as the tracker will see it
        check_first_pose(self.session, self.rig, self.shown.body, self.shown.pose)
        report = self.report()
        try:
            self.target.path.parent.mkdir(parents=True, exist_ok=True)
            if self.target.kind == "file":
                first = (self.session.frames or (0,))[0]
                write_pose(self.target.path, self.shown.body, self.shown.pose, self.proportions, first)
                write_clicks(clicks_beside(self.target.path), self.clicks)
            else:
                write_clicks(self.target.path, self.clicks)
        except OSError as error:
            raise InputError(f"{self.target.path} cannot be written: {error.strerror}.") from error
        self.reported = report
        note = " ".join([*([self.target.note] if self.target.note else []), *(report.warnings if report else ())])
        return {**self._state(), "saved": str(self.target.path), "note": note}

    def report(self) -> StartReport | None:
        """How well the body fits the clicks; None before a fit. Raises InputError for a person of impossible size."""
        return self.last and start_report(self.session, self.rig, self.generic, *self.last)

    def _fitted(self, held: Mapping[str, float], start: Pose | None) -> FirstPose:
        limits = self.generic.limits.copy()
        for name, angle in held.items():
            limits[self.generic.coordinate(name)] = angle
        body, lengths = replace(self.generic, limits=limits), self.session.fits_lengths
        rows = {(name, joint): (x, y, 1.0) for name, its in self.clicks.items() for joint, (x, y) in its.items()}
        fit = fit_keypoints(body, self.rig, clicked(rows, self.rig.names), fit_lengths=lengths, start=start)
        self.proportions = made = fit.proportions
        self.shown = Posed(rescaled(self.generic, made.lengths, made.girths, made.stature), fit.pose)
        self.last, self.fitted = (clicked(rows, self.rig.names), fit), self.clicks
        return fit

    def _state(self) -> dict[str, Any]:
        assert self.shown is not None
        marks, angles = self.shown.landmarks, np.rad2deg(self.shown.pose.q).round(2).tolist()
        return {
            "outlines": {c.name: flat(body_outlines(c, self.shown)) for c in self.rig},
            "joints": {c.name: _named_pixels(c, self.generic.landmarks.names, marks) for c in self.rig},
            "overlap": self._overlap(),
            "q_deg": dict(zip(self.generic.coordinate_names, angles, strict=True)),
        }

    def _overlap(self) -> dict[str, float]:
        """IoU of the body with each known silhouette, by camera; views without clicks were no part of the fit."""
        assert self.shown is not None
        pairs = zip(self.rig.names, self.silhouettes, strict=True) if self.silhouettes else ()
        found = {name: overlap(self.shown, one) for name, one in pairs if one is not None}
        return {name: round(value, 3) for name, value in found.items() if value is not None}

    def _checked_clicks(self, given: Any) -> Clicks:
        clicks: Clicks = {}
        for camera, joints in mapping_of(given, "clicks").items():
            if camera not in self.rig.names:
                raise InputError(f"clicks: camera {camera!r} is unknown; the rig has {', '.join(self.rig.names)}.")
            for joint, pixel in mapping_of(joints, f"clicks of {camera}").items():
                if joint not in self.generic.landmarks.names:
                    raise InputError(f"clicks: joint {joint!r} is unknown to body {self.generic.name!r}.")
                x, y = numbers_of(pixel, f"{joint} in {camera}", 2)
                clicks.setdefault(camera, {})[joint] = (x, y)
        return clicks

    def _checked_angles(self, given: Any) -> dict[str, float]:
        """Angles in rad, within the limits."""
        angles: dict[str, float] = {}
        for name, value in mapping_of(given, "held").items():
            if name not in self.generic.coordinate_names:
                raise InputError(f"the body {self.generic.name!r} has no coordinate {name!r}; {RIG_MEND}.")
            lower, upper = self.generic.limits[self.generic.coordinate(name)]
            angles[name] = float(np.clip(np.deg2rad(numbers_of([value], name, 1)[0]), lower, upper))
        return angles


def overlap(posed: Posed, silhouette: Silhouette) -> float | None:
    """IoU of the rendered body and a silhouette, near the body; 0 for a body out of view. None where the silhouette is
    too small to tell."""
    body = render(posed, silhouette.camera).part >= 0
    rows, columns = (np.flatnonzero(body.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return 0.0
    if silhouette.mask.sum() < _KNOWN * body.sum():
        return None
    reach = round(_NEAR * max(np.ptp(rows), np.ptp(columns)))
    near = tuple(slice(max(0, k[0] - reach), k[-1] + reach + 1) for k in (rows, columns))
    return iou(body[near], silhouette.mask[near])


def clicks_beside(pose_file: Path) -> Path:
    """The file of clicks that belongs to a pose file; the page opens with it next time."""
    return pose_file.with_suffix(".clicks.csv")


def write_clicks(path: Path, clicks: Clicks) -> None:
    """Write clicks as `twistcap.io.keypoints.read_clicks` reads them: JSON by that ending, else CSV."""
    if path.suffix.lower() == ".json":
        path.write_text(json.dumps(clicks, indent=1) + "\n", encoding="utf-8")
        return
    each = ((camera, joint, *pixel) for camera, joints in clicks.items() for joint, pixel in joints.items())
    write_rows(path, ("camera", "joint", "x", "y"), ((*at, round(x, 2), round(y, 2)) for *at, x, y in each))


def clicks_of(keypoints: Keypoints, rig: Rig, joints: tuple[str, ...]) -> Clicks:
    """Keypoints as clicks, without those that the body does not have."""
    clicks: Clicks = {}
    for c, name in enumerate(rig.names):
        for k, joint in enumerate(keypoints.names):
            if keypoints.confidence[c, k] > 0 and joint in joints:
                x, y = keypoints.pixels[c, k].tolist()
                clicks.setdefault(name, {})[joint] = (x, y)
    return clicks


def _named_pixels(camera: Camera, names: tuple[str, ...], points: Any) -> dict[str, list[float]]:
    pixels, depth = camera.project(points)
    seen = (depth > 0) & np.isfinite(pixels).all(axis=1)
    return {name: pixel for name, pixel, s in zip(names, pixels.round(1).tolist(), seen, strict=True) if s}
