"""The page on which silhouettes are cut out: what it sends, the cut, and the masks that are written."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twistcap.acquire.cutout import Hints, Stroke, cut_out
from twistcap.arrays import Bool, UInt8
from twistcap.errors import InputError
from twistcap.pages.assemble import jpeg
from twistcap.pages.outlines import flat
from twistcap.pages.server import Answer, numbers_of


@dataclass(frozen=True)
class CutView:
    """One image to be cut."""

    image: UInt8  # (H, W, 3) RGB, as recorded
    target: Path  # file of the mask
    known: Bool | None = None  # (H, W) a silhouette that there is already


@dataclass
class Cutting:
    """All images of one file by role, and what was drawn on them; exactly the `masks` are saved."""

    views: Mapping[str, CutView]
    note: Mapping[str, str]  # what the user still has to do so that the masks are read; "" for nothing
    masks: dict[str, Bool] = field(default_factory=dict[str, Bool])  # (H, W) the last cut, where something is drawn
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def answers(self) -> Mapping[str, Answer]:
        """What the page may ask, by path."""
        return {"/cut": self.cut, "/save": self.save}

    def document(self) -> dict[str, Any]:
        """What the page starts with."""
        return {"views": [
            {"name": role, "size": [view.image.shape[1], view.image.shape[0]], "image": jpeg(view.image, 1920, 88),
             "target": str(view.target), "outline": [] if view.known is None else outline(view.known)}
            for role, view in self.views.items()
        ]}  # fmt: skip

    def cut(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Cut ``{"view": role, "rectangle": [x, y, x, y] | null, "strokes": [{"inside", "points", "width"}]}``.

        A view without drawing is as at the beginning. A cut that fails leaves nothing to save. Raises InputError for an
        unknown view, a number that is not finite, a drawing without a person, or an empty silhouette.
        """
        role = question.get("view")
        if not isinstance(role, str) or role not in self.views:
            raise InputError(f"view {role!r} is unknown; there are {', '.join(self.views)}.")
        view = self.views[role]
        with self._lock:
            self.masks.pop(role, None)
            hints = _hints(question)
            if hints.rectangle is None and not hints.strokes:
                mask = np.zeros(view.image.shape[:2], np.bool_) if view.known is None else view.known
            else:
                mask = cut_out(view.image, hints, view.known)
                if mask is None:
                    raise InputError("draw a rectangle around the person first.")
                if not mask.any():
                    raise InputError("nothing of the person is left; paint some of it with Person.")
                self.masks[role] = mask
        fraction = round(float(mask.mean()), 4)
        return {"view": role, "outline": outline(mask), "fraction": fraction, "cut": role in self.masks}

    def save(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Write the masks of all views that were drawn on. Raises InputError where none was, or a file cannot be
        written.
        """
        with self._lock:
            masks = dict(self.masks)
            if not masks:
                raise InputError("there is nothing to save yet; draw a rectangle around the person in a view.")
            for role, mask in masks.items():
                _write(self.views[role].target, mask)
        notes = " ".join(self.note[role] for role in masks if self.note[role])
        return {"saved": [str(self.views[role].target) for role in masks], "note": notes}


def outline(mask: Bool) -> list[list[float]]:
    """Polylines around a silhouette (H, W) and its holes: x, y, x, y, …, px."""
    curves, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return flat([cv2.approxPolyDP(curve, 0.5, True)[:, 0].astype(np.float64) for curve in curves])


def _write(path: Path, mask: Bool) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(path), mask.astype(np.uint8) * 255):
            raise OSError(0, "folder and file must allow it")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}.") from error
    except cv2.error as error:
        raise InputError(f"{path} cannot be written: its ending is not that of a picture; name a .png file.") from error


def _hints(question: Mapping[str, Any]) -> Hints:
    rectangle, strokes = question.get("rectangle"), question.get("strokes") or []
    corners = None if rectangle is None else numbers_of(rectangle, "the rectangle")
    found = None
    if corners is not None:
        if len(corners) != 4 or np.ptp(np.reshape(corners, (2, 2)), axis=0).min() < 2:
            raise InputError("the rectangle must be x, y, x, y of two corners, and larger than two pixels.")
        found = (corners[0], corners[1], corners[2], corners[3])
    if not isinstance(strokes, list):
        raise InputError("strokes must be a list.")
    return Hints(found, tuple(_stroke(stroke) for stroke in strokes))


def _stroke(given: Any) -> Stroke:
    if not isinstance(given, dict):
        raise InputError(f"a stroke must be an object, not {given!r}.")
    points = numbers_of(given.get("points"), "a stroke's points")
    if len(points) < 2 or len(points) % 2:
        raise InputError("a stroke's points must be x, y, x, y, …")
    width = numbers_of([given.get("width", 8)], "a stroke's width", 1)[0]
    return Stroke(bool(given.get("inside")), np.array(points).reshape(-1, 2), float(np.clip(width, 1, 500)))
