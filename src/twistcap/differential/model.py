"""The differential method as a model: what stays the same from frame to frame, and which blocks are moved."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig, ScaledView
from twistcap.cues.memory import Retention
from twistcap.differential.settings import DifferentialConfig, Rule
from twistcap.differential.state import State, Track, state_of
from twistcap.solve import Variables, Vector
from twistcap.terms import BlockGaussian, BlockTerm
from twistcap.terms.photometric import EXPOSURE
from twistcap.terms.scaled import ViewGaussian

_DEEPER = 0.02  # m that a point may lie behind the rendered surface and still be remembered as seen
_HIDDEN = 30  # frames that points are remembered while something hides them
_EXPOSURE = np.array([0.1, 0.05])  # how far a view's gain and offset change from one frame to the next
_LONGEST = 0.35  # rad; no joint turns farther in one step of the descent
_PLANAR = np.array([False, False, False, True, True, False])  # a view's turns out of the image
JOINTS = "joints"
SPACING = 2
"""Px between surface points at the finest level."""


@dataclass(frozen=True)
class DifferentialModel:
    """A body that is followed by brightness alone.

    The body's surface gives the depth. From the rig, of rectified cameras, the views' turns and scales start, and it
    places the body in the world; it is empty where no cameras are known.
    """

    body: Body
    config: DifferentialConfig = field(default_factory=DifferentialConfig)
    rule: Rule = field(default_factory=Rule)
    rig: Rig = field(default_factory=lambda: Rig(()))

    def start(self, pose: Pose, time: float = 0.0) -> Track:
        """The track before the first frame, which shows the body at a pose; nothing is predicted into it."""
        return Track.of(state_of(pose, self.rig, self.config.perspective))

    def variables(self, state: State) -> Variables:
        """The views' motions, the joints inside their limits, and the views' exposures."""
        views, limits = view_blocks(state), self.body.limits
        exposures = {exposure_block(v): Vector(np.zeros(EXPOSURE)) for v in range(len(views))}
        blocks = {**views, JOINTS: Vector(np.clip(state.q, *limits.T), limits), **exposures}
        free = tuple(blocks) if self.config.exposure else (*views, JOINTS)
        fixed = dict.fromkeys(views, _PLANAR) if self.config.turns == "planar" else {}
        return Variables(blocks, free, {**dict.fromkeys(blocks, np.inf), JOINTS: _LONGEST}, fixed)

    def priors(self, guess: Variables) -> list[BlockTerm]:
        """How far a frame strays from the guess, and the views' exposures from those of the frame before."""
        q, stray = guess[JOINTS].values, self.rule
        view_sigma = np.array([stray.scale, *[stray.shift_px] * 2, *[np.deg2rad(stray.turn_deg)] * 3])
        out: list[BlockTerm] = [BlockGaussian(JOINTS, q, np.full(len(q), np.deg2rad(self.config.stray_deg)), JOINTS)]
        for v, view in enumerate(state_at(guess).views):
            out.append(ViewGaussian(view_block(v), view, view_sigma))
            out.append(BlockGaussian(exposure_block(v), np.zeros(EXPOSURE), _EXPOSURE, "exposure"))
        return out

    @property
    def retention(self) -> Retention:
        """How brightness is remembered."""
        return Retention(SPACING, "middle", self.rule.update, _DEEPER, np.inf, 0.5, 0.2, True, _HIDDEN)


def view_block(v: int) -> str:
    """Name of the block of a view's own motion."""
    return f"view {v}"


def exposure_block(v: int) -> str:
    """Name of that of a view's exposure."""
    return f"exposure {v}"


def view_blocks(state: State) -> dict[str, ScaledView]:
    """The views by the names of their blocks."""
    return {view_block(v): view for v, view in enumerate(state.views)}


def state_at(x: Variables) -> State:
    """The blocks as a state."""
    return State(tuple(block for block in x.blocks.values() if isinstance(block, ScaledView)), x[JOINTS].values)


def with_state(x: Variables, state: State) -> Variables:
    """The blocks at another state, exposures as they are."""
    return replace(x, blocks={**x.blocks, **view_blocks(state), JOINTS: replace(x[JOINTS], values=state.q)})


def posed_at(x: Variables, body: Body) -> Posed:
    """The body at the joints' values, in its own frame."""
    if "posed" not in x.memo:
        x.memo["posed"] = state_at(x).posed(body)
    return x.memo["posed"]
