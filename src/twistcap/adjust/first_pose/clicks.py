"""The first state of the differential tracker from joints clicked in one or more views, without calibrated cameras.

Turns, scales and places of the views, joint angles and body dimensions together, left and right of equal length, by a
quasi-Newton method (Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998, section 2.6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize

from twistcap import se3
from twistcap._typing import Bool, Float, Int
from twistcap.adjust.first_pose.skeleton import Proportions, Skeleton
from twistcap.body import Body, Posed, rescaled
from twistcap.body.kinematics import Pose
from twistcap.differential.system import image_motion
from twistcap.differential.view import ROOT, ScaledView, State
from twistcap.errors import InputError
from twistcap.render import SurfacePoints

_FEWEST = 4
_HEADINGS = 8
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
    """

    body: Body
    state: State
    proportions: Proportions
    residual_px: Float


@dataclass(frozen=True)
class _Clicks:
    """Landmarks and where they were clicked in each view."""

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
    found = _gathered(body, clicks)
    starts = [start] if start is not None else _starts(body, found, facing_deg)
    ends = [_minimised(skeleton, found, begin, config) for begin in starts]
    _, state, factors = min(ends, key=lambda end: end[0])
    proportions = skeleton.proportions(factors)
    fitted = rescaled(body, proportions.lengths, proportions.girths, proportions.stature)
    at = Posed(fitted, Pose(np.eye(4), state.q)).landmarks[found.marks]
    off = np.stack([view.pixels(at) for view in state.views]) - found.pixels
    return ClickedStart(fitted, state, proportions, np.where(found.known, np.linalg.norm(off, axis=-1), np.nan))


def _gathered(body: Body, clicks: Sequence[Mapping[str, Sequence[float]]]) -> _Clicks:
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
    return _Clicks(np.array([body.landmarks.index(name) for name in names], np.int32), np.nan_to_num(pixels), given)


def _starts(body: Body, clicks: _Clicks, facing_deg: Sequence[float] | None) -> list[State]:
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


def _laid(points: Float, clicks: _Clicks, v: int, facing: float) -> ScaledView:
    """The view of a direction whose scale and shift suit the clicks best, by heights and middles."""
    a = np.deg2rad(facing)
    turn = _UPRIGHT @ se3.exp_rotation(np.array([0.0, 0.0, a]))
    known = clicks.known[v]
    at = (points[known] @ turn.T)[:, :2]
    there = clicks.pixels[v][known]
    scale = float(np.ptp(there[:, 1]) / max(np.ptp(at[:, 1]), 1e-6))
    return ScaledView(turn, scale, (there - scale * at).mean(axis=0))


def _misfit(view: ScaledView, points: Float, clicks: _Clicks, v: int) -> float:
    return float(np.sum((view.pixels(points) - clicks.pixels[v])[clicks.known[v]] ** 2))


def _minimised(skeleton: Skeleton, clicks: _Clicks, start: State, config: ClickConfig) -> tuple[float, State, Float]:
    """L-BFGS-B from one start, its turns taken up afresh once: energy, state and log-factors."""
    factors, energy = np.zeros(skeleton.size), np.inf
    state = start
    for _ in range(2):
        problem = ClickEnergy(skeleton, clicks, state, config)
        x0 = np.concatenate([np.zeros(ROOT * len(state.views)), state.q, factors])
        unit = _units(len(state.views), len(x0))

        def scaled(y: Float, problem: ClickEnergy = problem, unit: Float = unit) -> tuple[float, Float]:
            value, gradient = problem(unit * y)
            return value, unit * gradient

        limits = zip(problem.bounds, unit, strict=True)
        bounds = [tuple(None if b is None else b / u for b in pair) for pair, u in limits]
        done = minimize(scaled, x0 / unit, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 300})
        energy, (state, factors) = float(done.fun), problem.unpacked(unit * done.x)
    return energy, state, factors


def _units(views: int, n: int) -> Float:
    """(n,) steps of the unknowns that move pixels by about as much: a quasi-Newton method wants them alike."""
    out = np.full(n, 0.1)
    out[: ROOT * views] = np.tile([0.05, 5.0, 5.0, 0.1, 0.1, 0.1], views)
    return out


@dataclass(frozen=True)
class ClickEnergy:
    """Value and gradient of the fit, by each view's motion from a start, the joint angles and the log-factors.

    ``½ Σ |x − click|² / σ²`` and weak Gaussians on angles, turns and log-factors.
    """

    skeleton: Skeleton
    clicks: _Clicks
    start: State
    config: ClickConfig = field(default_factory=ClickConfig)

    @property
    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Of every unknown: joints by their limits, dimensions held where they are not to be fitted."""
        size = None if self.config.fit_lengths else 0.0
        lower, upper = self.skeleton.body.limits.T
        joints = [(float(a), float(b)) for a, b in zip(lower, upper, strict=True)]
        views: list[tuple[float | None, float | None]] = [(None, None)] * (ROOT * len(self.start.views))
        sizes: list[tuple[float | None, float | None]] = [(size, size)] * self.skeleton.size
        return [*views, *joints, *sizes]

    def unpacked(self, x: Float) -> tuple[State, Float]:
        """State and log-factors of the unknowns."""
        V, J = len(self.start.views), len(self.start.q)
        views = tuple(view.moved(x[ROOT * v : ROOT * v + ROOT]) for v, view in enumerate(self.start.views))
        return State(views, x[ROOT * V : ROOT * V + J].copy()), x[ROOT * V + J :].copy()

    def __call__(self, x: Float) -> tuple[float, Float]:
        (state, factors), V, J = self.unpacked(x), len(self.start.views), len(self.start.q)
        body = self.skeleton.scaled(factors)
        posed, marks = state.posed(body), body.landmarks
        which = self.clicks.marks
        points = SurfacePoints(marks.segments[which, None], np.ones((len(which), 1)), marks.points[which])
        by_factor = self.skeleton.jacobian(posed, factors)[which]
        g, value = np.zeros(len(x)), 0.0
        for v, view in enumerate(state.views):
            rows = np.r_[ROOT * v : ROOT * v + ROOT, ROOT * V : len(x)]
            move = image_motion(posed, view, points)
            turn = se3.left_jacobian(np.concatenate([x[ROOT * v + 3 : ROOT * v + ROOT], np.zeros(3)]))[:3, :3]
            move[:, :, 3:ROOT] = move[:, :, 3:ROOT] @ turn
            size = view.scale * np.einsum("ij,njk->nik", view.rotation[:2], by_factor)
            r = (view.pixels(posed.landmarks[which]) - self.clicks.pixels[v]) / self.config.sigma_px
            r = np.where(self.clicks.known[v, :, None], r, 0.0)
            value += 0.5 * float(np.sum(r * r))
            g[rows] += np.einsum("ni,nid->d", r / self.config.sigma_px, np.concatenate([move, size], axis=2))
        pull, weight = x.copy(), self._stiffness(V, J)
        return value + 0.5 * float(np.sum(weight * pull**2)), g + weight * pull

    def _stiffness(self, V: int, J: int) -> Float:
        c, k = self.config, self.skeleton
        sizes = [c.stature, *[c.length] * len(k.length_groups), *[c.girth] * len(k.girth_segments)]
        lean = np.deg2rad(c.lean_deg)
        view = [0.0, 0.0, 0.0, lean**-2, lean**-2, lean**-2]
        return np.concatenate([np.tile(view, V), np.full(J, np.deg2rad(c.angle_deg) ** -2.0), np.array(sizes) ** -2.0])
