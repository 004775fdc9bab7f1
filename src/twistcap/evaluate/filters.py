"""Filters of joint angles: a Butterworth filter by the spectrum of each angle, or the smoother of ``twistcap refine``.

Both let pass what is stronger than the noise that the covariance claims. A random error of standard deviation σ at
a rate f has the (one-sided) spectral density 2 σ²/f at all frequencies. An angle's own density falls with frequency,
and where it meets that level there is as much noise as motion: this is the cutoff.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from twistcap.adjust.sequence import accelerations
from twistcap.arrays import Bool, Float, even_clock, runs
from twistcap.body import Body, Pose
from twistcap.errors import InputError, check_choice
from twistcap.evaluate.smoothing import butterworth
from twistcap.io.coordinates import Angles, Coordinates, coordinates_of
from twistcap.predict import MotionNoise
from twistcap.predict.history import covariance_about
from twistcap.solve import Arrow, minimise

Kind = Literal["butterworth", "smoother"]
KINDS: tuple[Kind, ...] = ("butterworth", "smoother")
BOUNDS = (3.0, 12.0)
"""Hz, of a cutoff that is chosen: movement has no less, and joint angles hardly more (Winter 2009, ch. 3)."""
FIXED = 1e-6
"""Degrees or m of σ, below which a coordinate has none: the body's joints fix it."""
_MOST = 0.45  # of the rate; half of it is the last that `butterworth` takes
_SEGMENT = 1.0  # s of the pieces whose spectra are averaged: steps of a walk fall together, so that there are no gaps
_LEAST = 12  # frames that have a spectrum
_HALF_POWER = (np.sqrt(2.0) - 1.0) ** 0.25  # of the frequency at which 1 / (1 + x⁴) is a half
_SMALL = 1e-4  # factor on accelerations, so that none is taken for an angle at its gimbal lock
_STEPS = 4  # of the smoother; it is linear but for the turns of the root


@dataclass(frozen=True)
class Filter:
    """Which filter, and its cutoff in Hz; None chooses one for each angle. The smoother has no other."""

    kind: Kind = "butterworth"
    cutoff: float | None = None

    def __post_init__(self) -> None:
        check_choice("filter", self.kind, KINDS)
        if self.cutoff is not None and self.kind == "smoother":
            raise InputError("filter: the smoother takes no cutoff, the covariance gives it; leave the cutoff away.")


@dataclass(frozen=True)
class Filtered:
    """Coordinates, their filtered `values` and `sigmas` (N, C) in degrees and m, NaN where they are not known, and the
    `cutoffs` (C,) in Hz (−3 dB), NaN where nothing was filtered, or the body's joints leave nothing to filter."""

    table: Coordinates
    values: Float
    sigmas: Float
    cutoffs: Float


@dataclass(frozen=True)
class Motion:
    """N poses of a body at even `times` (s), with covariances (N, 6 + J, 6 + J) of their steps; `known` (N,) ones."""

    body: Body
    times: Float
    poses: Sequence[Pose]
    covariances: Float
    known: Bool


def filtered(motion: Motion, how: Filter, angles: Angles = "opensim") -> Filtered:
    """The coordinates of a motion, filtered. Raises InputError for a cutoff too high or poses of no covariance."""
    table = coordinates_of(motion.body, motion.poses, motion.covariances, angles, known=motion.known)
    values, sigmas = table.in_degrees
    if how.kind == "smoother":
        smooth = coordinates_of(motion.body, smoothed(motion), None, angles).in_degrees[0]
        smooth[~motion.known] = np.nan
        return Filtered(table, smooth, sigmas, _of_free(_smoother_cutoffs(motion, table, angles), sigmas))
    rate = even_clock(motion.times)[0]
    cutoffs = np.full(values.shape[1], how.cutoff or 0.0)
    if how.cutoff is None:
        cutoffs = np.array([noise_cutoff(v, s, rate, motion.known) for v, s in zip(values.T, sigmas.T, strict=True)])
    columns = [butterworth(v, rate, float(c), motion.known) for v, c in zip(values.T, cutoffs, strict=True)]
    out = np.column_stack(columns)
    if how.cutoff is None:
        cutoffs[~np.isfinite(out).any(axis=0)] = np.nan  # nothing was filtered, and no spectrum seen
    return Filtered(table, out, sigmas, _of_free(cutoffs, sigmas))


def _of_free(cutoffs: Float, sigmas: Float) -> Float:
    """The cutoffs (C,), NaN where none of the `sigmas` (N, C) is more than that of a fixed coordinate."""
    return np.where(np.any(sigmas >= FIXED, axis=0), cutoffs, np.nan)


