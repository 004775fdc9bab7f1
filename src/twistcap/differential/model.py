"""The differential method as a model: what stays the same from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, field

from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.differential.settings import DifferentialConfig, Rule
from twistcap.differential.state import Track
from twistcap.differential.world import state_of
from twistcap.errors import InputError


@dataclass(frozen=True)
class DifferentialModel:
    """A body that is followed by brightness alone.

    Attributes:
        body: whose surface gives the depth.
        config: settings.
        rule: of one frame.
        rig: rectified cameras, from which the views' turns and scales start and which place the body in the world;
            None where none are known.
    """

    body: Body
    config: DifferentialConfig = field(default_factory=DifferentialConfig)
    rule: Rule = field(default_factory=Rule)
    rig: Rig | None = None

    @property
    def cameras(self) -> Rig:
        """The rig.

        Raises:
            InputError: where there is none.
        """
        if self.rig is None:
            raise InputError("differential: poses in the world need calibrated cameras; use differential.step.track.")
        return self.rig

    def start(self, pose: Pose, time: float = 0.0) -> Track:
        """The track before the first frame, which shows the body at a pose."""
        del time  # nothing is predicted into the first frame
        return Track.of(state_of(pose, self.cameras, self.config.perspective))
