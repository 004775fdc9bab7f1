"""Settings of a synthetic capture; equal settings give equal pixels."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twistcap.body.humanoid import Variant
from twistcap.errors import check
from twistcap.ranges import Checked, Count, Positive

Condition = Literal["exact", "mismatch"]


@dataclass(frozen=True)
class StudioConfig(Checked):
    """A synthetic capture.

    Attributes:
        seed, views: of all that is random; number of cameras on the ring, 1-8.
        size: (width, height) of the images, px. The person fills about 0.68 of the height.
        frames, fps: number of frames, and how many per second.
        condition: "exact", or "mismatch": body, cameras and first pose of the tracker differ from the truth.
        hard, one_colour: person and background have nearly the same colours; the whole body has one, only shaded.
        colour: RGB images; otherwise grey ones.
        speed_factor: playback speed of the motion.
        dropped: spans (first, last) of frames, both included, without images, or (first, last, camera).
        uniform_noise: fraction of pixels in [0, 1] replaced by uniform noise, or its knots, evenly spaced over the
            sequence: (0, 1, 0) rises from none to all and falls again.
        rectangles, occluders: numbers of painted rectangles in each image, and of occluders, the same in all frames.
        motion_blur: number of sub-frames averaged over the open time of the shutter, half the frame interval; 1: sharp.
        sensor_noise: standard deviation of Gaussian noise, in intensities of [0, 1].
        variant: of the built-in humanoid, when no body is given.

    Raises InputError for values out of range.
    """

    seed: int = 0
    views: Count = 4
    size: tuple[int, int] = (384, 280)
    frames: Count = 60
    fps: Positive = 60.0
    condition: Condition = "exact"
    hard: bool = False
    one_colour: bool = False
    colour: bool = True
    speed_factor: Positive = 1.0
    dropped: tuple[tuple[int, ...], ...] = ()
    uniform_noise: float | tuple[float, ...] = 0.0
    rectangles: int = 0
    occluders: int = 0
    motion_blur: Count = 1
    sensor_noise: float = 0.012
    variant: Variant = "full"

    def __post_init__(self) -> None:
        super().__post_init__()
        _expect(1 <= self.views <= 8, "views", self.views, "1 to 8")
        _expect(min(self.size) >= 16, "size", self.size, "at least 16 pixels each way")
        _expect(self.condition in ("exact", "mismatch"), "condition", self.condition, "'exact' or 'mismatch'")
        knots = np.atleast_1d(self.uniform_noise)
        _expect(bool(np.all((knots >= 0) & (knots <= 1))), "uniform_noise", self.uniform_noise, "in [0, 1]")
        shaped = all(len(span) in (2, 3) and span[0] <= span[1] for span in self.dropped)
        _expect(shaped, "dropped", self.dropped, "spans (first, last) or (first, last, camera)")

    def noise_fraction(self, frame: int) -> float:
        """Fraction of the pixels of a frame that uniform noise replaces."""
        knots = np.atleast_1d(np.asarray(self.uniform_noise, float))
        at = frame / max(1, self.frames - 1)
        return float(np.interp(at, np.linspace(0.0, 1.0, len(knots)), knots))

    def is_dropped(self, frame: int, camera: int) -> bool:
        """Whether a camera has no image of a frame."""
        return any(s[0] <= frame <= s[1] and (len(s) == 2 or s[2] == camera) for s in self.dropped)


def _expect(holds: bool, field: str, value: object, wanted: str) -> None:
    check("studio", holds, f"{field} is {value}; it must be {wanted}")


def stream(seed: int, purpose: str, *index: int) -> np.random.Generator:
    """Random numbers of one purpose (and frame, camera …), independent of all others and of the order of calls."""
    return np.random.default_rng(np.random.SeedSequence((seed, zlib.crc32(purpose.encode()), *index)))
