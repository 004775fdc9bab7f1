"""Bodies with a few parameters, such as Anny, in a fit: linearised by difference quotients at every step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twistcap.adjust.body_fit.fields import Fields, Motions, places_of
from twistcap.adjust.first_pose import fit_keypoints
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.anny import Parameter
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.solve import BlockProblem, Variables, Vector, minimise
from twistcap.terms import BlockGaussian, Slope, Sums

_STEP = 0.02  # of the difference quotients
_STEPS, _GAIN = 8, 1e-9  # of Gauss-Newton, to the lengths of another body
_LIMBS = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_LENGTHS = (*((f"{a}_{s}", f"{b}_{s}") for a, b in _LIMBS for s in "rl"), ("mid_hip", "neck"), ("mid_hip", "head_top"))
_BREADTHS = (("hip_r", "hip_l"), ("shoulder_r", "shoulder_l"))
_PAIRS = (*_LENGTHS, *_BREADTHS)
# Standard deviations of their logarithms. Contours hardly show lengths; joints of two bodies differ most in breadths.
_SIGMAS = np.repeat([0.01, 0.06], [len(_LENGTHS), len(_BREADTHS)])


class Model(Protocol):
    """A body for every choice of parameters; tree, faces and binding are always the same."""

    @property
    def parameters(self) -> Sequence[Parameter]: ...

    def bodies(self, values: Float) -> list[Body]:
        """Bodies of parameters (N, M)."""
        ...


@dataclass(frozen=True)
class Parametric:
    """A model's parameters as a `Build`; amounts are counted from `start` (M,), with which the fit begins.

    By default a segment's surface may turn against the axes of its joint, as a model's does.
    """

    model: Model
    start: Float
    rigid: bool = False

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        parameters = self.model.parameters
        rates = rates_at(self.model, self.start + [amounts.get(p.name, 0.0) for p in parameters])
        spread = np.array([p.spread for p in parameters])
        bones = _length_rates(body, rates[2])
        precision = np.diag(spread**-2.0) + (bones.T / _SIGMAS**2) @ bones
        return Fields(tuple(p.name for p in parameters), *rates, precision)

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        before = self.start + amounts
        after = _within(self.model.parameters, before + change)
        old, new = self.model.bodies(np.stack([before, after]))
        vertices, joints, marks = (b - a for a, b in zip(places_of(old), places_of(new), strict=True))
        return after - before, (vertices, joints, marks)

    def summary(self, amounts: Mapping[str, float]) -> dict[str, float]:
        pairs = zip(self.model.parameters, self.start, strict=True)
        return {p.name: float(v + amounts.get(p.name, 0.0)) for p, v in pairs}


def rates_at(model: Model, values: Float) -> Motions:
    """Derivatives by the parameters (M,): of vertices (M, V, 3), joint centres (M, S, 3), landmarks (M, L, 3). Central
    differences, one-sided at a bound."""
    M, parameters = len(values), model.parameters
    steps = _STEP * np.eye(M)
    up, down = (_within(parameters, values + sign * steps) for sign in (1.0, -1.0))
    bodies = model.bodies(np.concatenate([up, down]))
    width = np.diagonal(up - down)[:, None, None]
    places = zip(*map(places_of, bodies), strict=True)
    vertices, centres, marks = ((np.array(of[:M]) - np.array(of[M:])) / width for of in places)
    return vertices, centres, marks


def matched(model: Model, body: Body) -> Parametric:
    """The mean person with the limb lengths, trunk and stature of another body, as a build to start a fit with. Raises
    InputError where the body lacks a landmark that measures it, as ``humanoid("legs")`` does."""
    measured = dict.fromkeys(name for pair in _PAIRS for name in pair)
    missing = [name for name in measured if name not in body.landmarks.names]
    if missing:
        lacks = f"no landmarks {', '.join(missing)}, which measure its lengths"
        raise InputError(f"body {body.name!r} has {lacks}; start with a whole body.")
    parameters = model.parameters
    usual, spread = np.array([p.usual for p in parameters]), np.array([p.spread for p in parameters])
    bounds = np.array([(p.low, p.high) for p in parameters])
    terms = [LengthsTerm(model, _log_lengths(body), _SIGMAS), BlockGaussian("build", usual, spread)]
    x = minimise(BlockProblem(terms), Variables({"build": Vector(usual, bounds)}, ("build",)), _STEPS, gain=_GAIN).x
    return Parametric(model, x["build"].values)


@dataclass(frozen=True)
class LengthsTerm:
    """Gaussians about the logarithms of lengths and breadths (P,), by the parameters (M,) in the block `build`."""

    model: Model
    wanted: Float
    sigma: Float
    name: str = "lengths"

    def energy(self, x: Variables) -> float:
        return 0.5 * float(np.sum(self._residual(x) ** 2))

    def add_to(self, sums: Sums, x: Variables) -> None:
        rates = _length_rates(self._body(x), rates_at(self.model, x["build"].values)[2])
        slopes = [Slope("build", rates / self.sigma[:, None])]
        sums.add_rows(self.energy(x), slopes, np.ones(len(self.sigma)), self._residual(x))

    def _residual(self, x: Variables) -> Float:
        return (_log_lengths(self._body(x)) - self.wanted) / self.sigma

    def _body(self, x: Variables) -> Body:
        if "body" not in x.memo:
            x.memo["body"] = self.model.bodies(x["build"].values[None])[0]
        return x.memo["body"]


def carried_pose(given: Body, pose: Pose, body: Body, rig: Rig) -> Pose:
    """The pose of another body whose landmarks project to those of the given one. Raises InputError for fewer than two
    cameras, or too few landmarks before two of them."""
    names = tuple(name for name in body.landmarks.names if name in given.landmarks.names)
    points = Posed(given, pose).landmarks[[given.landmarks.index(name) for name in names]]
    pixels = np.stack([camera.project(points)[0] for camera in rig])
    confidence = np.isfinite(pixels).all(axis=2).astype(float)  # what lies behind a camera is not seen by it
    q = [pose.q[given.coordinate(n)] if n in given.coordinate_names else 0.0 for n in body.coordinate_names]
    start = Pose(pose.root, np.array(q)).within(body.limits)
    return fit_keypoints(body, rig, Keypoints(names, pixels, confidence), fit_lengths=False, start=start).pose


def _apart(body: Body, marks: Float) -> Float:
    """(..., P, 3) differences of the two ends of lengths and breadths, of landmarks (..., L, 3)."""
    a, b = ([body.landmarks.index(pair[k]) for pair in _PAIRS] for k in (0, 1))
    return marks[..., a, :] - marks[..., b, :]


def _log_lengths(body: Body) -> Float:
    return np.log(np.linalg.norm(_apart(body, body.landmarks.points), axis=1))


def _length_rates(body: Body, marks: Float) -> Float:
    """(P, M) derivatives of the logarithms of lengths and breadths, from those (M, L, 3) of the landmarks."""
    apart = _apart(body, body.landmarks.points)
    return np.einsum("pi,mpi->pm", apart / np.sum(apart**2, axis=1)[:, None], _apart(body, marks))


def _within(parameters: Sequence[Parameter], values: Float) -> Float:
    return np.clip(values, [p.low for p in parameters], [p.high for p in parameters])
