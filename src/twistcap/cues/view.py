"""One camera's image at one instant, as the cues want it."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from twistcap._cached import cached
from twistcap.arrays import AnyArray, Float, Float32
from twistcap.body import Posed
from twistcap.camera import Camera, Rig
from twistcap.camera.bump import turned_back
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.features import Channels, feature_channels, grey, opponent
from twistcap.render import body_window
from twistcap.stages import stage

_FINEST, _BETWEEN = 0.7, 0.8  # px, Gaussians under which a level of the pyramid is seen, and made smaller

_SAMPLED = 5  # every fifth pixel each way tells a picture from another
_SPECKLED, _MANY_SPECKLES, _NOTHING_ELSE = 0.05, 0.25, 0.42  # of pixels' values: in a good picture 0.005 at most
_UNLIKE = 0.16  # by which a value is off the median about it
_BANDS, _ROWS = 4, 8  # of an image, by which that is judged
_BLANK = 0.02  # standard deviation below which a picture shows nothing


@dataclass(frozen=True)
class Picture:
    """An image under blurs and in the levels of a pyramid, each of which is computed once.

    Attributes:
        image: (H, W[, 3]) uint8 or in [0, 1].
        origin: (x, y) of its first pixel in the whole image of the camera.
    """

    image: AnyArray
    origin: tuple[int, int] = (0, 0)
    _blurs: dict[float, Float32] = field(default_factory=dict, repr=False)
    _levels: dict[tuple[int, bool], Float32] = field(default_factory=dict, repr=False)

    @cached
    def grey(self) -> Float32:
        """(H, W) float32."""
        return grey(self.image)

    def blurred(self, sigma: float) -> Float32:
        """(H, W) grey values under a Gaussian of `sigma` px (to a tenth of a pixel)."""
        sigma = round(sigma, 1)
        if sigma not in self._blurs:
            with stage("features"):
                size = 2 * math.ceil(2.7 * sigma) + 1
                blur = self.grey if sigma < 0.3 else cv2.GaussianBlur(self.grey, (size, size), sigma)
                self._blurs[sigma] = np.asarray(blur, dtype=np.float32)
        return self._blurs[sigma]

    def level(self, level: int, colour: bool = True) -> Float32:
        """(C, H, W) opponent colours (or grey alone), smaller by 2 to the power of `level`, each blurred a little.

        Pixel centres stay at integers: pixel x of one level is 2 x + ½ of the one before.
        """
        if (level, colour) not in self._levels:
            if level == 0:
                each = opponent(self.image, colour)
            else:
                each = [_halved(channel) for channel in self.level(level - 1, colour)]
            self._levels[level, colour] = np.stack([_gaussian(channel, _FINEST) for channel in each])
        return self._levels[level, colour]

    def levels(self, count: int, colour: bool = True) -> list[Float32]:
        """So many levels of the pyramid, finest first."""
        return [self.level(k, colour) for k in range(count)]


def _halved(image: Float32) -> Float32:
    height, width = image.shape
    even = image[: height // 2 * 2, : width // 2 * 2]
    small = cv2.resize(_gaussian(even, _BETWEEN), (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def _gaussian(image: Float32, sigma: float) -> Float32:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32)


@dataclass(frozen=True)
class View:
    """A rectified image, cropped to where the body is expected, and the camera of that crop.

    Attributes:
        camera: pinhole, of the crop.
        image: (H, W[, 3]) uint8 or float32.
        channels: what the region statistics look at.
        origin: (x, y) of the crop's first pixel in the whole image.
    """

    camera: Camera
    image: AnyArray
    channels: Channels = "grey"
    origin: tuple[int, int] = (0, 0)

    @cached
    def picture(self) -> Picture:
        """The image under blurs and in a pyramid."""
        return Picture(self.image, self.origin)

    @cached
    def features(self) -> Float32:
        """(H, W, C) float32."""
        with stage("features"):
            return self.grey[..., None] if self.channels == "grey" else feature_channels(self.image, self.channels)

    @cached
    def grey(self) -> Float32:
        """(H, W) float32."""
        return self.picture.grey

    def blurred(self, sigma: float) -> Float32:
        """(H, W) grey values under a Gaussian of `sigma` px (to a tenth of a pixel)."""
        return self.picture.blurred(sigma)


def view_window(camera: Camera, posed: Posed, margin_m: float) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Corner (x, y) and size (w, h), px, of a posed body with `margin_m` metres about it; None off the image."""
    depth = camera.T_cam_world[2, :3] @ posed.pose.root[:3, 3] + camera.T_cam_world[2, 3]
    return body_window(posed, camera, margin_m * camera.K[0, 0] / max(depth, 0.1) + 3.0)


