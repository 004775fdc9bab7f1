"""What the search for a lost body and its limbs remembers from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.predict.history import Moment
from twistcap.search.bump import Unrest
from twistcap.search.contradiction import Suspicion
from twistcap.search.doubt import Doubt
from twistcap.search.flag import shortfall
from twistcap.search.recollection import Recollection

LACKED = 11
"""Frames of which it is remembered what evidence lacked."""


@dataclass(frozen=True)
class LostMemory:
    """What is remembered.

    Attributes:
        known: what the recording has taught.
        groups: (G, S) segments of each limb and of the rest of the body.
        found: (G,) 1 where a search has just put each limb or the rest, and less from frame to frame: what is rightly
            tracked has a history, and what was found has none.
        jumped: (G,) m, how far each was from where it was expected, and less from frame to frame.
        unrest: of cameras that were bumped.
        suspicion: of cameras.
        frames: counted.
        waiting: frames until the next search for the body.
        limb_waiting, limb_pause: frames until the next one for a limb, and between the last ones.
        doubt: of the whole body where it is fitted.
        nowhere: whether the last one found the body nowhere.
        surely: when and where the body was last without doubt; from there on it is looked for.
        usual: (G, 3) what the contour usually says against each, see `contour_signs`.
        signs, lately: (G, SIGNS) of loss, of each limb and the rest of the body; now, and their running mean.
        lacked: (≤ LACKED, G) fraction of the usual evidence that lacked of each in the last frames before, the latest
            last.
    """

    known: Recollection
    groups: Bool
    found: Float
    jumped: Float
    unrest: Unrest
    suspicion: Suspicion = field(default_factory=lambda: Suspicion({}))
    frames: int = 0
    waiting: int = 0
    limb_waiting: int = 0
    limb_pause: int = 0
    doubt: Doubt = field(default_factory=Doubt)
    nowhere: bool = False
    surely: Moment | None = None
    usual: Float | None = None
    signs: Float | None = None
    lately: Float | None = None
    lacked: Float | None = None

    def begun_anew(self) -> LostMemory:
        """For another track through the same recording: nothing is doubted or waited for yet."""
        none = np.zeros(len(self.groups))
        return replace(
            self, suspicion=self.suspicion.begun_anew(), found=none, jumped=none, waiting=0, limb_waiting=0,
            limb_pause=0, doubt=Doubt(), nowhere=False, surely=None, signs=None, lately=None, lacked=None,
        )  # fmt: skip

    @property
    def remembered(self) -> LostMemory:
        """With what lacks in the last frame among what has lacked."""
        if self.signs is None:
            return self
        lacks = shortfall(self.signs)[None]
        lacked = lacks if self.lacked is None else np.concatenate([self.lacked, lacks])[-LACKED:]
        return replace(self, lacked=lacked)
