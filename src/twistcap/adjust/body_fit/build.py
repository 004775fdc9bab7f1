"""The build of a body in a fit: its free parameters other than joint centres and offsets of the surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twistcap.adjust.body_fit import fields as f
from twistcap.adjust.body_fit.fields import Fields
from twistcap.arrays import Float
from twistcap.body import Body

Motions = tuple[Float, Float, Float]
"""Of vertices (V, 3), joint centres (S, 3) and landmarks (L, 3) in the rest pose, m."""


class Build(Protocol):
    """Parameters of a body's build, all 0 at the start of the fit."""

    @property
    def rigid(self) -> bool:
        """Whether its fields must not turn a segment's surface against the axes of its joint."""
        ...

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        """Motions by each parameter, of the body at these amounts; an amount that is not named is 0."""
        ...

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        """The change (M,) inside the bounds of amounts (M,), and its exact motions."""
        ...

    def summary(self, amounts: Mapping[str, float]) -> dict[str, float]:
        """The amounts as a report shows them."""
        ...


@dataclass(frozen=True)
class Stretches:
    """The build of any body: stature, length and girth of each kind of segment, factors of its cross-sections.

    All are standard deviations of log-factors, but for the `knots` of the sections along a segment, and `rigid`.
    """

    stature: float = 0.02
    length: float = 0.01
    girth: float = 0.12
    section: float = 0.06
    knots: int = 5
    rigid: bool = True

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        del amounts
        stretches = f.stretch_fields(body, self.stature, self.length, self.girth)
        return stretches + f.profile_fields(body, self.section, self.knots)

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        del amounts
        return change, fields @ change

    def summary(self, amounts: Mapping[str, float]) -> dict[str, float]:
        return {n: float(np.exp(a)) for n, a in amounts.items() if not n.startswith("section")}
