"""Gait: heel strikes and toe-offs, strides, cycles of 0 to 100 %, and what time and length say of a walk.

Events begin with Zeni et al. 2008 (DOI 10.1016/j.gaitpost.2007.07.007): near heel strike the heel is farthest in front
of the pelvis, near toe-off the toes are farthest behind it. From there the event is moved to where the foot has half
the speed, against the pelvis, that it has on the floor: 9 ms or less from force plates where Zeni's own is 27 (one
walk). "In front" is along the pelvis's own heading, slowly followed, so that a walk may turn and a treadmill will do.
On the floor it is turned by a constant to where the walk goes on average: a tracked pelvis may be turned a little.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap import se3
from twistcap.arrays import UNEVEN, Bool, Float, even_clock
from twistcap.body import Body, Pose, Posed
from twistcap.errors import InputError, check
from twistcap.evaluate.smoothing import butterworth
from twistcap.io.norms import PERCENT

SIDES = ("r", "l")
_MARKS = ("heel", "toe")
_EVENT_HZ = 6.0  # cutoff of the points; Zeni et al. use it
_HEADING_HZ = 0.4  # well below that of strides, in which the pelvis turns to and fro
_SWING = 0.3  # least prominence of a peak, of the whole swing of the foot
_SLOWING_S = 0.3  # longest time between Zeni's event and ours
_STRIDE_S = (0.4, 4.0)  # shortest and longest stride
_WALKING = 0.2  # m/s on average, from which on the way says where a walk goes
_ADVANCING = 0.2  # m from strike to strike, from which on that line is the stride's direction


@dataclass(frozen=True)
class Stride:
    """From one heel strike of a foot to the next: times in s, places (3,) in m, of the world."""

    side: str
    start: float
    end: float
    toe_off: float  # of this foot
    opposite_strike: float  # of the other foot, NaN where there is none
    opposite_toe_off: float
    length: float  # m, from heel to heel; on a treadmill it is near 0
    length_sigma: float
    step_length: float  # m, from the other foot's heel to this one's at the end; NaN without its strike
    step_width: float  # m, from the line between two strikes of this heel to the other heel
    step_width_sigma: float


@dataclass(frozen=True)
class Measure:
    """A mean over strides, their standard deviation, and the standard error of the mean by the tracker's covariance."""

    mean: float
    deviation: float
    sigma: float
    count: int


@dataclass(frozen=True)
class Gait:
    """Events (s) by side, and strides."""

    strikes: Mapping[str, Float]
    toe_offs: Mapping[str, Float]
    strides: tuple[Stride, ...]
    frame: float  # s, one step of the clock
    heading: Float  # (N,) rad from the world's x towards y; between known frames where it is not known

    def of(self, side: str) -> tuple[Stride, ...]:
        return tuple(stride for stride in self.strides if stride.side == side)


def gait_of(
    body: Body, times: Float, poses: Sequence[Pose], covariances: Float | None = None, known: Bool | None = None
) -> Gait:
    """Events and strides of N poses at even `times` (N,) s.

    Frames that are not `known` (N,) belong to no stride. Lengths have standard deviations where `covariances`
    (N, 6 + J, 6 + J) of the pose step are given. Raises InputError for a body without heels and toes, fewer than 12
    frames, or times that are not even.
    """
    wanted = [f"{mark}_{side}" for mark in _MARKS for side in SIDES]
    missing = [name for name in wanted if name not in body.landmarks.names]
    if missing:
        raise InputError(f"gait: body {body.name!r} has no landmark {missing[0]!r}; gait needs heels and toes.")
    rate = frame_rate(times)
    known = np.ones(len(times), np.bool_) if known is None else known
    feet = {name: butterworth(places(body, poses, name), rate, _EVENT_HZ, known) for name in wanted}
    middle = butterworth(places(body, poses, "mid_hip"), rate, _EVENT_HZ, known)
    forward = _heading(poses, middle, rate, known)
    ahead = {name: np.sum((place - middle) * forward, axis=1) for name, place in feet.items()}
    strikes = {side: _events(times, ahead[f"heel_{side}"], 1) for side in SIDES}
    toe_offs = {side: _events(times, ahead[f"toe_{side}"], -1) for side in SIDES}
    heels = {side: feet[f"heel_{side}"] for side in SIDES}
    walk = _Walk(times, known, forward, heels, _heel_variance(body, poses, covariances))
    strides = [s for side in SIDES for s in _strides(walk, side, strikes, toe_offs)]
    return Gait(strikes, toe_offs, tuple(sorted(strides, key=lambda s: s.start)), 1.0 / rate, _level_angle(forward))


