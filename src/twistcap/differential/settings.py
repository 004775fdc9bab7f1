"""Settings of the differential tracker, and the rule by which it goes over one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from twistcap.ranges import Checked, Count, Positive, Share


@dataclass(frozen=True)
class DifferentialConfig(Checked, where="tracker.differential"):
    """The ``[tracker.differential]`` table of a session.

    Attributes:
        support: "robust" for Cauchy weights, "em" for the paper's support maps by EM, "shape" for the projected body as
            it is.
        behind: the layer behind stands "still", or moves as the "dominant" motion off the body.
        exposure: whether each view's exposure may change from frame to frame.
        colour: whether RGB images count with their colours; False takes their grey alone.
        turns: "planar" holds the view's turns out of the image.
        stray_deg: how far joints stray from where they are expected in a frame.
        perspective: whether views that begin from calibrated cameras are those pinholes' own; otherwise they are the
            scaled orthography nearest to them (`state.state_of`).
        search_deg: how far about the guess limbs are searched before the gradients have their say; 0 searches none.
    """

    support: Literal["robust", "em", "shape"] = "robust"
    behind: Literal["still", "dominant"] = "still"
    exposure: bool = True
    colour: bool = True
    turns: Literal["all", "planar"] = "all"
    stray_deg: Positive = 6.0
    perspective: bool = False
    search_deg: float = 0.0


@dataclass(frozen=True)
class Rule(Checked):
    """What no user can know better; experiments alone choose another.

    Attributes:
        levels: of the image pyramid, by factors of 2.
        iterations: Gauss-Newton steps at each level.
        update: fraction of the new brightness a remembered point takes over in each frame; 1 remembers nothing.
        carry: fraction of the joints' last motion that is expected to go on; 0 expects everything to stay.
        turn_deg, scale, shift_px: how far the views' turns, scales and places stray from the guess in a frame.
    """

    levels: Count = 4
    iterations: Count = 6
    update: Share = 0.2
    carry: Share = 1.0
    turn_deg: Positive = 3.0
    scale: Positive = 0.01
    shift_px: Positive = 8.0
