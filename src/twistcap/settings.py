"""The tracker's settings; those of each cue stand with the cue."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from typing import Literal

from twistcap.body import Body
from twistcap.cues.appearance import AppearanceRule
from twistcap.cues.brightness import Brightness
from twistcap.cues.direct import DirectContour
from twistcap.cues.evidence import ContourCue
from twistcap.cues.flow import FlowCue
from twistcap.cues.hidden import HiddenRule
from twistcap.cues.keypoints import KeypointCue
from twistcap.cues.levelset import LevelSetContour
from twistcap.cues.limbs import LimbRule
from twistcap.cues.reacquire import ReacquireRule
from twistcap.cues.rivals import RivalRule
from twistcap.cues.support import SupportRule
from twistcap.differential.settings import DifferentialConfig
from twistcap.errors import InputError
from twistcap.features import Channels
from twistcap.motion import MotionKind, MotionLibrary, MotionPredictor, motion_predictor
from twistcap.predict import MotionNoise, PredictorName
from twistcap.priors import PriorRule
from twistcap.region.models import Density, Statistics


@dataclass(frozen=True)
class TrackerConfig:
    """All settings of the tracker.

    Attributes:
        method: "direct" (no level set; the default), "levelset" (the chapter's coupled method), or
            "differential": brightness alone, see `twistcap.differential`, which reads only the table of that name.
        channels: what region statistics look at: "grey", "lab", "grey+texture" (5 channels) or "lab+texture" (7).
        despeckle: px across of a median filter of all images, 1, 3 or 5: it takes out single wrong pixels, as noise
            on a video line leaves them. 1 leaves the images as they are.
        density: what the regions' densities are: "local" Gaussians, one "global" Gaussian per region, or "parzen", one
            smoothed histogram per region. Reaches both methods.
        statistics: whether inside densities are each "part"'s own or of the "whole" body; None is part for local
            densities in the direct method, else whole, as in the chapter.
        surface_sigma: how far the body's surface may lie off the person's, m, standard deviation; reaches both methods.
            0 takes the body as exact; 0.006 suits one from key views (docs/reproduction/key-views.md).
        photometric: whether brightness constancy joins the contours.
        predictor: "constant_velocity", "hold", "flow": optic flow, constant velocity where flow cannot be trusted, or
            "motion": training motion, which the tracker must be given.
        motion: which prediction from training motion: "followed", the paper's "scaled", "unscaled" or
            "standard", "autoregressive" or "guarded".
        start_by_flow: whether flow predicts as long as there is no velocity: in the second frame.
        decay: time constant (s) with which predicted joint velocities die away.
        rest_sigma_deg: how far joints are expected from the rest pose; matters only to a limb that nothing shows.
        first_iterations: fine alternations in the first frame, which starts from a given pose.
        coarse: factor on the contour cue's capture range in the coarse alternations that come first.
        coarse_rounds: coarse alternations at most; one is enough where the prediction was good.
        surprise: m by which the first, fine alternation moves the contour where the prediction was not good enough, so
            that coarse ones follow.
        settled: m that the contour may still move in a coarse alternation that is the last one.
        render_after: m that the contour may have moved, all in all, before the body is rendered anew.
        contour_spacing: m on the body between contour samples.
        solver_steps: Gauss-Newton steps in each alternation.
        learn_every: frames from one to the next in which the parts' colours are learnt, the points whose brightness is
            followed are judged, and new ones are sought.
        margin: m about the expected body within which images are looked at.
        inflation: factor on every claimed standard deviation: contour and brightness samples are not independent, and
            no body is exact; set on studio captures with truth (docs/concepts/covariance.md).
        differential: of the method of that name.
        direct, levelset: the contour cue of each method.
        brightness, keypoints, flow: the other cues.
        noise: how far a body strays from the prediction.
        rivals: which doubtful limbs are tried elsewhere, and how.
        reacquire: how the body is sought when images return after a gap; None: it is fitted where it was predicted.
        limbs: how a limb is sought at once that the images no longer bear out; None: it is left to contours and rivals.
        appearance: how the parts' colours are remembered.
        support: when a part counts as lost.
        prior, hidden: how a prior of poses counts, and what a part that no view shows may do; without effect unless the
            tracker is given a prior, or `hidden.alone` is set.
        first_sigma_deg, first_sigma_m: how far the given first pose may be off (joints and root turn; root place).
    """

    method: Literal["direct", "levelset", "differential"] = "direct"
    channels: Channels = "lab"
    despeckle: int = 1
    density: Density = "local"
    statistics: Statistics | None = None
    surface_sigma: float = 0.0
    photometric: bool = True
    predictor: PredictorName = "constant_velocity"
    motion: MotionKind = "followed"
    start_by_flow: bool = True
    decay: float = 0.2
    rest_sigma_deg: float = 30.0
    first_iterations: int = 10
    coarse: float = 3.0
    coarse_rounds: int = 5
    surprise: float = 0.0085
    settled: float = 0.006
    render_after: float = 0.008
    contour_spacing: float = 0.032
    solver_steps: int = 1
    learn_every: int = 3
    margin: float = 0.15
    inflation: float = 5.0
    first_sigma_deg: float = 1.0
    first_sigma_m: float = 0.005
    differential: DifferentialConfig = field(default_factory=DifferentialConfig)
    direct: DirectContour = field(default_factory=DirectContour)
    levelset: LevelSetContour = field(default_factory=LevelSetContour)
    brightness: Brightness = field(default_factory=Brightness)
    keypoints: KeypointCue = field(default_factory=KeypointCue)
    flow: FlowCue = field(default_factory=FlowCue)
    noise: MotionNoise = field(default_factory=MotionNoise)
    rivals: RivalRule = field(default_factory=RivalRule)
    reacquire: ReacquireRule | None = None
    limbs: LimbRule | None = None
    appearance: AppearanceRule = field(default_factory=AppearanceRule)
    support: SupportRule = field(default_factory=SupportRule)
    prior: PriorRule = field(default_factory=PriorRule)
    hidden: HiddenRule = field(default_factory=HiddenRule)

    def __post_init__(self) -> None:
        if self.despeckle not in (1, 3, 5):
            raise InputError(f"tracker: despeckle is {self.despeckle}; it must be 1, 3 or 5.")
        if not all(
            0.0 <= (s or 0.0) < inf
            for s in (self.surface_sigma, self.direct.surface_sigma, self.levelset.surface_sigma)
        ):
            raise InputError("tracker: surface_sigma must be a finite number of metres, 0 or more.")

    @property
    def contour(self) -> ContourCue:
        """The cue of the chosen method; what it leaves open is the tracker's.

        Raises:
            InputError: for the method without contours.
        """
        if self.method == "differential":
            raise InputError('tracker: method "differential" has no contours; use DifferentialFollower instead.')
        cue = self.direct if self.method == "direct" else self.levelset
        off = self.surface_sigma if cue.surface_sigma is None else cue.surface_sigma
        density, statistics = cue.density or self.density, cue.statistics or self.statistics
        return replace(cue, density=density, statistics=statistics, surface_sigma=off)

    def seeking(self, unseen: float) -> ReacquireRule | None:
        """The rule of the search where the body must be sought, after `unseen` seconds without images."""
        return self.reacquire if self.reacquire is not None and unseen > self.reacquire.after else None

    def motion_from(self, library: MotionLibrary | None, body: Body) -> MotionPredictor | None:
        """The predictor from a library of training motion, where one is asked for.

        Raises:
            InputError: for a library that is not asked for, or none where one is.
        """
        if (self.predictor == "motion") != (library is not None):
            raise InputError('tracker: predictor "motion" and a library of motions go together; give both or none.')
        return None if library is None else motion_predictor(self.motion, library, body)