def facing(gait: Gait, poses: Sequence[Pose]) -> list[Pose]:
    """The poses as if the walk went along the world's x: OpenSim's tilt and list of the pelvis mean it so."""
    turns = se3.transform(_to_x(gait), np.zeros(3))
    return [Pose(turn @ pose.root, pose.q) for turn, pose in zip(turns, poses, strict=True)]


def facing_covariances(gait: Gait, covariances: Float) -> Float:
    """The covariances (N, 6 + J, 6 + J) of the pose step of `facing` poses, of those of the poses themselves."""
    turns, out = _to_x(gait), covariances.copy()
    for part in (slice(0, 3), slice(3, 6)):
        out[:, part] = turns @ out[:, part]
        out[:, :, part] = out[:, :, part] @ turns.swapaxes(1, 2)
    return out


def _to_x(gait: Gait) -> Float:
    """(N, 3, 3) rotations about the vertical that bring the walk to the world's x."""
    return se3.exp_rotation(-gait.heading[:, None] * [0.0, 0.0, 1.0])


def cycles(gait: Gait, times: Float, values: Float, side: str) -> Float:
    """Values (N, C) at `times` (N,) over each stride of a side: (strides, 101, C), at 0, 1 … 100 % of the cycle."""
    return normalised([(stride.start, stride.end) for stride in gait.of(side)], times, values)


def normalised(spans: Sequence[tuple[float, float]], times: Float, values: Float) -> Float:
    """Values (N, C) at `times` (N,) over spans of time (s): (spans, 101, C), at 0, 1 … 100 % of each."""
    at = [start + PERCENT / 100 * (end - start) for start, end in spans]
    columns = [[np.interp(t, times, column) for column in values.T] for t in at]
    return np.array(columns).reshape(len(at), values.shape[1], len(PERCENT)).transpose(0, 2, 1)


def parameters(gait: Gait) -> dict[str, dict[str, Measure]]:
    """Spatiotemporal parameters of "r", "l" and "both": times s, lengths m, speed m/s, cadence steps/min, shares %."""
    chosen = {"r": gait.of("r"), "l": gait.of("l"), "both": gait.strides}
    return {side: {name: _measured(gait, strides, name) for name in _PARAMETERS} for side, strides in chosen.items()}


def symmetry(measures: Mapping[str, Mapping[str, Measure]]) -> dict[str, float]:
    """Symmetry index of each parameter, %: 100 (r − l) / half their sum (Robinson et al. 1987); 0 is symmetric."""
    return {
        name: 200.0 * (measures["r"][name].mean - measures["l"][name].mean) / total
        for name in measures["r"]
        if (total := measures["r"][name].mean + measures["l"][name].mean)
    }


@dataclass(frozen=True)
class _Walk:
    times: Float
    known: Bool
    forward: Float  # (N, 3)
    heels: Mapping[str, Float]
    variance: Callable[[str, int, Float], float]  # m², of a side's heel in a frame along a direction (3,)

    def frame(self, time: float) -> int:
        return int(np.argmin(np.abs(self.times - time)))

    def heel(self, side: str, time: float) -> Float:
        return np.array([np.interp(time, self.times, column) for column in self.heels[side].T])

    def direction(self, way: Float, frame: int) -> Float:
        """(3,) level direction of a stride whose heel has gone a way (3,): along it, if it has advanced."""
        level = way * [1.0, 1.0, 0.0]
        length, ahead = float(np.linalg.norm(level)), self.forward[frame]
        return level / length * np.copysign(1.0, level @ ahead) if length >= _ADVANCING else ahead


def _level_angle(forward: Float) -> Float:
    """(N,) rad, continuous; between known frames where the walk is not known, so that it makes no whole turn there."""
    known = np.flatnonzero(np.isfinite(forward[:, 0]))
    if not len(known):
        return np.zeros(len(forward))
    angles = np.unwrap(np.arctan2(forward[known, 1], forward[known, 0]))
    return np.interp(np.arange(len(forward)), known, angles)


