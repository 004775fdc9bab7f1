"""Recorded images: one video file or numbered images per camera, read in step as rectified frames; H.264 out."""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.camera import Camera, Rectifier, Rig
from twistcap.errors import InputError
from twistcap.estimate import Frame, Keypoints
from twistcap.flow import image_between
from twistcap.io.clocks import RATE, Between, Clock, Timeline, image_times
from twistcap.io.sources import ImageSource, VideoSource

_PREFETCH = 3  # frames decoded ahead, per camera


Source = VideoSource | ImageSource
"""Images of one camera by frame number."""


def open_source(path: str | Path) -> Source:
    """A video file, a printf pattern (``cam01/%04d.png``), a glob or a folder of images. Raises InputError where there
    is no such file or no image matches.
    """
    text = str(path)
    if "%" in text or any(c in text for c in "*?") or Path(text).is_dir():
        return ImageSource(text)
    return VideoSource(text)


def is_there(path: str) -> bool:
    """Whether something is where `open_source` would look: a file, or the folder of a pattern or a glob."""
    head = re.split(r"[%*?]", path)[0]
    return Path(path).exists() if head == path else Path(os.path.dirname(head)).is_dir()


def open_views(
    paths: Mapping[str, str | Path], rig: Rig, first: int | None = None, last: int | None = None, step: int = 1,
    scale: float = 1.0, fps: float | None = None, time_offset: float = 0.0, clocks: Mapping[str, Clock] | None = None,
) -> Views:  # fmt: skip
    """Open every camera's recording and check that all fit the rig and one another.

    Where images of the same number were taken together, frames are paired by number, else by time. A frame is then an
    image of the slowest camera, and the other cameras' images are brought to its time.

    Args:
        paths: video or image pattern by camera name.
        rig: the cameras with distortion, at the recorded size.
        first, last, step: frame numbers, `last` included; None begins and ends with what all cameras have.
        scale: images are resized by this factor (area averaging).
        fps: frames per second; None takes the videos' own time stamps, 60 where there are none.
        time_offset: s added to all times.
        clocks: by camera name, where it differs from the recording's.

    Raises InputError: a missing video, a camera without one (or the other way round), a wrong size, unequal lengths of
    videos that are paired by number, no time in common, fewer frames than asked.
    """
    check_names(paths, rig)
    sources = tuple(open_source(paths[camera.name]) for camera in rig)
    for source, camera in zip(sources, rig, strict=True):
        check_size(source, camera)
    if step < 1:
        raise InputError(f"step is {step}; it must be 1 or more.")
    given = [(clocks or {}).get(camera.name, Clock()) for camera in rig]
    times = tuple(image_times(source, clock, fps) for source, clock in zip(sources, given, strict=True))
    timeline = Timeline(times)
    if timeline.in_step:
        span = (first or 0), _checked_last(sources, first or 0, last)
    else:
        span = _checked_span(timeline, sources, first, last)
    known = [source.fps for source in (sources[timeline.reference], *sources)]
    rate = fps or given[timeline.reference].fps or next(filter(None, known), None) or RATE
    return Views(sources, rig, range(span[0], span[1] + 1, step), scale, rate, timeline, time_offset)


@dataclass(frozen=True)
class Views:
    """The frames of a recording: iterable any number of times, each time from the start."""

    sources: tuple[Source, ...]  # one source per camera
    rig: Rig  # as calibrated (with distortion, full size)
    indices: range  # frame numbers to read
    scale: float  # this and the next two as given to `open_views`
    fps: float
    timeline: Timeline
    time_offset: float = 0.0
    moved: bool = True  # whether images are brought to the time of their frame; else they are the nearest as taken
    keypoints: Callable[[int], Keypoints | None] | None = None  # those of each frame by its number, as a cue

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def image_rig(self) -> Rig:
        """The cameras of the images that come out: resized and without distortion."""
        return self.rig.scaled(self.scale).pinhole()

    def time(self, index: int) -> float:
        """Of a frame, s."""
        return float(self.timeline.times[self.timeline.reference][index]) + self.time_offset

    def numbers(self, index: int) -> list[int | None]:
        """The number in each camera's own recording of the image nearest to a frame; None where there is none."""
        found = [self.timeline.images(c, [index])[0] for c in range(len(self.rig))]
        return [None if images is None else images.nearest for images in found]

    def recorded(self, index: int) -> tuple[AnyArray | None, ...]:
        """The images (H, W, 3) RGB nearest to a frame, as recorded: full size, with the lens's distortion."""
        pairs = zip(self.sources, self.numbers(index), strict=True)
        return tuple(None if k is None else next(source.read([k])) for source, k in pairs)

    @property
    def lags(self) -> Float:
        """(C, F) s by which each frame's nearest image was taken after the time of the frame; 0 where there is none."""
        frames = self.timeline.times[self.timeline.reference][list(self.indices)]
        out = np.zeros((len(self.rig), len(frames)))
        for c, times in enumerate(self.timeline.times):
            for f, images in enumerate(self.timeline.images(c, self.indices)):
                out[c, f] = 0.0 if images is None else times[images.nearest] - frames[f]
        return out

    def starting_at(self, index: int) -> Views:
        """The same frames from the first number that is not below `index`."""
        rest = [i for i in self.indices if i >= index]
        start = rest[0] if rest else self.indices.stop
        return replace(self, indices=range(start, self.indices.stop, self.indices.step))

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order; decoding, resizing and rectifying run ahead in one thread per camera."""
        with ExitStack() as stack:
            ready = [stack.enter_context(_ahead(self._images(c))) for c in range(len(self.rig))]
            for index in self.indices:
                keypoints = None if self.keypoints is None else self.keypoints(index)
                yield Frame(index, self.time(index), tuple(next(images) for images in ready), keypoints)

    def _images(self, camera: int) -> Iterator[AnyArray | None]:
        """One camera's image of each frame."""
        prepare = preparation(self.rig[camera], self.scale)
        wanted = self.timeline.images(camera, self.indices)
        if not self.moved:
            wanted = [b and Between(b.nearest, b.nearest, 0.0) for b in wanted]
        numbers = sorted({k for b in wanted if b is not None for k in (b.first, b.second)})
        held, read = dict[int, AnyArray | None](), zip(numbers, self.sources[camera].read(numbers), strict=False)
        for between in wanted:
            if between is None:
                yield None
                continue
            held = {k: image for k, image in held.items() if k >= between.first}
            while between.second not in held:
                number, image = next(read)
                held[number] = None if image is None else prepare(image)
            yield _at(held[between.first], held[between.second], between)


