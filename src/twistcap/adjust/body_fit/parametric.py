"""Bodies with a few parameters, such as Anny, in a fit: linearised by difference quotients at every step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twistcap.adjust.body_fit.build import Motions
from twistcap.adjust.body_fit.fields import Fields, joint_centres
from twistcap.adjust.first_pose import fit_keypoints
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints

_STEP = 0.02  # of the difference quotients
_ROUNDS = 8  # of Gauss-Newton, to the lengths of another body
_BREADTH = 0.06  # standard deviation of log-breadths: the joints of two bodies differ most in these
_SIDES = ("r", "l")
_LENGTHS = tuple(
    (f"{a}_{s}", f"{b}_{s}")
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
    for s in _SIDES
)
_TRUNK = (("mid_hip", "neck"), ("mid_hip", "head_top"))
_BREADTHS = (("hip_r", "hip_l"), ("shoulder_r", "shoulder_l"))
_MEASURED = tuple(dict.fromkeys(name for pair in (*_LENGTHS, *_TRUNK, *_BREADTHS) for name in pair))


class Parameter(Protocol):
    """A parameter's name, mean and standard deviation over people, and bounds."""

    @property
    def name(self) -> str: ...
    @property
    def usual(self) -> float: ...
    @property
    def spread(self) -> float: ...
    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...


class Model(Protocol):
    """A body for every choice of parameters; tree, faces and binding are always the same."""

    @property
    def parameters(self) -> Sequence[Parameter]: ...

    def bodies(self, values: Float) -> list[Body]:
        """Bodies of parameters (N, M)."""
        ...


@dataclass(frozen=True)
class Parametric:
    """A model's parameters as a `Build`; amounts are counted from `start`.

    Attributes:
        model: of the body.
        start: (M,) parameters of the body with which the fit begins.
        length: standard deviation of the logarithms of limb lengths and stature about those of the start; contours
            hardly show them.
        rigid: whether a segment's surface must not turn against the axes of its joint. By default it may: a model
            turns its surface as people do.
    """

    model: Model
    start: Float
    length: float = 0.01
    rigid: bool = False

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        parameters = self.model.parameters
        values = self.start + [amounts.get(p.name, 0.0) for p in parameters]
        rates = rates_at(self.model, values)
        spread = np.array([p.spread for p in parameters])
        bones, sigma = _length_rates(body, rates[2]), _sigmas(self.length)
        precision = np.diag(spread**-2.0) + (bones.T / sigma**2) @ bones
        return Fields(tuple(p.name for p in parameters), *rates, precision)

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        del fields
        before = self.start + amounts
        after = _within(self.model.parameters, before + change)
        old, new = self.model.bodies(np.stack([before, after]))
        motions = new.vertices - old.vertices, joint_centres(new) - joint_centres(old)
        return after - before, (*motions, new.landmarks.points - old.landmarks.points)

    def summary(self, amounts: Mapping[str, float]) -> dict[str, float]:
        pairs = zip(self.model.parameters, self.start, strict=True)
        return {p.name: float(v + amounts.get(p.name, 0.0)) for p, v in pairs}


def rates_at(model: Model, values: Float) -> Motions:
    """Derivatives by the parameters (M,): of vertices (M, V, 3), joint centres (M, S, 3), landmarks (M, L, 3).

    Central differences, one-sided at a bound.
    """
    M, parameters = len(values), model.parameters
    steps = _STEP * np.eye(M)
    up, down = (_within(parameters, values + sign * steps) for sign in (1.0, -1.0))
    bodies = model.bodies(np.concatenate([up, down]))
    width = np.diagonal(up - down)[:, None, None]
    vertices = np.array([b.vertices for b in bodies])
    centres = np.array([joint_centres(b) for b in bodies])
    marks = np.array([b.landmarks.points for b in bodies])
    vertices, centres, marks = ((of[:M] - of[M:]) / width for of in (vertices, centres, marks))
    return vertices, centres, marks


def matched(model: Model, body: Body, length: float = 0.01) -> Parametric:
    """The mean person with the limb lengths, trunk and stature of another body, as a build to start a fit with.

    Raises:
        InputError: where the body lacks a landmark that measures it, as ``humanoid("legs")`` does.
    """
    missing = [name for name in _MEASURED if name not in body.landmarks.names]
    if missing:
        raise InputError(
            f"body {body.name!r} has no landmarks {', '.join(missing)}, which measure its lengths;"
            " start with a whole body."
        )
    parameters = model.parameters
    usual, spread = np.array([p.usual for p in parameters]), np.array([p.spread for p in parameters])
    values, wanted, sigma = usual, _log_lengths(body), _sigmas(length)
    for _ in range(_ROUNDS):
        here = model.bodies(values[None])[0]
        J = _length_rates(here, rates_at(model, values)[2]) / sigma[:, None]
        error = (_log_lengths(here) - wanted) / sigma
        gradient = J.T @ error + (values - usual) / spread**2
        change = np.asarray(np.linalg.solve(J.T @ J + np.diag(spread**-2.0), gradient), np.float64)
        values = _within(parameters, values - change)
    return Parametric(model, values, length)


def carried_pose(given: Body, pose: Pose, body: Body, rig: Rig) -> Pose:
    """The pose of another body whose landmarks project to those of the given one.

    Raises:
        InputError: for fewer than two cameras, or too few landmarks before two of them.
    """
    names = tuple(name for name in body.landmarks.names if name in given.landmarks.names)
    points = Posed(given, pose).landmarks[[given.landmarks.index(name) for name in names]]
    pixels = np.stack([camera.project(points)[0] for camera in rig])
    confidence = np.isfinite(pixels).all(axis=2).astype(float)  # what lies behind a camera is not seen by it
    q = [pose.q[given.coordinate(n)] if n in given.coordinate_names else 0.0 for n in body.coordinate_names]
    start = Pose(pose.root, np.array(q)).within(body.limits)
    return fit_keypoints(body, rig, Keypoints(names, pixels, confidence), fit_lengths=False, start=start).pose


def _sigmas(length: float) -> Float:
    """(P,) of the logarithms of lengths and breadths."""
    return np.array([length] * (len(_LENGTHS) + len(_TRUNK)) + [_BREADTH] * len(_BREADTHS))


def _pairs(body: Body) -> tuple[Float, Float]:
    """Both ends (P, 3) of the lengths and breadths."""
    marks = body.landmarks
    pairs = (*_LENGTHS, *_TRUNK, *_BREADTHS)
    a, b = (marks.points[[marks.index(pair[k]) for pair in pairs]] for k in (0, 1))
    return a, b


def _log_lengths(body: Body) -> Float:
    a, b = _pairs(body)
    return np.log(np.linalg.norm(a - b, axis=1))


def _length_rates(body: Body, marks: Float) -> Float:
    """(P, M) derivatives of the logarithms of lengths and breadths, from those (M, L, 3) of the landmarks."""
    a, b = _pairs(body)
    pairs = (*_LENGTHS, *_TRUNK, *_BREADTHS)
    first, second = (marks[:, [body.landmarks.index(pair[k]) for pair in pairs]] for k in (0, 1))
    apart = a - b
    return np.einsum("pi,mpi->pm", apart / np.sum(apart**2, axis=1)[:, None], first - second)


def _within(parameters: Sequence[Parameter], values: Float) -> Float:
    return np.clip(values, [p.low for p in parameters], [p.high for p in parameters])
