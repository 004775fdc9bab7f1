"""Keypoints of any frame of a recording, from where its first pose has its own."""

from __future__ import annotations

from dataclasses import dataclass

from twistcap.estimate import Keypoints
from twistcap.io.keypoints import NoKeypoints
from twistcap.io.recording import detections_of, keypoints_of
from twistcap.io.session_tables import DetectorTable, KeypointSet
from twistcap.io.video import Views


@dataclass(frozen=True)
class KeypointSource:
    """Reads or detects keypoints only when it is asked for a frame: a detector is slow.

    Attributes:
        table: of the session's ``[first_pose]``.
        views: the recording.
    """

    table: KeypointSet | DetectorTable
    views: Views

    def __call__(self, index: int) -> Keypoints | None:
        """Those of a frame by its number, of files the nearest in time; None where there are none.

        The person is found by geometry: a number that the session gives is that of its own frames. Raises InputError
        for a file that cannot be read, and a detector that cannot be run.
        """
        try:
            found = self._of(index)
        except NoKeypoints:
            return None
        return found if found.confidence.any() else None

    def _of(self, index: int) -> Keypoints:
        rig, views = self.views.rig, self.views
        if isinstance(self.table, DetectorTable):
            return detections_of(self.table.model_copy(update={"frames": (index,)}), rig, views, first=False)[0]
        file = {"frames": (round(index - self.table.offset),), "person": "auto"}
        return keypoints_of(self.table.model_copy(update=file), rig, views, first=False)[0]
