"""What a user can know and set of the tracker; everything else is a constant beside its formula."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from twistcap.differential.settings import DifferentialConfig
from twistcap.errors import InputError
from twistcap.features import Channels
from twistcap.motion import MotionKind
from twistcap.ranges import Checked, Positive
from twistcap.region.models import Density, Statistics

PredictorName = Literal["constant_velocity", "hold", "flow", "motion"]


@dataclass(frozen=True)
class Settings(Checked, where="tracker"):
    """The ``[tracker]`` table of a session.

    Attributes:
        method: "direct" measures contours along their normals. "levelset" finds them by a coupled level set.
            "differential" tracks by brightness alone and reads only the table of that name.
        channels: what region statistics look at: "grey", "lab", "grey+texture" (5 channels) or "lab+texture" (7).
        density: what the densities of the regions are: "local" Gaussians, one "global" Gaussian for each region, or
            "parzen", one smoothed histogram for each region.
        statistics: whether densities inside are of each "part" or of the "whole" body. The default is "part" for local
            densities in the direct method, else "whole".
        surface_sigma: m, standard deviation of the body's surface from the person's, where that is known. Use 0.006
            for a body from key views.
        brightness: whether the brightness of the surface is followed beside the contours. Turn it off where lights
            flicker.
        predictor: where the body is expected. "hold" is where it was, "flow" where optic flow leads. "motion" is as in
            training motion and needs `[motions]`.
        motion: how training motion predicts: "followed" is the default, "guarded" yields to inertia where that does
            better. "scaled", "unscaled" and "standard" are the paper's, for comparison.
        keypoint_sigma: m on the body, standard deviation of a 2D keypoint of confidence 1.
        prior_strength: weight of a pose prior for each contour sample.
        first_sigma_deg: degrees, standard deviation of the joints and the turn of the first pose.
        first_sigma_m: m, standard deviation of the place of the first pose.
        plugins: names of registered cues, predictors, priors and searches that track beside the tracker's own.
        differential: of the method of that name.
    """

    method: Literal["direct", "levelset", "differential"] = "direct"
    channels: Channels = "lab"
    density: Density = "local"
    statistics: Statistics | None = None
    surface_sigma: float = 0.0
    brightness: bool = True
    predictor: PredictorName = "constant_velocity"
    motion: MotionKind = "followed"
    keypoint_sigma: Positive = 0.03
    prior_strength: float = 0.05
    first_sigma_deg: Positive = 1.0
    first_sigma_m: Positive = 0.005
    plugins: tuple[str, ...] = ()
    differential: DifferentialConfig = field(default_factory=DifferentialConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.plugins, str) or len(set(self.plugins)) < len(self.plugins):
            raise InputError(f"tracker: plugins is {self.plugins!r}; give a list of names, each once.")
