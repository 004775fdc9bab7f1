"""Images of one camera by frame number: from a video file (exact seek) or from image files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from glob import escape, glob
from itertools import islice
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.error import FFmpegError

from twistcap.arrays import Float, UInt8
from twistcap.doors.images import MOST_PIXELS, read_image
from twistcap.errors import InputError

IMAGE_ENDINGS = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm"}
_FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,asf,flv,ogg,dv,h264,hevc,m4v,mjpeg,gif,nut,"
    "yuv4mpegpipe,mxf,ivf,obu"
)
_FIRST = 24  # frames that are decoded to see whether time stamps can be believed
_MEND = "re-encode the video, or end [frames] before it"


class VideoSource:
    """A video file, frame by frame.

    Frames are counted in order of display by their time stamps, so a frame number means the same picture at variable
    frame rates and after any seek. Where the stamps make no sense (missing, twice the same, going back), frames are
    counted as they are decoded, `note` says so, and the frame rate is that of the header.
    """

    def __init__(self, path: str | Path) -> None:
        """Raises InputError where the file is missing or holds no video."""
        self.name, self.note = str(path), ""
        self.fps: float | None
        if not Path(path).is_file():
            raise InputError(f"video {path} does not exist; check its path in [videos].")
        try:
            with _opened(self.name) as container:
                stamps = _time_stamps(self.name, container)
                stream = container.streams.video[0]
                self.fps = float(stream.average_rate) if stream.average_rate else None
                self._tick = float(stream.time_base or 0.0)
            self._stamps = stamps if stamps is not None else self._in_order_of_decoding()
        except (FFmpegError, ValueError, UnicodeError) as error:
            if isinstance(error, InputError):
                raise
            why = getattr(error, "strerror", None) or error
            raise InputError(f"video {path} cannot be opened ({why}); is it a video file?") from error

    def __len__(self) -> int:
        return len(self._stamps)

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height) px as shown: the file's rotation is applied."""
        image = next(self.read([0]))
        return image.shape[1], image.shape[0]

    @cached_property
    def times(self) -> Float | None:
        """(N,) s since the first frame, by the time stamps; None where they make no sense.

        Stamps are rounded to the file's ticks: where all are within one tick of even times, these are given.
        """
        stamps = np.array(self._stamps, dtype=float)
        if self.note or len(stamps) < 2 or self._tick <= 0:
            return None
        numbers, since = np.arange(len(stamps)), (stamps - stamps[0]) * self._tick
        for rate in (self.fps, numbers[-1] / since[-1]):
            if rate and np.abs(since - numbers / rate).max() <= 1.01 * self._tick:
                return numbers / rate
        return since

    def read(self, indices: Sequence[int]) -> Iterator[UInt8]:
        """RGB images (H, W, 3) of ascending frame numbers. Raises InputError at the first frame that cannot be decoded;
        frames before it have been given.
        """
        if len(indices) == 0:
            return
        with _opened(self.name) as container:
            stream = container.streams.video[0]
            # A broken frame is an error, not a grey smear; a frame that grows on the way is one too.
            stream.codec_context.options = {"err_detect": "explode", "max_pixels": str(MOST_PIXELS)}
            if indices[0] > 0 and not self.note:
                container.seek(self._stamps[indices[0]], stream=stream, backward=True, any_frame=False)
            decoded = self._numbered(container)
            for index in indices:
                yield self._frame_at(decoded, index)

    def _frame_at(self, decoded: Iterator[tuple[int | None, Any]], index: int) -> UInt8:
        wanted = self._stamps[index]
        try:
            for stamp, frame in decoded:
                if stamp is None or stamp < wanted:
                    continue
                if stamp > wanted or frame.is_corrupt:
                    break
                return _upright(frame)
        except FFmpegError as error:
            raise InputError(f"video {self.name}: frame {index} is corrupt ({error.strerror}); {_MEND}.") from error
        raise InputError(f"video {self.name}: frame {index} is corrupt or missing; {_MEND}.")

    def _numbered(self, container: Any) -> Iterator[tuple[int | None, Any]]:
        """Frames with their stamps, or with their numbers where the stamps make no sense."""
        frames = self._decoded(container)
        return enumerate(frames) if self.note else ((frame.pts, frame) for frame in frames)

    def _decoded(self, container: Any) -> Iterator[Any]:
        """Frames in order of display; at a broken packet first those that the decoder still holds, then the error."""
        stream = container.streams.video[0]
        for packet in container.demux(stream):
            try:
                yield from packet.decode()
            except FFmpegError as error:
                with suppress(FFmpegError):
                    yield from stream.codec_context.decode(None)
                raise error

    def _in_order_of_decoding(self) -> list[int]:
        """Numbers of all frames that can be decoded; they are counted by decoding them."""
        self.note = f"video {self.name}: its time stamps make no sense; frames are taken as they are decoded"
        count = 0
        with _opened(self.name) as container, suppress(FFmpegError):
            for _ in self._decoded(container):
                count += 1
        if not count:
            raise InputError(f"video {self.name} holds no frame that can be decoded.")
        return list(range(count))


