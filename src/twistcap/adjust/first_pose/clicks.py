"""The first state of the differential tracker from joints clicked in one or more views, without calibrated cameras.

Turns, scales and places of the views, joint angles and body dimensions together, left and right of equal length
(Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998, section 2.6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap import se3
from twistcap._typing import Bool, Float, Int
from twistcap.adjust.first_pose.skeleton import Proportions, Scaling, Skeleton
from twistcap.body import Body, Posed, rescaled
from twistcap.body.kinematics import Pose
from twistcap.camera import pinhole
from twistcap.camera.scaled import ROOT, ScaledView
from twistcap.differential.model import state_at, view_block, view_blocks
from twistcap.differential.state import State
from twistcap.errors import InputError
from twistcap.render import SurfacePoints
from twistcap.solve import BlockProblem, Variables, Vector, minimise
from twistcap.terms import BlockGaussian, BlockTerm, Slope, Sums
from twistcap.terms.scaled import ViewGaussian, image_motion

_FEWEST = 4
_HEADINGS = 8
_STEPS, _DAMPING, _GAIN = 100, 1e-6, 1e-6
_REACH = 0.5  # rad, log-scale, m: beyond it no linearisation holds
_UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # z up, x towards the camera


@dataclass(frozen=True)
class ClickConfig:
    """How the clicks are fitted.

    Attributes:
        sigma_px: standard deviation of a click.
        stature, length, girth: of the body's log-factors. In scaled orthography the stature shows in no image.
        angle_deg: of the joint angles about neutral, so weak that it only decides what no click says.
        fit_lengths: whether the body's dimensions are free.
        lean_deg: of each view's turn out of the start's, for a camera held upright.
    """

    sigma_px: float = 2.0
    stature: float = 0.02
    length: float = 0.08
    girth: float = 0.08
    angle_deg: float = 60.0
    fit_lengths: bool = True
    lean_deg: float = 60.0


@dataclass(frozen=True)
class ClickedStart:
    """What was found.

    Attributes:
        body: at the fitted dimensions.
        state: of it.
        proportions: that made it.
        residual_px: (V, L) distance of each click from its landmark, NaN where there was none.
        covariance: (6 V + J, 6 V + J) of the state's step, the body's dimensions free where they are fitted.
    """

    body: Body
    state: State
    proportions: Proportions
    residual_px: Float
    covariance: Float


@dataclass(frozen=True)
class Clicks:
    """Landmarks (L,), where they were clicked in each view (V, L, 2), and whether they were (V, L)."""

    marks: Int
    pixels: Float
    known: Bool


def fit_clicks(
    body: Body,
    clicks: Sequence[Mapping[str, Sequence[float]]],
    *,
    facing_deg: Sequence[float] | None = None,
    start: State | None = None,
    config: ClickConfig | None = None,
) -> ClickedStart:
    """The state and dimensions of a body whose joints were clicked.

    Args:
        body: with landmarks; the clicks' names are theirs.
        clicks: of each view, (x, y) px by landmark name; a view may lack some.
        facing_deg: of each view, the direction the body faces: 0 towards the camera, 90 to the image's right; by
            default several are tried.
        start: where to begin; by default upright bodies.
        config: settings.

    Raises:
        InputError: for an unknown name, fewer than four clicks in a view, or numbers that are not finite.
    """
    config, skeleton = config or ClickConfig(), Skeleton(body)
    found = gathered(body, clicks)
    starts = [start] if start is not None else _starts(body, found, facing_deg)
    x, _ = min((_minimised(skeleton, found, begin, config) for begin in starts), key=lambda end: end[1])
    proportions, state = skeleton.proportions(x["shape"].values), state_at(x)
    fitted = rescaled(body, proportions.lengths, proportions.girths, proportions.stature)
    at = Posed(fitted, Pose(np.eye(4), state.q)).landmarks[found.marks]
    off = np.stack([view.pixels(at) for view in state.views]) - found.pixels
    residual = np.where(found.known, np.linalg.norm(off, axis=-1), np.nan)
    size = ROOT * len(state.views) + len(state.q)
    covariance = click_problem(found, x, config).covariance(x)[:size, :size]
    return ClickedStart(fitted, state, proportions, residual, covariance)


def gathered(body: Body, clicks: Sequence[Mapping[str, Sequence[float]]]) -> Clicks:
    names = list(dict.fromkeys(name for view in clicks for name in view))
    for name in names:
        if name not in body.landmarks.names:
            raise InputError(f"clicks: {name!r} is no landmark of the body; it has {', '.join(body.landmarks.names)}.")
    pixels = np.array([[view.get(name, (np.nan, np.nan)) for name in names] for view in clicks], dtype=np.float64)
    given = np.array([[name in view for name in names] for view in clicks], dtype=bool)
    if not clicks or given.sum(axis=1).min() < _FEWEST:
        raise InputError(f"clicks: every view needs {_FEWEST} clicked joints or more.")
    if not np.all(np.isfinite(pixels[given])):
        raise InputError("clicks: a pixel is not a finite number; leave that joint out.")
    return Clicks(np.array([body.landmarks.index(name) for name in names], np.int32), np.nan_to_num(pixels), given)


def _starts(body: Body, clicks: Clicks, facing_deg: Sequence[float] | None) -> list[State]:
    """Upright bodies, each view's scale and place laid on its clicks."""
    V = len(clicks.pixels)
    if facing_deg is not None and len(facing_deg) != V:
        raise InputError(f"clicks: {len(facing_deg)} directions are given for {V} views; give one for each.")
    turns = 360.0 * np.arange(_HEADINGS) / _HEADINGS
    first = [np.asarray(facing_deg, float)] if facing_deg is not None else [np.full(V, a) for a in turns]
    q = np.clip(np.zeros(len(body.coordinate_names)), *body.limits.T)
    points = Posed(body, Pose(np.eye(4), q)).landmarks[clicks.marks]
    states = [State(tuple(_laid(points, clicks, v, a) for v, a in enumerate(angles)), q) for angles in first]
    if facing_deg is None and V > 1:  # each view by itself takes the direction that suits it best
        best = [
            min((s.views[v] for s in states), key=lambda view, v=v: _misfit(view, points, clicks, v)) for v in range(V)
        ]
        states.append(State(tuple(best), q))
    return states


