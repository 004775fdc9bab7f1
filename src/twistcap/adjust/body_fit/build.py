"""What a kind of body may become in a fit, apart from its joint centres and offsets of its surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twistcap._typing import Float
from twistcap.adjust.body_fit import fields as f
from twistcap.adjust.body_fit.fields import Fields
from twistcap.body import Body

Motions = tuple[Float, Float, Float]
"""Of vertices (V, 3), joint centres (S, 3) and landmarks (L, 3) in the rest pose, m."""


class Build(Protocol):
    """Parameters of a body's build, all 0 where the fit begins."""

    @property
    def rigid(self) -> bool:
        """Whether its fields must not turn a segment's surface against the axes of its joint."""
        ...

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        """What each parameter moves, on the body as it is at these amounts (none named: all 0)."""
        ...

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        """The change (M,) that the bounds allow on amounts (M,), and what it moves, exactly."""
        ...

    def told(self, amounts: Mapping[str, float]) -> dict[str, float]:
        """What a report says of the amounts."""
        ...


@dataclass(frozen=True)
class Stretches:
    """Of any body: stature, length and girth of each kind of segment, factors of its cross-sections.

    Attributes:
        stature, length, girth, section: standard deviations of the log-factors.
        knots: of the sections along a segment.
        rigid: whether a segment's surface must not turn against the axes of its joint.
    """

    stature: float
    length: float
    girth: float
    section: float
    knots: int
    rigid: bool = True

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        del amounts
        stretches = f.stretch_fields(body, self.stature, self.length, self.girth)
        return stretches + f.profile_fields(body, self.section, self.knots)

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        del amounts
        return change, fields @ change

    def told(self, amounts: Mapping[str, float]) -> dict[str, float]:
        return {n: float(np.exp(a)) for n, a in amounts.items() if not n.startswith("section")}
