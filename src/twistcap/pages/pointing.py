"""Measured points of the scene by clicking: what the page asks, and the file that calibration reads."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twistcap.arrays import UInt8
from twistcap.calibrate.scene import FEWEST, scene_of
from twistcap.doors.text import number_array, read_json_table
from twistcap.errors import InputError
from twistcap.io.files import replacing
from twistcap.pages.assemble import jpeg
from twistcap.pages.server import Answer, mapping_of

Pixels = dict[str, dict[str, list[float] | None]]
"""Pixels by camera and point; None where the camera does not see it."""


@dataclass
class Pointing:
    """Points of a file, a picture of each camera, and the file that gets the clicks."""

    table: Mapping[str, Mapping[str, Any]]  # as `twistcap.calibrate.scene.scene_of` takes it
    images: Mapping[str, UInt8]  # (H, W, 3) RGB by camera, as recorded
    target: Path
    saved: bool = False
    done: threading.Event = field(default_factory=threading.Event)  # calibration goes on
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def answers(self) -> Mapping[str, Answer]:
        """Answers to the page's questions, by path."""
        return {"/save": self.save, "/go": self.go}

    def document(self) -> dict[str, Any]:
        """What the page starts with, as JSON data."""
        clicks: Pixels = {camera: {} for camera in self.images}
        for name, entry in self.table.items():
            for camera, pixel in entry["pixels"].items():
                if camera in clicks:
                    clicks[camera][name] = pixel
        cameras = [
            {"name": name, "size": [image.shape[1], image.shape[0]], "image": jpeg(image, 3840, 92)}
            for name, image in self.images.items()
        ]
        return {"cameras": cameras, "joints": list(self.table), "clicks": clicks, "fewest": FEWEST}

    def save(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Write ``{"clicks": {camera: {point: [x, y] | null}}}``. Raises InputError for an unknown camera or point, a
        pixel out of its picture, or a file that cannot be written.
        """
        few = self._few(self._kept(question))
        return {"saved": str(self.target), "note": f"Still too few: {few}." if few else "Calibrate goes on with it."}

    def go(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Save, and let calibration go on. Raises InputError as `save`, and where a camera has too few points."""
        if few := self._few(self._kept(question)):
            raise InputError(f"saved, but each camera needs at least {FEWEST} points: {few}.")
        self.done.set()
        note = "Calibration goes on in the terminal; close this page."
        return {"saved": str(self.target), "note": note, "closed": True}

    def _kept(self, question: Mapping[str, Any]) -> Pixels:
        """The clicks of a question, which are in the file now."""
        clicks = self._checked(question.get("clicks"))
        with self._lock:
            self._write(clicks)
        return clicks

    def _few(self, clicks: Pixels) -> str:
        counts = {c: sum(p is not None for p in clicks.get(c, {}).values()) for c in self.images}
        return ", ".join(f"{camera} has {n} of {FEWEST}" for camera, n in counts.items() if n < FEWEST)

    def _checked(self, given: Any) -> Pixels:
        clicks: Pixels = {}
        for camera, points in mapping_of(given, "clicks").items():
            if camera not in self.images:
                raise InputError(f"clicks: camera {camera!r} is unknown; there are {', '.join(self.images)}.")
            height, width = self.images[camera].shape[:2]
            for name, pixel in mapping_of(points, f"clicks of {camera}").items():
                if name not in self.table:
                    raise InputError(f"clicks: there is no point {name!r}.")
                own = clicks.setdefault(camera, {})
                if pixel is None:
                    own[name] = None
                    continue
                x, y = number_array(pixel, (2,), f"{name} in {camera}").tolist()
                if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                    raise InputError(f"{name} in {camera} is out of the picture; click it again, or remove it.")
                own[name] = [round(x, 2), round(y, 2)]
        return clicks

    def _write(self, clicks: Pixels) -> None:
        """The table with these pixels instead of its own of these cameras; all else of it is kept."""
        out = dict[str, Any]()
        for name, entry in self.table.items():
            kept = {camera: pixel for camera, pixel in entry["pixels"].items() if camera not in self.images}
            fresh = {camera: own[name] for camera, own in clicks.items() if name in own}
            out[name] = {**entry, "pixels": kept | fresh}
        with replacing(self.target) as part:
            part.write_text(json.dumps(out, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        self.saved = True


def clicked_beside(points: Path) -> Path:
    """The file of clicks that belongs to a file of points: itself where it is one."""
    return points if points.name.endswith(".clicked.json") else points.with_suffix(".clicked.json")


def read_table(path: Path) -> dict[str, Any]:
    """Points with world coordinates, and pixels if there are: of the file, or those clicked before. Raises InputError
    where `twistcap.calibrate.scene.read_scene` would after the clicks.
    """
    table = {name: _with_pixels(entry) for name, entry in read_json_table(path).items()}
    scene_of(table, path)
    earlier = clicked_beside(path)
    if earlier != path and earlier.is_file():
        before = read_json_table(earlier)
        scene_of(before, earlier)
        for name, entry in table.items():
            entry["pixels"] = before.get(name, entry)["pixels"]
    return table


def _with_pixels(entry: Any) -> Any:
    return {**entry, "pixels": entry.get("pixels", {})} if isinstance(entry, dict) else entry