def _laid(points: Float, clicks: Clicks, v: int, facing: float) -> ScaledView:
    """The view of a direction whose scale and shift suit the clicks best, by heights and middles."""
    a = np.deg2rad(facing)
    turn = _UPRIGHT @ se3.exp_rotation(np.array([0.0, 0.0, a]))
    known = clicks.known[v]
    at = (points[known] @ turn.T)[:, :2]
    there = clicks.pixels[v][known]
    scale = float(np.ptp(there[:, 1]) / max(np.ptp(at[:, 1]), 1e-6))
    return ScaledView(turn, scale, (there - scale * at).mean(axis=0))


def _misfit(view: ScaledView, points: Float, clicks: Clicks, v: int) -> float:
    return float(np.sum((view.pixels(points) - clicks.pixels[v])[clicks.known[v]] ** 2))


def _minimised(skeleton: Skeleton, clicks: Clicks, start: State, config: ClickConfig) -> tuple[Variables, float]:
    """From one start, its turns taken up afresh once: the blocks and their energy."""
    x = click_variables(skeleton, start, config)
    first = minimise(click_problem(clicks, x, config), x, _STEPS, damping=_DAMPING, gain=_GAIN)
    again = minimise(click_problem(clicks, first.x, config), first.x, _STEPS, damping=_DAMPING, gain=_GAIN)
    return again.x, again.energy


def click_variables(skeleton: Skeleton, start: State, config: ClickConfig) -> Variables:
    """The views, the joints inside their limits, and the body's log-factors."""
    body, views = skeleton.body, view_blocks(start)
    reach = {name: _REACH * np.array([1, view.scale, view.scale, 1, 1, 1]) for name, view in views.items()}
    joints = Vector(np.clip(start.q, *body.limits.T), body.limits)
    free = (*views, "joints", *(["shape"] if config.fit_lengths else []))
    return Variables({**views, "joints": joints, "shape": Scaling(skeleton, np.zeros(skeleton.size))}, free, reach)


def click_problem(clicks: Clicks, start: Variables, config: ClickConfig) -> BlockProblem:
    """``½ Σ |x − click|² / σ²`` and weak Gaussians on angles, log-factors and the views' turns out of the start's."""
    skeleton: Skeleton = start["shape"].skeleton
    c, J = config, len(start["joints"].values)
    lean = np.array([*[np.inf] * 3, *[np.deg2rad(c.lean_deg)] * 3])
    sizes = [c.stature, *[c.length] * len(skeleton.length_groups), *[c.girth] * len(skeleton.girth_segments)]
    terms: list[BlockTerm] = [
        BlockGaussian("joints", np.zeros(J), np.full(J, np.deg2rad(c.angle_deg)), "neutral"),
        BlockGaussian("shape", np.zeros(len(sizes)), np.array(sizes)),
    ]
    for v in range(len(clicks.pixels)):
        own = np.flatnonzero(clicks.known[v])
        terms.append(ClickTerm(view_block(v), clicks.marks[own], clicks.pixels[v, own], c.sigma_px))
        terms.append(ViewGaussian(view_block(v), start[view_block(v)], lean))
    return BlockProblem(terms)


@dataclass(frozen=True)
class ClickTerm:
    """N clicked landmarks in one view.

    Attributes:
        view: its block.
        marks: (N,) landmarks.
        pixels: (N, 2) px.
        sigma: px.
    """

    view: str
    marks: Int
    pixels: Float
    sigma: float
    name: str = "clicks"

    @property
    def blocks(self) -> tuple[str, ...]:
        return (self.view, "joints", "shape")

    def energy(self, x: Variables) -> float:
        return 0.5 * float(np.sum(self._residual(x, self._posed(x)) ** 2))

    def add_to(self, sums: Sums, x: Variables) -> None:
        posed, view, marks = self._posed(x), x[self.view], x["shape"].body.landmarks
        residual = self._residual(x, posed).ravel()
        points = SurfacePoints(
            marks.segments[self.marks, None], np.ones((len(self.marks), 1)), marks.points[self.marks]
        )
        motion = image_motion(posed, view, points).reshape(len(residual), -1) / self.sigma
        slopes = [Slope(self.view, motion[:, :ROOT]), Slope("joints", motion[:, ROOT:])]
        if "shape" in x.free:
            by_point = pinhole(view.P, posed.landmarks[self.marks])[2] / self.sigma
            by_shape = by_point @ x["shape"].rates(posed)[self.marks]
            slopes.append(Slope("shape", by_shape.reshape(len(residual), -1)))
        sums.add_rows(0.5 * float(residual @ residual), slopes, np.ones(len(residual)), residual)

    def _residual(self, x: Variables, posed: Posed) -> Float:
        return (x[self.view].pixels(posed.landmarks[self.marks]) - self.pixels) / self.sigma

    def _posed(self, x: Variables) -> Posed:
        return Posed(x["shape"].body, Pose(np.eye(4), x["joints"].values))
