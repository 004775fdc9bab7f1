"""Recorded images: one video file or numbered images per camera, read in step as rectified frames; H.264 out."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from twistcap.arrays import AnyArray, UInt8
from twistcap.camera import Camera, Rectifier, Rig
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.io.sources import ImageSource, VideoSource
from twistcap.io.videowriter import VideoWriter

__all__ = ["ImageSource", "Source", "VideoSource", "VideoWriter", "Views", "open_source", "open_views", "view_of"]

_PREFETCH = 3  # frames decoded ahead, per camera
_WAIT = 0.1  # s between looks at the stop flag


class Source(Protocol):
    """Images of one camera by frame number."""

    name: str

    def __len__(self) -> int: ...
    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def fps(self) -> float | None: ...
    def read(self, indices: Sequence[int]) -> Iterator[UInt8 | None]: ...


def open_source(path: str | Path) -> Source:
    """A video file, a printf pattern (``cam01/%04d.png``), a glob or a folder of images.

    Raises InputError where there is no such file or no image matches.
    """
    text = str(path)
    if "%" in text or any(c in text for c in "*?") or Path(text).is_dir():
        return ImageSource(text)
    return VideoSource(text)


def view_of(camera: Camera, image: AnyArray, scale: float = 1.0) -> AnyArray:
    """One image (H, W[, C]) resized by `scale` and rectified: as `open_views` gives them."""
    return _Preparation(camera, scale)(image)


def open_views(
    paths: Mapping[str, str | Path],
    rig: Rig,
    first: int = 0,
    last: int | None = None,
    step: int = 1,
    scale: float = 1.0,
    fps: float | None = None,
    time_offset: float = 0.0,
) -> Views:
    """Open every camera's recording and check that all fit the rig and one another.

    Args:
        paths: video or image pattern by camera name.
        rig: the cameras with distortion, at the recorded size.
        first, last, step: frame numbers, `last` included; None reads to the end.
        scale: images are resized by this factor (area averaging).
        fps: frames per second; None takes the videos' own, 60 where there is none.
        time_offset: s added to ``index / fps``.

    Raises InputError: a missing video, a camera without one (or the other way round), a wrong size, unequal lengths,
    fewer frames than asked.
    """
    _check_names(paths, rig)
    sources = tuple(open_source(paths[camera.name]) for camera in rig)
    for source, camera in zip(sources, rig, strict=True):
        _check_size(source, camera)
    last = _checked_last(sources, first, last)
    if step < 1:
        raise InputError(f"step is {step}; it must be 1 or more.")
    rate = fps or next((s.fps for s in sources if s.fps), None) or 60.0
    return Views(sources, rig, range(first, last + 1, step), scale, rate, time_offset)


@dataclass(frozen=True)
class Views:
    """The frames of a recording: iterable any number of times, each time from the start.

    Attributes:
        sources, rig: one source per camera; `rig` as calibrated (with distortion, full size).
        indices: frame numbers to read.
        scale, fps, time_offset: as given to `open_views`.
    """

    sources: tuple[Source, ...]
    rig: Rig
    indices: range
    scale: float
    fps: float
    time_offset: float = 0.0

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def image_rig(self) -> Rig:
        """The cameras of the images that come out: resized and without distortion."""
        return self.rig.scaled(self.scale).pinhole()

    def starting_at(self, index: int) -> Views:
        """The same frames from the first number that is not below `index`."""
        rest = [i for i in self.indices if i >= index]
        start = rest[0] if rest else self.indices.stop
        return replace(self, indices=range(start, self.indices.stop, self.indices.step))

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order; decoding, resizing and rectifying run ahead in one thread per camera."""
        readers = [_Reader(s, c, self.indices, self.scale) for s, c in zip(self.sources, self.rig, strict=True)]
        try:
            for index in self.indices:
                images = tuple(reader.next() for reader in readers)
                yield Frame(index, index / self.fps + self.time_offset, images)
        finally:
            for reader in readers:
                reader.stop()


class _Preparation:
    """Recorded image to the image of `camera.scaled(scale).pinhole()`.

    Resized first: that averages before the resampling, and leaves the rectifier fewer pixels.
    """

    def __init__(self, camera: Camera, scale: float) -> None:
        small = camera.scaled(scale)
        self._size = small.size if small.size != camera.size else None
        self._mode = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        self._rectify = Rectifier(small)

    def __call__(self, image: AnyArray) -> AnyArray:
        if self._size is not None:
            image = np.asarray(cv2.resize(image, self._size, interpolation=self._mode))
        return self._rectify(image)


class _Reader:
    """One camera's frames, prepared ahead in a thread of its own."""

    def __init__(self, source: Source, camera: Camera, indices: range, scale: float) -> None:
        self._queue: queue.Queue[AnyArray | Exception | None] = queue.Queue(_PREFETCH)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(source, camera, indices, scale), daemon=True)
        self._thread.start()

    def next(self) -> AnyArray | None:
        item = self._queue.get()
        if isinstance(item, Exception):
            raise item
        return item

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(timeout=5.0)

    def _run(self, source: Source, camera: Camera, indices: range, scale: float) -> None:
        try:
            prepare = _Preparation(camera, scale)
            for image in source.read(indices):
                if not self._put(None if image is None else prepare(image)):
                    return
        except Exception as error:  # raised again at the frame's turn, after all frames before it
            self._put(error)

    def _put(self, item: AnyArray | Exception | None) -> bool:
        while not self._stop.is_set():
            try:
                self._queue.put(item, timeout=_WAIT)
                return True
            except queue.Full:
                continue
        return False


def _check_names(paths: Mapping[str, str | Path], rig: Rig) -> None:
    for name in paths:
        if name not in rig.names:
            raise InputError(
                f"[videos] names the camera {name!r}, which has no calibration;"
                f" the calibration holds {', '.join(rig.names)}: rename it or calibrate it."
            )
    for name in rig.names:
        if name not in paths:
            raise InputError(
                f"the camera {name!r} is calibrated but has no entry in [videos]; add one, or list [cameras] use."
            )


def _check_size(source: Source, camera: Camera) -> None:
    if source.size != camera.size:
        raise InputError(
            f"video {source.name} is {source.size[0]}×{source.size[1]} pixels, but the calibration of"
            f" camera {camera.name!r} is for {camera.size[0]}×{camera.size[1]};"
            " use the video that was calibrated, or calibrate for this size."
        )


def _checked_last(sources: Sequence[Source], first: int, last: int | None) -> int:
    shortest = min(sources, key=len)
    longest = max(sources, key=len)
    if last is None and len(shortest) != len(longest):
        raise InputError(
            f"videos are of unequal length: {shortest.name} has {len(shortest)} frames, {longest.name} has"
            f" {len(longest)}; cut them to start together, or set frames = [{first}, {len(shortest) - 1}]."
        )
    end = len(shortest) - 1 if last is None else last
    if end >= len(shortest):
        raise InputError(
            f"frames asks for frame {end}, but {shortest.name} has only {len(shortest)} frames"
            f" (0 to {len(shortest) - 1}); set frames = [{first}, {len(shortest) - 1}]."
        )
    if not 0 <= first <= end:
        raise InputError(
            f"frames = [{first}, {end}] is no range; the first frame must be 0 or more and not after the last."
        )
    return end
