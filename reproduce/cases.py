"""The accuracy tables as data: what is filmed, how it is tracked, what is to be reached."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from twistcap.studio import StudioConfig
from twistcap.track import Settings

Condition = Literal["exact", "mismatch"]
Method = Literal["direct", "levelset"]
Measure = Literal["KHE", "joints", "joints at the start", "KHE within 2σ", "lost sequences", "time per frame"]
Training = Literal["another's walk", "squats"]
Start = Literal["given", "keypoints", "keypoints, lengths unknown"]

# How the lines are tracked.
DEFAULT, LEVELSET = Settings(), Settings(method="levelset")
CONSTANT_VELOCITY, BRIGHTNESS = Settings(predictor="constant_velocity"), Settings(brightness=True)
FIRST_POSE = Settings(first_sigma_deg=10.0, first_sigma_m=0.03)

UNITS: dict[Measure, str] = {
    "KHE": "deg",
    "joints": "mm",
    "joints at the start": "mm",
    "KHE within 2σ": "share",
    "lost sequences": "sequences",
    "time per frame": "ms",
}


@dataclass(frozen=True)
class Bar:
    """One measure of a case.

    Attributes:
        measure: what is measured in each sequence.
        at_most: what is to be reached; None where there is no bar.
        over: how sequences come together: their mean, the worst of them, or their sum.
    """

    measure: Measure
    at_most: float | None = None
    over: Literal["mean", "worst", "sum"] = "mean"


@dataclass(frozen=True)
class Case:
    """One way of tracking one kind of scene, on every seed.

    Attributes:
        id: its name on the command line and in the table.
        says: one line for the reader.
        studio: the scene; its seed is replaced.
        tracker: settings.
        bars: what is measured and what is to be reached.
        every: only every so many frames are given to the tracker.
        frames: only so many of the scene's frames are used; all by default.
        start: the first pose: the scene's own, or fitted to noisy keypoints, the body's lengths being known or not.
        keypoint_noise_px: standard deviation of each keypoint coordinate, which the fit knows.
        prior: what the pose prior has learnt from, of the next seed's person; None without a prior.
    """

    id: str
    says: str
    studio: StudioConfig
    tracker: Settings
    bars: tuple[Bar, ...]
    every: int = 1
    frames: int | None = None
    start: Start = "given"
    keypoint_noise_px: float = 3.0
    prior: Training | None = None


@dataclass(frozen=True)
class Agreement:
    """Two cases on the same scenes that are to come out alike.

    Attributes:
        id, says: as of a case.
        first, second: ids of the cases.
        at_most: largest mean over the seeds of the difference of their KHE, degrees.
    """

    id: str
    says: str
    first: str
    second: str
    at_most: float


@dataclass(frozen=True)
class Suite:
    """A table: cases, and what is compared between them."""

    id: str
    says: str
    cases: tuple[Case, ...]
    agreements: tuple[Agreement, ...] = field(default=())


def followed(khe_deg: float | None, joints_mm: float | None = None) -> tuple[Bar, ...]:
    """What is asked of a tracked sequence: angles, joints, none lost; coverage and time are measured beside."""
    return (
        Bar("KHE", khe_deg),
        Bar("joints", joints_mm),
        Bar("lost sequences", 0.0, "sum"),
        Bar("KHE within 2σ"),
        Bar("time per frame"),
    )


def _four_views(condition: Condition, method: Method, bars: tuple[Bar, ...]) -> Case:
    says = f"a walk in 4 views at 60 fps, {condition} body and cameras, {method} method"
    scene, tracker = StudioConfig(views=4, condition=condition), LEVELSET if method == "levelset" else DEFAULT
    return Case(f"4-views-{condition}-{method}", says, scene, tracker, bars)


def _agreement(condition: Condition) -> Agreement:
    names = (f"4-views-{condition}-direct", f"4-views-{condition}-levelset")
    return Agreement(f"direct-levelset-{condition}", f"both methods agree, 4 views, {condition}", *names, 0.3)


_FIRST = (Bar("joints at the start", over="worst"), Bar("joints", 15.0, "worst"))

STUDIO = Suite(
    "studio",
    "what is claimed of the tracker: 4 views, stereo, 30 fps, first pose",
    (
        _four_views("exact", "direct", followed(0.7, 3.0)),
        _four_views("exact", "levelset", followed(0.7, 3.0)),
        _four_views("mismatch", "direct", followed(1.2, 8.0)),
        _four_views("mismatch", "levelset", followed(1.2, 8.0)),
        Case(
            "4-views-mismatch-30fps",
            "every second frame only, constant velocity, mismatch body and cameras",
            StudioConfig(views=4, condition="mismatch"),
            CONSTANT_VELOCITY,
            followed(1.2),
            every=2,
        ),
        Case(
            "stereo-exact",
            "two views, exact body and cameras, contours and brightness constancy",
            StudioConfig(views=2),
            BRIGHTNESS,
            followed(1.2, 6.0),
        ),
        Case(
            "first-pose",
            "first pose from keypoints with 3 px of noise in 4 views, then refined by the tracker; body known",
            StudioConfig(views=4),
            FIRST_POSE,
            _FIRST,
            frames=1,
            start="keypoints",
        ),
        Case(
            "first-pose-lengths",
            "the same, stature and lengths unknown and fitted to the same keypoints",
            StudioConfig(views=4),
            FIRST_POSE,
            _FIRST,
            frames=1,
            start="keypoints, lengths unknown",
        ),
    ),
    (_agreement("exact"), _agreement("mismatch")),
)

_STEREO = Case(
    "stereo-mismatch-prior",
    "two views, mismatch body and cameras, prior trained on another subject's gait",
    StudioConfig(views=2, condition="mismatch"),
    DEFAULT,
    followed(1.2, 10.0),
    prior="another's walk",
)
_UNFITTING = Case(
    "4-views-exact-squats",
    "4 views, exact, prior trained on knee bends, which the walk is unlike: it must do no harm",
    StudioConfig(views=4),
    DEFAULT,
    followed(0.7, 3.0),
    prior="squats",
)
PRIOR = Suite("prior", "tracking with a pose prior of another person", (_STEREO, _UNFITTING))

_HARDER = (
    ("twice-as-fast", "a walk at twice its speed", StudioConfig(views=4, speed_factor=2.0), 1, followed(None, 8.0)),
    ("one-colour", "the whole body in one colour without texture", StudioConfig(views=4, one_colour=True), 1,
     followed(None, 8.0)),
    ("15fps", "every fourth frame only", StudioConfig(views=4, frames=120), 4, followed(1.2)),
)  # fmt: skip
HARDER = Suite(
    "harder",
    "faster, in one colour, at 15 frames per second",
    tuple(
        Case(f"4-views-{name}", f"{says}, 4 views, exact body and cameras", scene, DEFAULT, bars, every)
        for name, says, scene, every, bars in _HARDER
    ),
)

SUITES = (STUDIO, PRIOR, HARDER)