def _at(first: AnyArray | None, second: AnyArray | None, between: Between) -> AnyArray | None:
    if first is None or second is None:
        return None
    return first if between.fraction == 0.0 else image_between(first, second, between.fraction)


def preparation(camera: Camera, scale: float = 1.0) -> Callable[[AnyArray], AnyArray]:
    """What makes of a recorded image (H, W[, C]) that of `camera.scaled(scale).pinhole()`, as `Views` gives it.

    Resized first: that averages before the resampling, and leaves the rectifier fewer pixels.
    """
    small = camera.scaled(scale)
    rectify, mode = Rectifier(small), cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    if small.size == camera.size:
        return rectify
    return lambda image: rectify(np.asarray(cv2.resize(image, small.size, interpolation=mode)))


@contextmanager
def _ahead(images: Iterator[AnyArray | None]) -> Generator[Iterator[AnyArray | None]]:
    """Images made ahead in a thread of their own; what fails is raised at its turn, after all images before it."""

    def following() -> AnyArray | None:
        return next(images, None)

    def ready() -> Iterator[AnyArray | None]:
        while True:
            waiting.append(pool.submit(following))
            yield waiting.popleft().result()

    pool = ThreadPoolExecutor(1)
    waiting = deque(pool.submit(following) for _ in range(_PREFETCH))
    try:
        yield ready()
    finally:
        pool.shutdown(cancel_futures=True)


def check_names(paths: Mapping[str, str | Path], rig: Rig) -> None:
    """Raises InputError where there is a video without a camera, or a camera without a video."""
    for name in paths:
        if name not in rig.names:
            known = f"the calibration holds {', '.join(rig.names)}: rename it or calibrate it."
            raise InputError(f"[videos] names the camera {name!r}, which has no calibration; {known}")
    for name in rig.names:
        if name not in paths:
            mend = "add one, or list [cameras] use."
            raise InputError(f"the camera {name!r} is calibrated but has no entry in [videos]; {mend}")


def check_size(source: Source, camera: Camera) -> None:
    """Raises InputError for images of another size than the camera's calibration."""
    if source.size != camera.size:
        its, theirs = (f"{width}×{height}" for width, height in (source.size, camera.size))
        mend = "use the video that was calibrated, or calibrate for this size"
        is_for = f"but the calibration of camera {camera.name!r} is for {theirs}"
        raise InputError(f"video {source.name} is {its} pixels, {is_for}; {mend}.")


def _checked_last(sources: Sequence[Source], first: int, last: int | None) -> int:
    shortest, longest = min(sources, key=len), max(sources, key=len)
    count = len(shortest)
    mend = f"set frames = [{first if first < count else 0}, {count - 1}]."
    if last is None and count != len(longest):
        raise InputError(
            f"videos are of unequal length: {shortest.name} has {count} frames, {longest.name} has"
            f" {len(longest)}; cut them to start together, or {mend}"
        )
    end = count - 1 if last is None else last
    if end >= count:
        has = f"{shortest.name} has only {count} frames (0 to {count - 1})"
        raise InputError(f"frames asks for frame {end}, but {has}; {mend}")
    if not 0 <= first <= end:
        must = "the first frame must be 0 or more and not after the last"
        raise InputError(f"frames = [{first}, {end}] is no range; {must}.")
    return end


def _checked_span(
    timeline: Timeline, sources: Sequence[Source], first: int | None, last: int | None
) -> tuple[int, int]:
    """The first and last frame where they are paired by time: by default all that every camera has."""
    together, reference = timeline.together, sources[timeline.reference]
    start, end = together[0] if first is None else first, together[-1] if last is None else last
    mend = f"all cameras have images in frames = [{together[0]}, {together[-1]}]"
    if not 0 <= start <= end < len(reference):
        has = f"frames are those of {reference.name} (0 to {len(reference) - 1})"
        raise InputError(f"frames = [{start}, {end}] is no range of them: {has}; {mend}.")
    running = sum(timeline.images(c, [start])[0] is not None for c in range(len(sources)))
    if running < min(2, len(sources)):
        raise InputError(f"frame {start} has images of {running} camera only: clocks differ; {mend}.")
    return start, end