def crop_view(image: AnyArray, camera: Camera, posed: Posed, margin_m: float, channels: Channels) -> View | None:
    """The view of a posed body with `margin_m` metres about it; None where the body is not in the image. Raises
    InputError for a value that is not finite.
    """
    window = view_window(camera, posed, margin_m)
    if window is None:
        return None
    (x, y), (w, h) = window
    crop = np.ascontiguousarray(image[y : y + h, x : x + w])
    if crop.dtype != np.uint8 and not np.all(np.isfinite(crop)):
        raise InputError(
            f"camera {camera.name!r}: its image holds a value that is not finite; repair it or give None instead."
        )
    return View(camera.cropped((x, y), (w, h)), crop, channels, (x, y))


def with_news(frame: Frame, before: tuple[int, ...], moving: bool) -> tuple[Frame, tuple[int, ...]]:
    """The frame without pictures that tell nothing, and a fingerprint of each picture, 0 for none.

    A blank picture tells nothing, nor does the one before once more, where the body moves or other cameras show new
    ones, and as long as it stays the same: a sensor's noise never repeats.

    Args:
        before: fingerprints of the frame before; negative where the picture told nothing because it was an old one.
        moving: whether the body has moved of late.
    """
    samples = [None if i is None else np.ascontiguousarray(i[::_SAMPLED, ::_SAMPLED]) for i in frame.images]
    prints = tuple(0 if sample is None else zlib.crc32(sample.data) or 1 for sample in samples)
    before = before or (0,) * len(prints)
    again = [now == abs(then) != 0 for now, then in zip(prints, before, strict=True)]
    live = moving or any(now and not same for now, same in zip(prints, again, strict=True))
    old = [same and (live or then < 0) for same, then in zip(again, before, strict=True)]
    news = [not (o or (s is not None and _blank(s))) for o, s in zip(old, samples, strict=True)]
    images = tuple(image if new else None for image, new in zip(frame.images, news, strict=True))
    prints = tuple(-now if o else now for now, o in zip(prints, old, strict=True))
    return (frame if all(news) else replace(frame, images=images)), prints


def _blank(image: AnyArray) -> bool:
    return float(cv2.meanStdDev(image)[1].max()) < _BLANK * (255.0 if image.dtype == np.uint8 else 1.0)


def as_calibrated(frame: Frame, estimate: Estimate, rig: Rig) -> Frame:
    """The frame, its images as if each had come from its own camera, where that was calibrated."""
    own = frame.sorted_by(estimate.sources)
    return own if estimate.bumps is None else steadied(own, estimate.bumps, rig)


def steadied(frame: Frame, bumps: Float, rig: Rig) -> Frame:
    """The frame, its images as if no camera had been turned, by rotation vectors (C, 3) of their own frames.

    Keypoints of those that were turned do not count.
    """
    if not np.any(bumps):
        return frame
    each, points = zip(frame.images, rig, bumps, strict=True), frame.keypoints
    images = tuple(None if image is None else turned_back(image, camera, bump) for image, camera, bump in each)
    if points is not None:
        points = replace(points, confidence=np.where(np.any(bumps, axis=1)[:, None], 0.0, points.confidence))
        points = points if points.confidence.any() else None
    return replace(frame, images=images, keypoints=points)


def despeckled(frame: Frame) -> Frame:
    """The frame, each image with single wrong pixels under a median filter, a wide one where they are many.

    Where nearly all are wrong a filter would make blots of them, which look like bodies more than noise does.
    """
    with stage("despeckle"):
        images = list(frame.images)
        for i, image in enumerate(images):
            wrong = 0.0 if image is None else speckles(image)
            if image is not None and _SPECKLED < wrong < _NOTHING_ELSE:
                images[i] = cv2.medianBlur(image, 3 if wrong < _MANY_SPECKLES else 5)
    return replace(frame, images=tuple(images))


def speckles(image: AnyArray) -> float:
    """Fraction of the values of an image that are unlike those about them, by a few of its rows."""
    most, wrong, count = _UNLIKE * (255.0 if image.dtype == np.uint8 else 1.0), 0, 0
    for row in np.linspace(0, max(len(image) - _ROWS, 0), _BANDS).astype(int):
        band = image[row : row + _ROWS]
        apart = cv2.absdiff(band, cv2.medianBlur(band, 3))
        wrong, count = wrong + np.count_nonzero(apart > most), count + apart.size
    return wrong / max(count, 1)