def noise_cutoff(values: Float, sigmas: Float, rate: float, known: Bool) -> float:
    """Hz at which the spectrum of values (N,) meets the level of their errors, of standard deviations `sigmas` (N,).

    The spectrum is Welch's (DOI 10.1109/TAU.1967.1161901) of the longest run of known frames; it holds motion and
    noise, so that both are equal where it is twice the noise. The answer is within `BOUNDS`. Raises InputError where
    the sigma of a known frame is not finite.
    """
    from scipy.signal import welch  # slow to import

    least, most = BOUNDS[0], max(min(BOUNDS[1], _MOST * rate), BOUNDS[0])
    if not np.isfinite(sigmas[known]).all():
        raise InputError("filter: a covariance of the result is not finite; give the cutoff yourself.")
    first, end = max(runs(known), key=lambda run: run[1] - run[0], default=(0, 0))
    if end - first < _LEAST:
        return least
    length = min(end - first, max(_LEAST, round(_SEGMENT * rate)))
    hertz, density = welch(values[first:end], rate, nperseg=length, detrend="linear")
    level = 2.0 * 2.0 * float(np.mean(sigmas[first:end] ** 2)) / rate
    if level <= 0.0:
        return most
    ratio = np.log(np.maximum(density[1:], 1e-12 * level) / level)
    beyond = np.flatnonzero(ratio < 0.0)
    if not len(beyond):
        return most
    k = int(beyond[0])
    share = ratio[k - 1] / (ratio[k - 1] - ratio[k]) if k else 1.0
    at = hertz[1 + k] if k == 0 else hertz[k] + share * (hertz[k + 1] - hertz[k])
    return float(np.clip(at, least, most))


def smoothed(motion: Motion) -> list[Pose]:
    """The poses that fit both those given, by their covariance, and the accelerations that ``refine`` expects.

    Each run of known frames by itself; others stay as they are. For one coordinate it passes 1 / (1 + (ω / ω₀)⁴) at
    ω = 2π f, with ω₀² the standard deviation of acceleration over that of the coordinate: a Butterworth filter there
    and back. Raises InputError for a covariance that is singular.
    """
    out = list(motion.poses)
    for first, end in runs(motion.known):
        if end - first >= 3:
            track = _Smoothing(motion, range(first, end))
            out[first:end] = minimise(track, tuple(out[first:end]), _STEPS).x
    return out


def in_words(how: Filter, cutoffs: Mapping[str, float]) -> str:
    """A sentence for the filter and the cutoffs of the angles, where there are any."""
    name = "the smoother of refine" if how.kind == "smoother" else "a zero-lag Butterworth filter of fourth order"
    some = [cutoff for cutoff in cutoffs.values() if np.isfinite(cutoff)]
    if not some:
        return f"Angles pass {name}."
    low, high = min(some), max(some)
    span = f"{low:.1f} Hz" if high - low < 0.05 else f"{low:.1f} to {high:.1f} Hz"
    if how.kind == "smoother":
        return f"Angles pass {name}; by the covariance its cutoffs are {span}."
    why = "" if how.cutoff is not None else ", where the spectrum of each angle meets the noise of its covariance"
    return f"Angles pass {name}, cutoff {span}{why}."


def _smoother_cutoffs(motion: Motion, table: Coordinates, angles: Angles) -> Float:
    """(C,) Hz at which the power passed is a half, in the mean frame: see `smoothed`."""
    variance = _SMALL**2 * MotionNoise().variance(motion.body.dof, 1.0, "constant_velocity")
    spread = np.array([covariance_about(variance, pose.root[:3, 3])[0] for pose in motion.poses])
    free = coordinates_of(motion.body, motion.poses, spread, angles)
    ratio = np.sqrt(free.sigmas[motion.known] / _SMALL / np.maximum(table.sigmas[motion.known], 1e-12))
    if not len(ratio):
        return np.full(len(table.names), np.nan)
    middle: Float = np.median(ratio, axis=0)
    return middle * float(_HALF_POWER / (2.0 * np.pi))


@dataclass(frozen=True)
class _Smoothing:
    """Poses of some frames as a problem for `minimise`: those given are the evidence."""

    motion: Motion
    frames: range

    @cached_property
    def information(self) -> Float:
        """(F, 6 + J, 6 + J) of the evidence."""
        try:
            return np.asarray(np.linalg.inv(self.motion.covariances[self.frames.start : self.frames.stop]), np.float64)
        except np.linalg.LinAlgError as error:
            raise InputError("filter: a covariance of the result is singular; use the Butterworth filter.") from error

    def energies(self, x: tuple[Pose, ...]) -> dict[str, float]:
        """Of the evidence and of the accelerations."""
        steps = self._steps(x)
        evidence = 0.5 * float(np.einsum("ti,tij,tj->", steps, self.information, steps))
        return {"evidence": evidence, "motion": accelerations(x, self._times)}

    def linearised(self, x: tuple[Pose, ...]) -> Arrow:
        """Their quadratic; the step from a pose given to one near it moves as the pose does."""
        arrow, steps = Arrow(len(x), self.motion.body.dof, 1, 2), self._steps(x)
        arrow.corner[:] = 1.0  # a number that nothing depends on: older releases of scipy factor no empty matrix
        for t, (step, information) in enumerate(zip(steps, self.information, strict=True)):
            arrow.value += 0.5 * float(step @ information @ step)
            arrow.add_pose(t, information @ step, information)
        arrow.value += accelerations(x, self._times, system=arrow)
        return arrow

    def retract(self, x: tuple[Pose, ...], step: Float) -> tuple[Pose, ...]:
        """The poses after a step (F (6 + J) + 1,)."""
        return tuple(pose.retract(own) for pose, own in zip(x, step[:-1].reshape(len(x), -1), strict=True))

    @cached_property
    def _times(self) -> list[float]:
        return self.motion.times[self.frames.start : self.frames.stop].tolist()

    def _steps(self, x: tuple[Pose, ...]) -> Float:
        given = self.motion.poses[self.frames.start : self.frames.stop]
        return np.array([pose.minus(before) for pose, before in zip(x, given, strict=True)])
