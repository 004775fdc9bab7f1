"""The first state of the differential tracker from joints clicked in one or more views, without calibrated cameras.

Rotations, scales and shifts of the views, joint angles and body dimensions are fitted together; left and right have
equal lengths (Bregler and Malik, CVPR 1998, section 2.6, DOI 10.1109/CVPR.1998.698581).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from twistcap import se3
from twistcap.adjust.first_pose.skeleton import Scaling, Skeleton
from twistcap.arrays import Bool, Float, Int
from twistcap.body import Body, Posed, rescaled
from twistcap.body.kinematics import Pose
from twistcap.camera import pinhole
from twistcap.camera.scaled import ROOT, ScaledView
from twistcap.differential.model import state_at, view_block, view_blocks
from twistcap.differential.state import State
from twistcap.errors import InputError, check
from twistcap.render import SurfacePoints
from twistcap.solve import Arrow, BlockProblem, Dense, Solution, Variables, Vector, minimise
from twistcap.terms import BlockGaussian, BlockTerm, Slope, Sums
from twistcap.terms.scaled import ViewGaussian, image_motion

_FEWEST = 4  # clicks in each view, at least
_HEADINGS = 8  # directions of the body that are tried
# Standard deviations of the priors. In scaled orthography no image shows the stature.
_SIGMA_PX = 2.0  # of a click
_STATURE, _LENGTH, _GIRTH = 0.02, 0.08, 0.08  # of the body's log-factors
_ANGLE_DEG = 60.0  # of the joint angles about neutral, so weak that it only decides what no click shows
_LEAN_DEG = 60.0  # of each view's rotation from the start's, for a camera held upright
_STEPS, _DAMPING, _GAIN = 100, 1e-6, 1e-6
_REACH = 0.5  # rad, log-scale, m: no linearisation holds beyond
_UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # z up, x towards the camera


@dataclass(frozen=True)
class ClickedStart:
    """A state fitted to clicks, with the body of the fitted dimensions; `residual_px` (V, L) is the distance of each
    click from its landmark, NaN where there was none.
    """

    body: Body
    state: State
    residual_px: Float


@dataclass(frozen=True)
class Clicks:
    """Landmarks (L,), their clicks in each view (V, L, 2) px, and whether they were clicked (V, L)."""

    marks: Int
    pixels: Float
    known: Bool


def fit_clicks(
    body: Body, clicks: Sequence[Mapping[str, Sequence[float]]], *, facing_deg: Sequence[float] | None = None
) -> ClickedStart:
    """The state and dimensions of a body whose joints were clicked.

    Clicks are (x, y) px of each view by landmark name; a view may lack some. `facing_deg` is the direction that the
    body faces in each: 0 towards the camera, 90 to the image's right; by default several are tried, from upright
    bodies.

    Raises InputError for an unknown name, fewer than four clicks in a view, or numbers that are not finite.
    """
    skeleton, known = Skeleton(body), gathered(body, clicks)
    ends = [_minimised(skeleton, known, start) for start in _starts(body, known, facing_deg)]
    x = min(ends, key=lambda end: end.energy).x
    proportions, state = skeleton.proportions(x["shape"].values), state_at(x)
    fitted = rescaled(body, proportions.lengths, proportions.girths, proportions.stature)
    at = Posed(fitted, Pose(np.eye(4), state.q)).landmarks[known.marks]
    off = np.stack([view.pixels(at) for view in state.views]) - known.pixels
    residual = np.where(known.known, np.linalg.norm(off, axis=-1), np.nan)
    return ClickedStart(fitted, state, residual)


def gathered(body: Body, clicks: Sequence[Mapping[str, Sequence[float]]]) -> Clicks:
    """The clicks as arrays; errors as of `fit_clicks`."""
    names = list(dict.fromkeys(name for view in clicks for name in view))
    for name in names:
        if name not in body.landmarks.names:
            raise InputError(f"clicks: {name!r} is no landmark of the body; it has {', '.join(body.landmarks.names)}.")
    pixels = np.array([[view.get(name, (np.nan, np.nan)) for name in names] for view in clicks], dtype=np.float64)
    given = np.array([[name in view for name in names] for view in clicks], dtype=bool)
    check("clicks", clicks and given.sum(axis=1).min() >= _FEWEST, f"every view needs {_FEWEST} clicked joints or more")
    check("clicks", np.all(np.isfinite(pixels[given])), "a pixel is not a finite number; leave that joint out")
    return Clicks(np.array([body.landmarks.index(name) for name in names], np.int32), np.nan_to_num(pixels), given)


def _starts(body: Body, clicks: Clicks, facing_deg: Sequence[float] | None) -> list[State]:
    """Upright bodies, each view's scale and shift fitted to its clicks."""
    V = len(clicks.pixels)
    if facing_deg is not None and len(facing_deg) != V:
        raise InputError(f"clicks: {len(facing_deg)} directions are given for {V} views; give one for each.")
    turns = 360.0 * np.arange(_HEADINGS) / _HEADINGS
    first = [np.asarray(facing_deg, float)] if facing_deg is not None else [np.full(V, a) for a in turns]
    q = np.clip(np.zeros(len(body.coordinate_names)), *body.limits.T)
    points = Posed(body, Pose(np.eye(4), q)).landmarks[clicks.marks]
    states = [State(tuple(_placed(points, clicks, v, a) for v, a in enumerate(angles)), q) for angles in first]
    if facing_deg is None and V > 1:  # and the best direction of each view alone
        best = (min((s.views[v] for s in states), key=partial(_misfit, points, clicks, v)) for v in range(V))
        states.append(State(tuple(best), q))
    return states


