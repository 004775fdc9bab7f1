"""The humanoid's skinning weights: from the trunk outwards, weight moves smoothly to the segment below each joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.sparse import coo_matrix

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import _humanoid_profiles as P
from twistcap.body._humanoid_field import Field
from twistcap.body.model import edges_of

_SOFT = 0.035  # m, half of the blending zone of trunk and limb
_SMOOTHINGS = 3
_BRANCHES = {"arm": "humerus", "leg": "femur"}
_HINGES = {  # joint, above, below, half of the blending zone in m
    "arm": ((P.ELBOW, "humerus", "ulna", 0.04), (P.WRIST, "radius", "hand", 0.025)),
    "leg": ((P.KNEE, "femur", "tibia", 0.05), (P.ANKLE, "tibia", "foot", 0.03)),
}


class _Binding:
    """Weights (V, S), all on the pelvis at first."""

    def __init__(self, segments: tuple[str, ...], points: Float) -> None:
        self.number = {name: i for i, name in enumerate(segments)}
        self.weights = np.zeros((len(points), len(segments)))
        self.weights[:, 0] = 1.0

    def move(self, above: str, below: str, fraction: Float) -> None:
        """Move a fraction (V,) of the weight to the segment below, if the body has both."""
        if above in self.number and below in self.number:
            moved = self.weights[:, self.number[above]] * fraction
            self.weights[:, self.number[above]] -= moved
            self.weights[:, self.number[below]] += moved


def binding(
    segments: tuple[str, ...], field: Field, points: Float, faces: Int, motions: Mapping[str, Float]
) -> tuple[Int, Float]:
    """Segments and weights (V, 4) of points in the modelling pose, whose left arm and leg `motions` (4, 4) place."""
    out = _Binding(segments, points)
    _bind_trunk(out, points)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        mirrored = points * [1.0, sign, 1.0]
        collar = _ramp(mirrored[:, 1], 0.09, 0.06) * _ramp(points[:, 2], 0.40, 0.10)
        out.move(_chest(out), f"clavicle_{side}", collar)
        for part in _BRANCHES:
            if f"{part}_{side}" in field.parts:
                near = _ramp(field.lead(points, part, side), 0.0, _SOFT) * _ramp(mirrored[:, 1], 0.015, 0.015)
                _bind_limb(out, part, side, near, se3.apply(se3.inverse(motions[part]), mirrored))
    return _strongest(_smoothed(out.weights, faces))


def _chest(out: _Binding) -> str:
    return "thorax" if "thorax" in out.number else "torso"


def _bind_trunk(out: _Binding, points: Float) -> None:
    z = points[:, 2]
    out.move("pelvis", "torso", _ramp(z, P.LUMBAR[2], 0.08))
    out.move("torso", "thorax", _ramp(z, P.THORAX[2], 0.07))
    out.move(_chest(out), "head", _ramp(z + 0.3 * points[:, 0], P.NECK[2] + 0.035, 0.045))


def _bind_limb(out: _Binding, part: str, side: str, near: Float, local: Float) -> None:
    """One limb: `near` (V,) is its weight against the trunk, `local` (V, 3) the points in the left neutral pose."""
    for above in ("pelvis", "torso", "thorax", f"clavicle_{side}"):
        out.move(above, f"{_BRANCHES[part]}_{side}", near)
    for at, above, below, width in _HINGES[part]:
        if above == "radius":  # pronation twists the whole forearm evenly
            top, bottom = P.ELBOW[2] - 0.05, P.WRIST[2] + 0.01
            out.move(f"ulna_{side}", f"radius_{side}", np.clip((top - local[:, 2]) / (top - bottom), 0.0, 1.0))
        out.move(f"{above}_{side}", f"{below}_{side}", _ramp(at[2] - local[:, 2], 0.0, width))


def _ramp(x: Float, centre: float, half_width: float) -> Float:
    """Smooth step from 0 to 1 around a centre."""
    t = np.clip((x - centre) / (2 * half_width) + 0.5, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _smoothed(weights: Float, faces: Int) -> Float:
    """The binding (V, S) averaged with that of the neighbours, against creases at bent joints."""
    edges, _ = edges_of(faces)
    links = coo_matrix((np.ones(2 * len(edges)), (edges.ravel(), edges[:, ::-1].ravel()))).tocsr()
    degree = np.asarray(links.sum(axis=1))
    for _ in range(_SMOOTHINGS):
        weights = 0.5 * (weights + links @ weights / degree)
    return weights


def _strongest(weights: Float) -> tuple[Int, Float]:
    """The 4 strongest segments (V, 4) of each vertex and their weights, which sum to 1; those below 1 % are dropped."""
    segments = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    kept = np.take_along_axis(weights, segments, axis=1)
    kept[kept < 0.01] = 0.0
    return segments.astype(np.int32), kept / kept.sum(axis=1, keepdims=True)