def _opened(name: str) -> Any:
    """The container of a video; it may neither lead to other files, as a playlist would, nor to other machines."""
    return av.open(name, options={"protocol_whitelist": "file", "format_whitelist": _FORMATS})


def _time_stamps(name: str, container: Any) -> list[int] | None:
    """In order of display; None where they make no sense: some lack, are the same, go back or are made up."""
    if not container.streams.video:
        raise InputError(f"video {name} holds no video stream; is it a video file?")
    codec = container.streams.video[0].codec_context
    if codec is None:
        raise InputError(f"video {name} is coded in a way that is not known; re-encode it.")
    width, height = codec.width, codec.height
    if width * height > MOST_PIXELS:
        raise InputError(f"video {name} is {width}×{height} pixels; at most {MOST_PIXELS >> 20} megapixels are read.")
    if "avi" in container.format.name.split(",") and codec.has_b_frames:
        return None  # AVI holds no times of display; what FFmpeg makes up for them is another after a seek
    packets = [p for p in container.demux(container.streams.video[0]) if p.size and not p.is_discard]
    if not packets:
        raise InputError(f"video {name} holds no frame.")
    stamps = [int(p.pts) for p in packets if p.pts is not None]
    if len(stamps) < len(packets) or len(set(stamps)) < len(stamps):
        return None
    if stamps == sorted(stamps):
        return stamps if not codec.has_b_frames or _ascending(container) else None
    # Only frames that need others are stored in another order than they are shown.
    return None if all(p.is_keyframe for p in packets) else sorted(stamps)


def _ascending(container: Any) -> bool:
    """Whether the first frames come out of the decoder in the order of their stamps; in AVI files they need not."""
    container.seek(0)
    shown = [frame.pts for frame in islice(container.decode(video=0), _FIRST)]
    return None not in shown and shown == sorted(shown)


def _upright(frame: Any) -> UInt8:
    image = np.asarray(frame.to_ndarray(format="rgb24"))
    turns = round(getattr(frame, "rotation", 0) / 90) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image


class ImageSource:
    """Image files as frames.

    A printf pattern (``cam01/%04d.png``) counts from the lowest number present, and a number that is absent is a
    dropped frame; a glob or a folder takes the files in natural order.
    """

    fps: float | None = None
    times: Float | None = None
    note = ""

    def __init__(self, pattern: str | Path) -> None:
        """Raises InputError where no image matches."""
        self.name = str(pattern)
        self._files = _numbered(self.name) if "%" in self.name else _in_order(self.name)
        if not self._files:
            raise InputError(f"no image matches {self.name}; check the pattern in [videos].")

    def __len__(self) -> int:
        return len(self._files)

    @property
    def files(self) -> list[str]:
        """Those that are there."""
        return [file for file in self._files if file is not None]

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height) px of the first image."""
        first, file = next((i, file) for i, file in enumerate(self._files) if file is not None)
        image = _read_image(file, first)
        return image.shape[1], image.shape[0]

    def read(self, indices: Sequence[int]) -> Iterator[UInt8 | None]:
        """RGB images (H, W, 3) by frame number; None where the file is absent. Raises InputError at the first image
        that cannot be read or has another size than the first.
        """
        for index in indices:
            file = self._files[index]
            image = None if file is None else _read_image(file, index)
            if image is not None and image.shape[1::-1] != self.size:
                size, first = (f"{width}×{height}" for width, height in (image.shape[1::-1], self.size))
                raise InputError(f"image {file} (frame {index}) is {size} pixels, the first is {first}.")
            yield image


def _read_image(file: str, index: int) -> UInt8:
    image = read_image(file, "image", mend=f"replace it, or delete it to have frame {index} dropped")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _numbered(pattern: str) -> list[str | None]:
    field = re.search(r"%0?\d*d", pattern)
    if field is None or pattern.count("%") != 1:
        raise InputError(f"image pattern {pattern} must hold one number field such as %04d.")
    head, tail = pattern[: field.start()], pattern[field.end() :]
    shape = re.compile(re.escape(head) + r"(\d+)" + re.escape(tail) + "$")
    found = {int(m[1]): m.string for m in map(shape.match, glob(escape(head) + "*" + escape(tail))) if m}
    return [found.get(i) for i in range(min(found), max(found) + 1)] if found else []


def _in_order(pattern: str) -> list[str | None]:
    files = map(str, Path(pattern).iterdir()) if Path(pattern).is_dir() else matching(pattern)
    images: list[str] = [file for file in files if Path(file).suffix.lower() in IMAGE_ENDINGS]
    return [*sorted(images, key=natural)]


def matching(pattern: str) -> list[str]:
    """Files that a pattern names. Brackets in the names of files and folders that exist are no pattern."""
    path = Path(pattern)
    if path.exists():
        return [pattern]
    folder = next(parent for parent in path.parents if parent.is_dir())
    return sorted(glob(str(Path(escape(str(folder))) / path.relative_to(folder))))


def natural(name: str) -> list[tuple[int, str]]:
    """Sorts 2 before 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
