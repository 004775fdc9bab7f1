"""Settings of the refinement."""

from __future__ import annotations

from dataclasses import dataclass

from twistcap.errors import check
from twistcap.ranges import Checked, Count, Positive


@dataclass(frozen=True)
class RefineConfig(Checked, where="refine"):
    """How a track is refined.

    Attributes:
        rounds: greatest number of rounds; each measures the images and solves once.
        coarse_rounds: how many of the first search for contours farther off and compare brightness under a wide blur.
        strides: distances in frames between which brightness is compared.
        points: surface points whose brightness is compared, in each view.
        length, girth: standard deviations of the log-lengths and log-girths; 0 holds them.
        joint: m, standard deviation of each joint centre in each direction; 0 holds them.
        hinge: m, standard deviation of a hinge's centre from the middle of its limb, along its axis, which no motion
            shows; 0 leaves it free.
        contour: factor on the information of the contours.
        brightness: fraction of the information of the brightness differences that counts.
        sigma: noise of the brightness differences, of brightness in [0, 1].

    Raises InputError for a number that is not finite or out of its range.
    """

    rounds: Count = 14
    coarse_rounds: int = 2
    strides: tuple[Count, ...] = (1, 3, 6)
    points: Count = 400
    length: float = 0.05
    girth: float = 0.04
    joint: float = 0.012
    hinge: float = 0.004
    contour: float = 1.0
    brightness: float = 0.32
    sigma: Positive = 0.015

    def __post_init__(self) -> None:
        super().__post_init__()
        check("refine", self.strides, "strides are empty; give one or more, each 1 or more")
