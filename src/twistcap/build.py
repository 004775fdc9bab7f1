"""A model from settings: our own cues, predictors, priors and searches, and those that plug-ins add."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from twistcap.body import Body
from twistcap.camera import Rig
from twistcap.cues import Cue
from twistcap.cues.brightness import Brightness
from twistcap.cues.contour import ContourCue
from twistcap.cues.direct import DirectContour
from twistcap.cues.keypoints import Keypoints2D
from twistcap.cues.levelset import LevelSetContour
from twistcap.cues.visibility import OcclusionRule
from twistcap.differential.model import DifferentialModel
from twistcap.errors import InputError
from twistcap.motion import MotionLibrary, motion_predictor
from twistcap.motion.predictor import TrainedMotion
from twistcap.predict import Predictor
from twistcap.predict.flow import FlowPredictor
from twistcap.predict.inertia import Inertia
from twistcap.priors import ParzenPrior, PosePrior, Prior, PriorRule, matched
from twistcap.priors.standing import Expectation, JointLimits, RestPose
from twistcap.registry import Registry
from twistcap.search import Search
from twistcap.search.lost import LostBody
from twistcap.settings import Settings
from twistcap.track.model import Model
from twistcap.track.schedule import Schedule

# A line here, or an entry point of the same group in an installed package, makes a name for Settings.plugins.
CUES = Registry("cue", "twistcap.cues", {})
PREDICTORS = Registry("predictor", "twistcap.predictors", {})
PRIORS = Registry("prior", "twistcap.priors", {})
SEARCHES = Registry("search", "twistcap.searches", {})

_FAR_DEG = 2.0  # a first pose that may be farther off than this needs more looks at its frame
_LOOKS = (10, 25)


@dataclass(frozen=True)
class Plugins:
    """What the plug-ins of a session add."""

    cues: tuple[Cue, ...] = ()
    predictors: tuple[Predictor, ...] = ()
    priors: tuple[Prior, ...] = ()
    searches: tuple[Search, ...] = ()

    @staticmethod
    def named(names: tuple[str, ...]) -> Plugins:
        """Made by name. Raises InputError for a name that nobody has registered."""
        registries = (CUES, PREDICTORS, PRIORS, SEARCHES)
        for name in names:
            if not any(name in registry.names() for registry in registries):
                known = sorted({n for registry in registries for n in registry.names()})
                raise InputError(f"tracker: there is no plug-in {name!r}; there are {', '.join(known) or 'none'}.")
        made: list[tuple[Any, ...]] = [tuple(r.get(n)() for n in names if n in r.names()) for r in registries]
        return Plugins(*made)


def build(
    body: Body, rig: Rig, settings: Settings | None = None, prior: ParzenPrior | None = None,
    motions: MotionLibrary | None = None,
) -> Model:  # fmt: skip
    """The model of a body before cameras. Raises InputError for settings, plug-ins, a prior or a library that do not
    fit.
    """
    settings = settings or Settings()
    more, contour = Plugins.named(settings.plugins), contour_of(settings)
    looks = _LOOKS[settings.first_sigma_deg > _FAR_DEG]
    brightness = (Brightness(),) if settings.brightness else ()
    priors: tuple[Prior, ...] = (
        JointLimits(), RestPose(), Expectation(), Keypoints2D(settings.keypoint_sigma, rig=rig),
    )  # fmt: skip
    if prior is not None:
        priors = (*priors, PosePrior(matched(prior, body), PriorRule(settings.prior_strength)))
    return Model(
        body, rig.pinhole(), (contour, *brightness, *more.cues),
        (*more.predictors, *predictors_of(settings, body, rig, motions)), (*priors, *more.priors),
        (LostBody(), *more.searches), Schedule(looks, contour.alternations, contour.slip),
        None if prior is None else OcclusionRule(), channels=settings.channels,
    )  # fmt: skip


def of_method(
    body: Body, rig: Rig, settings: Settings, prior: ParzenPrior | None = None, motions: MotionLibrary | None = None
) -> Model | DifferentialModel:
    """The model of the chosen method: brightness alone, or as `build` makes it. Raises InputError as `build` does; and
    for a prior or a library that the method cannot use.
    """
    if settings.method != "differential":
        return build(body, rig, settings, prior, motions)
    if prior is not None or motions is not None:
        raise InputError('tracker: method "differential" takes neither a prior nor motions; leave them out.')
    return DifferentialModel(body, settings.differential, rig=rig)


def contour_of(settings: Settings) -> ContourCue:
    """The contour cue of the chosen method. Raises InputError for the method without contours."""
    if settings.method == "differential":
        raise InputError('tracker: method "differential" has no contours; use build.of_method instead of build.')
    kind = DirectContour if settings.method == "direct" else LevelSetContour
    return kind(density=settings.density, statistics=settings.statistics, surface_sigma=settings.surface_sigma)


def predictors_of(settings: Settings, body: Body, rig: Rig, motions: MotionLibrary | None) -> tuple[Predictor, ...]:
    """Training motion where it is asked for, optic flow, inertia. Raises InputError for a library that is not asked
    for, or none where one is.
    """
    if (settings.predictor == "motion") != (motions is not None):
        raise InputError('tracker: predictor "motion" and a library of motions go together; give both or none.')
    hold = settings.predictor == "hold"
    inertia = Inertia(hold, settings.first_sigma_deg, settings.first_sigma_m)
    trained = () if motions is None else (TrainedMotion(motion_predictor(settings.motion, motions, body)),)
    flow = () if hold else (FlowPredictor(rig.pinhole(), inertia, settings.predictor == "flow"),)
    return (*trained, *flow, inertia)