def frame_rate(times: Float) -> float:
    """Frames per second. Raises InputError for few frames, or times that are not even."""
    check("gait", len(times) >= 12, f"there are {len(times)} frames; gait needs a stride, and 12 frames at least")
    rate, ticks, off = even_clock(times)
    if np.any(np.diff(ticks) != 1) or off > UNEVEN:
        raise InputError("gait: the frames are not evenly spaced in time; take a part of the recording where they are.")
    return rate


def places(body: Body, poses: Sequence[Pose], name: str) -> Float:
    """(N, 3) a landmark; the root's origin where the body has none of that name."""
    if name not in body.landmarks.names:
        return np.array([pose.root[:3, 3] for pose in poses])
    k = body.landmarks.index(name)
    return np.array([Posed(body, pose).landmarks[k] for pose in poses])


def _heading(poses: Sequence[Pose], middle: Float, rate: float, known: Bool) -> Float:
    """(N, 3) level unit vectors along the pelvis's x, slowly followed, turned by a constant to the way of the `middle`
    (N, 3) of the hips, if there is one.
    """
    x = butterworth(np.array([pose.root[:3, 0] for pose in poses]) * [1.0, 1.0, 0.0], rate, _HEADING_HZ, known)
    facing = np.exp(1j * np.arctan2(x[:, 1], x[:, 0]))
    speed = rate * np.gradient(middle[:, 0] + 1j * middle[:, 1])
    along = complex(np.nanmean(np.append(speed * facing.conj(), 0.0)))
    if abs(along) >= _WALKING:
        facing *= along / abs(along) * np.copysign(1.0, along.real)  # who walks backward faces the other way
    return np.stack([np.real(facing), np.imag(facing), np.zeros(len(facing))], axis=1)


def _events(times: Float, ahead: Float, direction: int) -> Float:
    """Times at which a foot that is `ahead` (N,) m of the pelvis comes to the floor (direction 1, after each farthest
    place in front) or leaves it (−1, before each farthest place behind)."""
    from scipy.signal import find_peaks  # slow to import

    speed = np.gradient(ahead, times)
    backward = speed[speed < 0]
    if not len(backward):
        return np.zeros(0)
    half = 0.5 * float(np.median(backward))  # most of the time that a foot goes backward it is on the floor
    span = float(np.nanmax(ahead) - np.nanmin(ahead))
    peaks, _ = find_peaks(np.where(np.isfinite(ahead), direction * ahead, -np.inf), prominence=_SWING * span)
    found = [_crossing(times, speed, half, int(k), direction) for k in peaks]
    return np.array([time for time in found if time is not None])


def _crossing(times: Float, speed: Float, level: float, start: int, direction: int) -> float | None:
    """When the speed first falls below a level, from a frame on; None where it is not known or takes too long."""
    k = start
    while 0 <= k + direction < len(times) and abs(times[k] - times[start]) < _SLOWING_S:
        after = k + direction
        if speed[after] < level <= speed[k]:
            share = (speed[k] - level) / (speed[k] - speed[after])
            return float(times[k] + share * (times[after] - times[k]))
        k = after
    return None


def _strides(walk: _Walk, side: str, strikes: Mapping[str, Float], toe_offs: Mapping[str, Float]) -> list[Stride]:
    """Those with one toe-off of their own, of a usual length, and all frames known."""
    other, out = "l" if side == "r" else "r", list[Stride]()
    for start, end in zip(strikes[side], strikes[side][1:], strict=False):
        own = _between(toe_offs[side], start, end)
        first, last = walk.frame(start), walk.frame(end)
        if len(own) != 1 or not _STRIDE_S[0] <= end - start <= _STRIDE_S[1] or not walk.known[first : last + 1].all():
            continue
        opposite, freed = _between(strikes[other], start, end), _between(toe_offs[other], start, end)
        strike = float(opposite[0]) if len(opposite) == 1 else np.nan
        lifted = float(freed[0]) if len(freed) == 1 else np.nan
        out.append(Stride(
            side, float(start), float(end), float(own[0]), strike, lifted, *_lengths(walk, side, start, end, strike)
        ))  # fmt: skip
    return out


