"""Looking for the body elsewhere: what a search is. One file for each, and one judge for all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.cues.view import View
from twistcap.estimate import Frame
from twistcap.predict.history import Moment, Past
from twistcap.search.judge import Judge

__all__ = ["Judge", "Problem", "Revision", "Search"]

Views = Mapping[int, View]
"""Views by camera."""


class Problem(Protocol):
    """One frame, as a search sees it; nothing that it does changes the tracker's state."""

    @property
    def body(self) -> Body: ...
    @property
    def past(self) -> Past: ...
    @property
    def frame(self) -> Frame: ...
    @property
    def start(self) -> Pose:
        """Where the body is expected."""
        ...

    @property
    def spread(self) -> Float:
        """(6 + J, 6 + J) covariance of the step from there to the truth."""
        ...

    @property
    def views(self) -> Views: ...
    @property
    def trusted(self) -> bool:
        """Whether the images are believed entirely; in noise a limb may seem to be anywhere."""
        ...

    def judge(self, posed: Posed, margin: float | None = None) -> Judge:
        """The judge of hypotheses against a posed body, which looks `margin` m about it.

        Without a margin it looks where the frame's views are.
        """
        ...

    def align(self, pose: Pose, crop: bool = False) -> Fit:
        """The fit that starts from a pose; with `crop` the images are cropped anew about it."""
        ...

    def measured(self, pose: Pose) -> Fit:
        """What the images say of a pose as it is."""
        ...

    def covariance(self, fit: Fit) -> Float:
        """(6 + J, 6 + J) what is claimed of a fit."""
        ...

    def in_sight(self, fit: Fit) -> Float:
        """(S,) in [0, 1] how far each part is in sight."""
        ...


@dataclass(frozen=True)
class Revision:
    """A fit that takes another one's place.

    Attributes:
        fit: the new one.
        last: the moment before, as it is to be remembered: the way to the new pose was no motion.
        jumped: whether the whole body was elsewhere, so that this frame says nothing of how bodies move.
    """

    fit: Fit
    last: Moment
    jumped: bool = False


class Search(Protocol):
    """A search; it holds settings only, its memory is a value as a cue's."""

    @property
    def name(self) -> str:
        """Its name in the state."""
        ...

    def start(self, body: Body, rig: Rig) -> Any:
        """The memory before the first frame."""
        ...

    def wanted_margin(self, past: Past, time: float) -> float | None:
        """m about the expected body within which it wants to look before the fit; None where it does not."""
        ...

    def begin(self, memory: Any, problem: Problem) -> Pose | None:
        """Where the fit should start instead; None for where it is expected."""
        ...

    def revise(self, memory: Any, problem: Problem, fit: Fit) -> tuple[Revision | None, Any]:
        """A better fit elsewhere, if there is one, and the memory after this frame."""
        ...
