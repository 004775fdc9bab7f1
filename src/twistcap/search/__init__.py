"""Looking for the body elsewhere: what a search is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self, TypeVar

from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.observation import Fit, Sight
from twistcap.cues.view import View
from twistcap.estimate import Frame, Sources
from twistcap.features import Channels
from twistcap.predict.history import Moment, Past

__all__ = ["Beginning", "Problem", "Proposals", "Revision", "Search", "with_cameras"]

Views = Mapping[int, View]
"""Views by camera."""


class Problem(Protocol):
    """One frame, as a search sees it; nothing that it does changes the tracker's state."""

    @property
    def body(self) -> Body: ...
    @property
    def rig(self) -> Rig: ...
    @property
    def left_out(self) -> frozenset[int]:
        """Cameras that are not believed."""
        ...

    @property
    def bumps(self) -> Float:
        """(C, 3) turns of the cameras, for which their pictures are turned back."""
        ...

    @property
    def channels(self) -> Channels: ...
    @property
    def past(self) -> Past: ...
    @property
    def frame(self) -> Frame: ...
    @property
    def start(self) -> Pose:
        """Where the body is expected."""
        ...

    @property
    def views(self) -> Views: ...
    @property
    def trusted(self) -> bool:
        """Whether the images are believed entirely; in noise a limb may seem to be anywhere."""
        ...

    def align(self, pose: Pose) -> Fit:
        """The fit that starts from a pose, in images about it."""
        ...

    def afresh(self, pose: Pose, margin: float) -> Fit:
        """The fit that starts from a pose as if no frame had been seen before, in images `margin` m about it."""
        ...

    def without_look(self) -> Problem:
        """The same without what cues have learnt of the body's look."""
        ...

    def excluding(self, left_out: frozenset[int]) -> Problem:
        """The same with just these cameras left out; views that it does not have do not come back."""
        ...

    def sorted_by(self, sources: Sources) -> Problem:
        """The same with each camera's picture from where it is, and all views of those that were elsewhere."""
        ...

    def turned_back(self, bumps: Mapping[int, Float]) -> Problem:
        """The same with the pictures of some cameras as they were before turns (3,) of them, and all views of them."""
        ...

    def look(self, camera_index: int, posed: Posed) -> Sight | None:
        """A camera's sight of a posed body, left out or not; None where the body or the image is not there."""
        ...

    def colours(self, camera_index: int, channels: int) -> Float:
        """(S, 1 + 2C) confidence, mean and mean square of each part's colours in a camera."""
        ...

    def support(self, fit: Fit) -> Float:
        """(S,) running fraction of each part's contour points that agree, after a fit."""
        ...

    def in_sight(self, fit: Fit) -> Float:
        """(S,) in [0, 1] how far each part is in sight."""
        ...


Proposals = Callable[[Problem], Sequence[Pose]]
"""Poses that a frame may show, beside those that a search knows itself; asked only while it searches."""


@dataclass(frozen=True)
class Beginning:
    """Where the fit is to start.

    Attributes:
        pose: of the body; None where the images show it nowhere.
        bumps, sources: as in `Revision`.
    """

    pose: Pose | None
    bumps: Mapping[int, Float] = field(default_factory=dict[int, Float])
    sources: Sources = ()


@dataclass(frozen=True)
class Revision:
    """A fit that takes another one's place.

    Attributes:
        fit: the new one; None where the body is nowhere in the images.
        last: the moment before, as it is to be remembered: the way to the new pose was no motion.
        jumped: whether the whole body was elsewhere, so that this frame says nothing of how bodies move.
        left_out: cameras that are not believed from now on; None for no change.
        relit: whether all pictures have changed, so that what cues have learnt of the body's look holds no longer.
        bumps: turns (3,) of cameras, as they were when the frame came, for which their pictures are to be turned back
            from now on.
        sources: where each camera's picture is in the problem's frame, from now on; () where nothing has changed.
    """

    fit: Fit | None
    last: Moment
    jumped: bool = False
    left_out: frozenset[int] | None = None
    relit: bool = False
    bumps: Mapping[int, Float] = field(default_factory=dict[int, Float])
    sources: Sources = ()


class _Sorted(Protocol):
    def sorted_by(self, sources: Sources) -> Self: ...
    def turned_back(self, bumps: Mapping[int, Float]) -> Self: ...


P = TypeVar("P", bound=_Sorted)


def with_cameras(problem: P, found: Beginning | Revision) -> P:
    """The problem with its cameras as a search has found them: where their pictures are, and how they are turned."""
    problem = problem.sorted_by(found.sources) if found.sources else problem
    return problem.turned_back(found.bumps) if found.bumps else problem


class Search(Protocol):
    """A search; it holds settings only, its memory is a value as a cue's."""

    @property
    def name(self) -> str:
        """Its name in the state."""
        ...

    def start(self, body: Body, rig: Rig) -> Any:
        """The memory before the first frame."""
        ...

    def begin(self, memory: Any, problem: Problem) -> tuple[Beginning | None, Any]:
        """Where the fit should start instead, None for where it is expected; and the memory after that."""
        ...

    def revise(self, memory: Any, problem: Problem, fit: Fit) -> tuple[Revision | None, Any]:
        """A better fit elsewhere, if there is one, and the memory after this frame."""
        ...
