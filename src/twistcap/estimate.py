"""What goes into the tracker for one frame, and what comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.body import Pose

Sources = tuple[int, ...]
"""(C,) the camera under whose name each camera's picture came; () where each came under its own."""


@dataclass(frozen=True)
class Keypoints:
    """2D keypoints of one instant, in every camera of a rig.

    Attributes:
        names: L landmark names of the body (``knee_r``).
        pixels: (C, L, 2) pixels in the cameras' own (distorted) grids, NaN where there is none.
        confidence: (C, L) weight in [0, 1], 0 where there is none.
    """

    names: tuple[str, ...]
    pixels: Float
    confidence: Float

    def sorted_by(self, sources: Sources) -> Keypoints:
        """Those of each camera's own picture."""
        order = list(sources)
        return replace(self, pixels=self.pixels[order], confidence=self.confidence[order]) if sources else self


@dataclass(frozen=True)
class Frame:
    """One instant of a recording.

    Attributes:
        index: frame number in the recording.
        time: seconds.
        images: one per camera of the rig, (H, W) grey or (H, W, 3) RGB, uint8 or float32 in [0, 1], rectified
            (`camera.Rectifier`); None where the camera dropped the frame.
        keypoints: 2D landmarks of this instant, where somebody has them.
        sources: under which names the pictures came, where they have been sorted.
    """

    index: int
    time: float
    images: tuple[AnyArray | None, ...]
    keypoints: Keypoints | None = None
    sources: Sources = ()

    def sorted_by(self, sources: Sources) -> Frame:
        """The frame with each camera's picture from where it is in this one."""
        if not sources:
            return self
        points = None if self.keypoints is None else self.keypoints.sorted_by(sources)
        own = tuple(range(len(sources)))
        came = tuple((self.sources or own)[s] for s in sources)
        images = tuple(self.images[s] for s in sources)
        return replace(self, images=images, keypoints=points, sources=() if came == own else came)

    @property
    def missing(self) -> tuple[int, ...]:
        """Cameras without a picture."""
        return tuple(i for i, image in enumerate(self.images) if image is None)

    @property
    def brightness(self) -> Float:
        """(C,) mean of each picture in [0, 1], by every fifth pixel each way; NaN where there is none."""
        return np.array([np.nan if image is None else _mean(image) for image in self.images])


def _mean(image: AnyArray) -> float:
    return float(image[::5, ::5].mean()) / (255.0 if image.dtype == np.uint8 else 1.0)


UNSEEN = ("no_images", "not_found")
"""Statuses of frames whose pose is a prediction."""


@dataclass(frozen=True)
class Estimate:
    """The tracker's answer for one frame.

    Attributes:
        index, time: of the frame.
        pose: root motion and joint coordinates (rad).
        covariance: (6 + J, 6 + J) of the step δ that `Pose.retract` takes (rad, m), from the solve.
        energies: energy by term.
        status: "converged" | "max_iterations" | "no_images" | "not_found" (images, but no body in them) |
            "stalled" (no step lowered the energy) | "failed".
        iterations: accepted solver steps.
        lost: whether it is likely that a joint of a limb that images show is more than 150 mm off, by `probability`.
        support: fraction of contour points that agree with the images, of the part with fewest.
        predicted: what told the pose that the frame was started from: "motion", "flow", "constant_velocity" or "hold".
        probability: that a joint of such a limb is more than 150 mm off, calibrated on captures with truth.
        part_probability: (S,) the same of each segment's limb, NaN for limbs that are not judged, as some of
            them is in no image, or they look like what is behind them; None where nothing was seen of the body.
        left_out: cameras of the rig that contradict the others and are not believed.
        missing: cameras whose picture was missing, blank, or the one before once more.
        bumps: (C, 3) turn of each camera from where it is calibrated, in its own frame, rad; None or 0 where none was.
        sources: under which names the cameras' pictures came, if they were swapped.
        relit: whether all pictures have just changed, as by another light, so that the body's look was learned again.
        brightness: (C,) mean of each camera's picture, 0 to 1, NaN where none was looked at; None where unknown.
    """

    index: int
    time: float
    pose: Pose
    covariance: Float
    energies: Mapping[str, float] = field(default_factory=dict)
    status: str = "converged"
    iterations: int = 0
    lost: bool = False
    support: float = 1.0
    predicted: str = "hold"
    probability: float = 0.0
    part_probability: Float | None = None
    left_out: tuple[int, ...] = ()
    missing: tuple[int, ...] = ()
    bumps: Float | None = None
    sources: Sources = ()
    relit: bool = False
    brightness: Float | None = None

    @property
    def swapped(self) -> tuple[int, ...]:
        """Cameras whose pictures came under other names."""
        return tuple(c for c, source in enumerate(self.sources) if source != c)

    @property
    def turned(self) -> tuple[int, ...]:
        """Cameras that stand elsewhere than they were calibrated, and whose pictures are turned back."""
        return () if self.bumps is None else tuple(np.flatnonzero(np.any(self.bumps, axis=1)).tolist())

    @property
    def seen(self) -> bool:
        """Whether images showed the body."""
        return self.status not in UNSEEN

    @property
    def single_view(self) -> bool:
        """Whether one camera alone showed the body, so that nothing tells how far away its limbs are."""
        shown = [] if self.brightness is None else np.flatnonzero(~np.isnan(self.brightness)).tolist()
        return self.seen and len({*shown} - {*self.left_out}) == 1