def _placed(points: Float, clicks: Clicks, v: int, facing: float) -> ScaledView:
    """The view of a direction, its scale and shift from the heights and means of body and clicks."""
    turn, known = _UPRIGHT @ se3.exp_rotation(np.array([0.0, 0.0, np.deg2rad(facing)])), clicks.known[v]
    at, there = (points[known] @ turn.T)[:, :2], clicks.pixels[v][known]
    scale = float(np.ptp(there[:, 1]) / max(np.ptp(at[:, 1]), 1e-6))
    return ScaledView(turn, scale, (there - scale * at).mean(axis=0))


def _misfit(points: Float, clicks: Clicks, v: int, view: ScaledView) -> float:
    return float(np.sum((view.pixels(points) - clicks.pixels[v])[clicks.known[v]] ** 2))


def _minimised(skeleton: Skeleton, clicks: Clicks, start: State) -> Solution[Variables, Dense | Arrow]:
    """From one start; the second solve takes the rotations of the first as its start."""
    x = click_variables(skeleton, start)
    x = minimise(click_problem(clicks, x), x, _STEPS, damping=_DAMPING, gain=_GAIN).x
    return minimise(click_problem(clicks, x), x, _STEPS, damping=_DAMPING, gain=_GAIN)


def click_variables(skeleton: Skeleton, start: State) -> Variables:
    """The views, the joints inside their limits, and the body's log-factors."""
    body, views = skeleton.body, view_blocks(start)
    reach = {name: _REACH * np.array([1, view.scale, view.scale, 1, 1, 1]) for name, view in views.items()}
    joints = Vector(np.clip(start.q, *body.limits.T), body.limits)
    shape = Scaling(np.zeros(skeleton.size), skeleton=skeleton)
    return Variables({**views, "joints": joints, "shape": shape}, (*views, "joints", "shape"), reach)


def click_problem(clicks: Clicks, start: Variables) -> BlockProblem:
    """``½ Σ |x − click|² / σ²`` and weak Gaussians on angles, log-factors and the views' rotations from the start's."""
    skeleton: Skeleton = start["shape"].skeleton
    J, lean = len(start["joints"].values), np.array([*[np.inf] * 3, *[np.deg2rad(_LEAN_DEG)] * 3])
    terms: list[BlockTerm] = [
        BlockGaussian("joints", np.zeros(J), np.full(J, np.deg2rad(_ANGLE_DEG)), "neutral"),
        BlockGaussian("shape", np.zeros(skeleton.size), skeleton.sigmas(_STATURE, _LENGTH, _GIRTH)),
    ]
    for v in range(len(clicks.pixels)):
        own = np.flatnonzero(clicks.known[v])
        terms.append(ClickTerm(view_block(v), clicks.marks[own], clicks.pixels[v, own], _SIGMA_PX))
        terms.append(ViewGaussian(view_block(v), start[view_block(v)], lean))
    return BlockProblem(terms)


@dataclass(frozen=True)
class ClickTerm:
    """N clicked landmarks (`marks`) in one view, by its block, and their pixels (N, 2), of standard deviation sigma."""

    view: str
    marks: Int
    pixels: Float
    sigma: float
    name: str = "clicks"

    def energy(self, x: Variables) -> float:
        return 0.5 * float(np.sum(self._residual(x, self._posed(x)) ** 2))

    def add_to(self, sums: Sums, x: Variables) -> None:
        posed, view, marks = self._posed(x), x[self.view], x["shape"].body.landmarks
        residual, ones = self._residual(x, posed).ravel(), np.ones((len(self.marks), 1))
        points = SurfacePoints(marks.segments[self.marks, None], ones, marks.points[self.marks])
        motion = image_motion(posed, view, points).reshape(len(residual), -1) / self.sigma
        slopes = [Slope(self.view, motion[:, :ROOT]), Slope("joints", motion[:, ROOT:])]
        by_point = pinhole(view.P, posed.landmarks[self.marks])[2] / self.sigma
        by_shape = by_point @ x["shape"].rates(posed)[self.marks]
        slopes.append(Slope("shape", by_shape.reshape(len(residual), -1)))
        sums.add_rows(0.5 * float(residual @ residual), slopes, np.ones(len(residual)), residual)

    def _residual(self, x: Variables, posed: Posed) -> Float:
        return (x[self.view].pixels(posed.landmarks[self.marks]) - self.pixels) / self.sigma

    def _posed(self, x: Variables) -> Posed:
        return Posed(x["shape"].body, Pose(np.eye(4), x["joints"].values))
