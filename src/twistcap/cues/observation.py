"""The values that cues, priors and searches exchange within one frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twistcap.arrays import Bool, Float, Int
from twistcap.body import Pose, Posed
from twistcap.cues.view import View
from twistcap.estimate import Frame
from twistcap.render import ContourPoints, RenderedView, SurfacePoints
from twistcap.solve import Status
from twistcap.terms import MaskableTerm, Quadratic, Rows, Term


@dataclass(frozen=True)
class Level:
    """How coarsely the images are looked at in one alternation.

    Attributes:
        reach: factor ≥ 1 on the distance from which a cue may pull.
        fine: whether this is the fine level, where cues look at the images as sharply as they can.
    """

    reach: float = 1.0
    fine: bool = True


@dataclass(frozen=True)
class Sight:
    """One camera's image, and the body rendered into it.

    Attributes:
        camera_index: in the rig.
        view: the image, cropped about the body.
        seen: the body as rendered last; it may have moved a little since.
        contour: its visible contour, which has moved with the body.
        scratch: what a cue wants to keep until the body is rendered anew, by name.
    """

    camera_index: int
    view: View
    seen: RenderedView
    contour: ContourPoints
    scratch: dict[str, Any] = field(default_factory=dict[str, Any], repr=False)


@dataclass(frozen=True)
class Agreement:
    """How well the image agrees with the body, for each of its S parts.

    Attributes:
        points: (S,) samples of each part.
        telling: (S,) those at which the image tells body from background.
        agreeing: (S,) those that tell, and put the body where it is.
    """

    points: Int
    telling: Float
    agreeing: Float


@dataclass(frozen=True)
class Evidence:
    """What a cue has measured in one view.

    Attributes:
        term: the energy, with rows on the pose.
        samples: how many samples of the image it is made of.
        agreement: by part; None for a cue that cannot judge the pose.
    """

    term: MaskableTerm
    samples: int = 0
    agreement: Agreement | None = None

    def masked(self, by_part: Float) -> Evidence:
        """The same with the information about each part times a factor (S,) in [0, 1]."""
        return replace(self, term=self.term.masked(by_part))


Measured = Mapping[str, Evidence]
"""Evidence of one view by the name of the cue."""


@dataclass(frozen=True)
class Visibility:
    """Which parts the images show.

    Attributes:
        occluded: (S,) parts that no view shows.
        reappeared: (S,) parts that were occluded before this frame and are seen again.
    """

    occluded: Bool
    reappeared: Bool


@dataclass(frozen=True)
class Alternation:
    """What the priors may know before a solver step.

    Attributes:
        posed: the body where the step starts.
        expected: the predicted pose.
        information: (6 + J, 6 + J) of the prediction.
        frame: the frame.
        samples: of the image that the cues' terms are made of, all together.
        known: (J,) in [0, 1] how far the images show each joint.
        concealed: in [0, 1] how much of its contour the part that is shown least is lacking.
    """

    posed: Posed
    expected: Pose
    information: Float
    frame: Frame
    samples: int
    known: Float
    concealed: float


@dataclass(frozen=True)
class Fit:
    """The pose reached in a frame, and what it was made from.

    Attributes:
        posed: the body at the pose.
        status, steps, energies: of the solver; energies by name of term.
        quadratic: of all terms, about `before`.
        before: the body where the last step was taken from.
        standing: (6 + J, 6 + J) information that was known without this frame's images, or 0.
        fresh: terms of the priors that bring news of this frame, as keypoints.
        sights, measured: of each view.
        entered: evidence of surface points as it entered the fit, masked, with the rows of the last step.
        visibility: of the parts.
        moved: m by which the last step moved the contour.
        drift: m by which it has moved since the body was rendered.
    """

    posed: Posed
    status: Status
    steps: int
    energies: Mapping[str, float]
    quadratic: Quadratic
    before: Posed
    visibility: Visibility
    standing: Float | float = 0.0
    fresh: Sequence[Term] = ()
    sights: Sequence[Sight] = ()
    measured: Sequence[Measured] = ()
    entered: Sequence[tuple[Evidence, SurfacePoints, Rows]] = ()
    moved: float = 0.0
    drift: float = 0.0

    @staticmethod
    def started(posed: Posed, visibility: Visibility) -> Fit:
        """Nothing measured yet."""
        return Fit(posed, "max_iterations", 0, {}, Quadratic.zero(posed.body.dof), posed, visibility)

    @property
    def pose(self) -> Pose:
        """The pose reached."""
        return self.posed.pose

    @property
    def shown(self) -> Bool:
        """(S,) parts of which some view shows something."""
        S = len(self.posed.body.segment_names)
        each = [np.bincount(s.seen.part.ravel() + 1, minlength=S + 1)[1:] > 0 for s in self.sights]
        return np.asarray(np.any(each, axis=0) if each else np.zeros(S), np.bool_)

    @property
    def news(self) -> Float:
        """(6 + J, 6 + J) information of this frame.

        What stands in every frame is no news of this one: taken in anew in every frame it would add up.
        """
        return self.quadratic.hessian - self.standing

    def of(self, cue: str) -> Iterator[tuple[Sight, Evidence]]:
        """Each view and what a cue measured there."""
        return ((s, m[cue]) for s, m in zip(self.sights, self.measured, strict=True) if cue in m)

    @property
    def agreement(self) -> Agreement:
        """Of all views and cues together."""
        return total_agreement(self.measured, len(self.posed.body.segment_names))


def total_agreement(measured: Sequence[Measured], parts: int) -> Agreement:
    """The agreement of S parts in all views and cues together."""
    points, telling, agreeing = np.zeros(parts, np.int32), np.zeros(parts), np.zeros(parts)
    for by_cue in measured:
        for evidence in by_cue.values():
            if evidence.agreement is not None:
                points = points + evidence.agreement.points
                telling = telling + evidence.agreement.telling
                agreeing = agreeing + evidence.agreement.agreeing
    return Agreement(points, telling, agreeing)


def contour_moved(sights: Sequence[Sight], posed: Posed) -> float:
    """How far the contour has moved on the body since it was measured, m: of all but the farthest fiftieth."""
    if not sights:
        return 0.0
    steps = np.concatenate([s.contour.moved_by(posed, s.view.camera.P) / s.seen.px_per_m for s in sights])
    k = int(0.98 * len(steps))
    return float(np.partition(steps, k)[k]) if len(steps) else 0.0
