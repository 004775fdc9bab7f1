"""What stays the same from frame to frame: the body, the cameras, and the lists of what tracks it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.cues import Cue
from twistcap.cues.support import SupportRule
from twistcap.cues.view import View, crop_view
from twistcap.cues.visibility import OcclusionRule
from twistcap.estimate import Frame
from twistcap.features import Channels
from twistcap.predict import MotionNoise, MotionSpread, Predictor
from twistcap.predict.history import Moment, Past
from twistcap.priors import Prior
from twistcap.registry import check_owners
from twistcap.search import Search
from twistcap.search.flag import FlagRule
from twistcap.track.schedule import Schedule
from twistcap.track.state import State

MARGIN = 0.15
"""m about the expected body within which images are looked at."""


@dataclass(frozen=True)
class Model:
    """A body before cameras, and how it is tracked. Lists are asked in their order.

    Attributes:
        body: that is tracked.
        rig: (pinhole) cameras of the rectified images.
        cues: evidence in the images.
        predictors: the first that answers is believed; the last one always answers.
        priors: what is known beside the images.
        searches: where else the body may be.
        schedule: how often the images are looked at, and how coarsely.
        occlusion: when the information about a part that is not in sight is taken out; None: never.
        support: how far the images are believed, and when a part is lost.
        flag: how probable it is that a part is lost.
        noise: how far bodies are from where they are predicted.
        channels: what region statistics look at.
        learn_every: frames from one lesson of the cues to the next.
    """

    body: Body
    rig: Rig
    cues: tuple[Cue, ...]
    predictors: tuple[Predictor, ...]
    priors: tuple[Prior, ...]
    searches: tuple[Search, ...] = ()
    schedule: Schedule = field(default_factory=Schedule)
    occlusion: OcclusionRule | None = None
    support: SupportRule = field(default_factory=SupportRule)
    flag: FlagRule = field(default_factory=FlagRule)
    noise: MotionNoise = field(default_factory=MotionNoise)
    channels: Channels = "lab"
    learn_every: int = 3

    def __post_init__(self) -> None:
        for kind in ("cues", "predictors", "searches"):
            check_owners(kind, getattr(self, kind))

    def with_cue(self, cue: Cue) -> Model:
        """With a cue in the place of the one of its name."""
        return replace(self, cues=tuple(cue if one.name == cue.name else one for one in self.cues))

    def start(self, pose: Pose, time: float = 0.0) -> State:
        """The state before the first frame, which is tracked from a given pose."""
        body, parts = self.body, len(self.body.segment_names)
        past = Past((Moment(time, pose),), time, False, MotionSpread.usual(self.noise))
        lists = self.cues, self.predictors, self.searches
        cues, predictors, searches = ({one.name: one.start(body, self.rig) for one in ones} for ones in lists)
        zero, still = np.zeros((body.dof, body.dof)), np.zeros((len(self.rig), 3))
        support, occluded = np.ones(parts), np.zeros(parts, np.bool_)
        return State(past, zero, zero, support, occluded, (), still, (), (), 0, cues, predictors, searches)

    def views(
        self, frame: Frame, pose: Pose, margin: float = MARGIN, left_out: Collection[int] = ()
    ) -> Mapping[int, View]:
        """The images about a pose, by camera; a dropped image, or a camera that is left out, is simply not there."""
        posed, out = Posed(self.body, pose), dict[int, View]()
        for i, image in enumerate(frame.images):
            if image is None or i in left_out:
                continue
            if (view := crop_view(image, self.rig[i], posed, margin, self.channels)) is not None:
                out[i] = view
        return out
