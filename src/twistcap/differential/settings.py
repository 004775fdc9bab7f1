"""Settings of the differential tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from twistcap.errors import InputError


@dataclass(frozen=True)
class DifferentialConfig:
    """Settings of the differential tracker.

    Attributes:
        levels: of the image pyramid, by factors of 2.
        iterations: Gauss-Newton steps at each level.
        spacing: px between surface points at the finest level.
        update: share of the new brightness a remembered point takes over in each frame; 1 remembers nothing.
        hidden: frames that points are remembered while something hides them.
        support: "em" for support maps by EM, "robust" for Cauchy weights, "shape" for the projected body as it is.
        behind: the layer behind stands "still", or moves as the "dominant" motion off the body.
        carry: share of the joints' last motion that is expected to go on; 0 expects everything to stay.
        exposure: whether each view's exposure may change from frame to frame.
        colour: whether RGB images count with their colours; False takes their grey alone.
        share: share of the pixels' information that counts, since neighbours see the same.
        turns: "planar" holds the view's turns out of the image.
        stray_deg, stray_turn_deg, stray_scale, stray_px: how far joints, and the views' turns, scales and places stray
            from the guess in a frame.
        perspective: whether views that begin from calibrated cameras are those pinholes' own; otherwise they are the
            scaled orthography nearest to them (`world.state_of`).
        search_deg: how far about the guess limbs are sought before the gradients have their say; 0 seeks none.
        reach_px: distance from a rim at which half of the pixels are the body's own, prior of the support maps.
    """

    levels: int = 4
    iterations: int = 6
    spacing: int = 2
    update: float = 0.2
    hidden: int = 30
    support: Literal["em", "robust", "shape"] = "em"
    behind: Literal["still", "dominant"] = "still"
    carry: float = 1.0
    exposure: bool = True
    colour: bool = True
    share: float = 0.05
    turns: Literal["all", "planar"] = "all"
    stray_deg: float = 6.0
    stray_turn_deg: float = 3.0
    stray_scale: float = 0.01
    stray_px: float = 8.0
    perspective: bool = False
    search_deg: float = 0.0
    reach_px: float = 1.0

    def __post_init__(self) -> None:
        whole = self.levels >= 1 and self.iterations >= 1 and self.spacing >= 1
        if not whole or not 0.0 < self.update <= 1.0 or not 0.0 < self.share <= 1.0:
            raise InputError(
                "differential: levels, iterations and spacing must be 1 or more, "
                "update and share above 0 and at most 1."
            )
        if min(self.stray_deg, self.stray_turn_deg, self.stray_scale, self.stray_px) <= 0.0:
            raise InputError("differential: stray_deg, stray_turn_deg, stray_scale and stray_px must be positive.")