def _between(times: Float, start: float, end: float) -> Float:
    return times[(times > start) & (times < end)]


def _lengths(
    walk: _Walk, side: str, start: float, end: float, strike: float
) -> tuple[float, float, float, float, float]:
    """Length of a stride and its σ, length of its step, its width and the σ of that; m."""
    other, first, last = "l" if side == "r" else "r", walk.frame(start), walk.frame(end)
    begun, ended = walk.heel(side, start), walk.heel(side, end)
    ahead = walk.direction(ended - begun, last)
    length, sigma = float((ended - begun) @ ahead), np.sqrt(sum(walk.variance(side, k, ahead) for k in (first, last)))
    if np.isnan(strike):
        return length, float(sigma), np.nan, np.nan, np.nan
    across, there = np.array([-ahead[1], ahead[0], 0.0]), walk.heel(other, strike)
    own = sum(walk.variance(side, k, across) for k in (first, last))
    wide = np.sqrt(walk.variance(other, walk.frame(strike), across) + 0.25 * own)
    width = abs(float((there - 0.5 * (begun + ended)) @ across))
    return length, float(sigma), float((ended - there) @ ahead), width, float(wide)


def _heel_variance(body: Body, poses: Sequence[Pose], covariances: Float | None) -> Callable[[str, int, Float], float]:
    """Variance (m²) of a heel's place along a direction (3,); frames are taken as independent."""
    if covariances is None:
        return lambda side, frame, along: 0.0

    def variance(side: str, frame: int, along: Float) -> float:
        marks, posed = body.landmarks, Posed(body, poses[frame])
        heel = [marks.index(f"heel_{side}")]
        J = along @ posed.point_jacobian(marks.segments[heel, None], np.ones((1, 1)), marks.points[heel])[0]
        return float(J @ covariances[frame] @ J)

    return variance


_PARAMETERS: Mapping[str, Callable[[Stride], float]] = {
    "stride time": lambda s: s.end - s.start,
    "stride length": lambda s: s.length,
    "speed": lambda s: s.length / (s.end - s.start),
    "cadence": lambda s: 120.0 / (s.end - s.start),
    "step length": lambda s: s.step_length,
    "step width": lambda s: s.step_width,
    "step time": lambda s: s.end - s.opposite_strike,
    "stance": lambda s: 100 * (s.toe_off - s.start) / (s.end - s.start),
    "double support": lambda s: (
        100 * (s.opposite_toe_off - s.start + s.toe_off - s.opposite_strike) / (s.end - s.start)
    ),
}
UNITS = {"stride time": "s", "stride length": "m", "speed": "m/s", "cadence": "steps/min", "step length": "m",
         "step width": "m", "step time": "s", "stance": "%", "double support": "%"}  # fmt: skip


def _measured(gait: Gait, strides: Sequence[Stride], name: str) -> Measure:
    """The standard error: the covariance's share in lengths, and a frame's width of every event."""
    values = np.array([_PARAMETERS[name](stride) for stride in strides])
    sigmas = np.array([_sigma(gait, stride, name) for stride in strides])[np.isfinite(values)]
    values = values[np.isfinite(values)]
    if not len(values):
        return Measure(np.nan, np.nan, np.nan, 0)
    deviation = float(values.std(ddof=1)) if len(values) > 1 else np.nan
    return Measure(float(values.mean()), deviation, float(np.sqrt(np.sum(sigmas**2)) / len(values)), len(values))


def _sigma(gait: Gait, stride: Stride, name: str) -> float:
    """Of one stride; an event is known to a frame, evenly spread, so that its σ is that over √12."""
    time = stride.end - stride.start
    instant = gait.frame / np.sqrt(12.0)
    apart = np.sqrt(2.0) * instant
    length = stride.length_sigma
    return {
        "stride time": apart, "step time": apart, "stride length": length, "step length": length,
        "step width": stride.step_width_sigma,
        "speed": float(np.hypot(length, stride.length / time * apart)) / time, "cadence": 120.0 * apart / time**2,
        "stance": 100 * apart / time, "double support": 100 * 2 * instant / time,
    }[name]  # fmt: skip
