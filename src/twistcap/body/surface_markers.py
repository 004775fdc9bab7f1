"""Markers on the surface of a human body, where a laboratory would stick them.

Names are those of OpenSim's Rajagopal model (Rajagopal et al. 2016, DOI 10.1109/TBME.2016.2586891), and of Plug-in Gait
for head, breast and back. Each is where a ray from inside leaves the surface in the rest pose, and moves with one
segment rigidly: there is no play of soft tissue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float
from twistcap.body.anatomy import Bone, bones_of
from twistcap.body.model import Body, Landmarks
from twistcap.body.shape import line_crossings

Anchor = Mapping[str, float]  # weights of landmarks


@dataclass(frozen=True)
class _Site:
    """Of the right side: from the anchor the ray goes in a direction of the bone (x forward, y up, z outward)."""

    bone: str
    anchor: Anchor
    way: tuple[float, float, float]
    lift: float = 0.0  # of the anchor along the bone's y, in half distances of the hips


_OUT, _IN, _FRONT, _BACK, _UP = (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0)
_CROWN = {"ear_r": 0.3, "ear_l": 0.3, "head_top": 0.4}
_MIDDLE: Mapping[str, _Site] = {
    "C7": _Site("thorax", {"neck": 1.0}, _BACK),
    "CLAV": _Site("thorax", {"neck": 0.25, "shoulder_r": 0.375, "shoulder_l": 0.375}, _FRONT),
    "STRN": _Site("spine", {"shoulder_r": 0.3, "shoulder_l": 0.3, "mid_hip": 0.4}, _FRONT),
    "T10": _Site("spine", {"shoulder_r": 0.275, "shoulder_l": 0.275, "mid_hip": 0.45}, _BACK),
}
_SIDED: Mapping[str, _Site] = {
    "FHD": _Site("head", _CROWN, (1.0, 0, 0.8)),
    "BHD": _Site("head", _CROWN, (-1.0, 0, 0.8)),
    "ACR": _Site("acromion", {"shoulder": 1.0}, _UP),
    "UA2": _Site("humerus", {"shoulder": 0.3, "elbow": 0.7}, _OUT),
    "UA3": _Site("humerus", {"shoulder": 0.55, "elbow": 0.45}, _FRONT),
    "LEL": _Site("humerus", {"elbow": 1.0}, _OUT),
    "MEL": _Site("humerus", {"elbow": 1.0}, _IN),
    "FAradius": _Site("forearm", {"wrist": 1.0}, _OUT),
    "FAulna": _Site("forearm", {"wrist": 1.0}, _IN),
    # The spines of the pelvis are where Rajagopal's are, by the distance of the hips.
    "ASI": _Site("pelvis", {"mid_hip": 1.0}, (0.066, 0, 0.1285), lift=1.25),
    "PSI": _Site("pelvis", {"mid_hip": 1.0}, (-0.099, 0, 0.045), lift=1.47),
    "TH1": _Site("femur", {"hip": 0.6, "knee": 0.4}, _OUT),
    "TH2": _Site("femur", {"hip": 0.4, "knee": 0.6}, _FRONT),
    "LFC": _Site("femur", {"knee": 1.0}, _OUT),
    "MFC": _Site("femur", {"knee": 1.0}, _IN),
    "TB1": _Site("tibia", {"knee": 0.6, "ankle": 0.4}, _OUT),
    "TB2": _Site("tibia", {"knee": 0.4, "ankle": 0.6}, _FRONT),
    "LMAL": _Site("tibia", {"ankle": 1.0}, _OUT),
    "MMAL": _Site("tibia", {"ankle": 1.0}, _IN),
    "CAL": _Site("foot", {"heel": 0.7, "ankle": 0.3}, _BACK),
    "TOE": _Site("foot", {"toe": 1.0}, _UP),
    "MT5": _Site("foot", {"small_toe": 1.0}, _OUT),
    "FIN": _Site("hand", {"wrist": 1.3, "elbow": -0.3}, _BACK),
}


def surface_markers(body: Body) -> Landmarks:
    """The markers that a body has room for, up to 50; those whose bone or landmarks it lacks are left out."""
    bones = bones_of(body)
    found = [_marker(body, bones, name, site, "") for name, site in _MIDDLE.items()]
    for letter, side in (("R", "_r"), ("L", "_l")):
        found += [_marker(body, bones, letter + name, site, side) for name, site in _SIDED.items()]
    known = [marker for marker in found if marker is not None]
    names = tuple(name for name, _, _ in known)
    points = np.array([point for _, _, point in known]).reshape(-1, 3)
    return Landmarks(names, np.array([segment for _, segment, _ in known], np.int32), points)


def _marker(body: Body, bones: Mapping[str, Bone], name: str, site: _Site, side: str) -> tuple[str, int, Float] | None:
    """Name, segment and place (3,) m in the rest pose."""
    bone, anchor = _bone(body, bones, site.bone, side), _anchored(body, site.anchor, side)
    if bone is None or anchor is None:
        return None
    axes = bone.frame[:3, :3]
    start = anchor + site.lift * _half_hips(body) * axes[:, 1]
    mirrored = np.array([1.0, 1.0, -1.0 if side == "_l" else 1.0])
    way = axes @ (np.array(site.way, float) * mirrored)
    way /= np.linalg.norm(way)
    crossed = line_crossings(body.vertices[body.faces], start, way)
    ahead = crossed[crossed > 0]
    if not len(ahead):
        return None
    point = start + ahead.min() * way
    nearest = np.argmin(
        np.sum((body.vertices - point) ** 2, axis=1)
    )  # of a spine of several segments the one that is there
    return name, int(body.vertex_part[nearest]) if site.bone == "spine" else bone.segment, point


def _bone(body: Body, bones: Mapping[str, Bone], name: str, side: str) -> Bone | None:
    if name == "acromion":  # the segment above the arm: the collar bone, where that moves
        if f"humerus{side}" not in bones or "thorax" not in bones:
            return None
        return Bone(int(body.segment_parent[bones[f"humerus{side}"].segment]), bones["thorax"].frame)
    return bones.get("thorax" if name == "spine" else name + side, bones.get(name))


def _anchored(body: Body, anchor: Anchor, side: str) -> Float | None:
    marks, out = body.landmarks, np.zeros(3)
    for name, weight in anchor.items():
        whole = name if name in marks.names else name + side
        if whole not in marks.names:
            return None
        out += weight * marks.points[marks.index(whole)]
    return out


def _half_hips(body: Body) -> float:
    marks = body.landmarks
    if not {"hip_r", "hip_l"} <= set(marks.names):
        return 0.0
    return 0.5 * float(np.linalg.norm(marks.points[marks.index("hip_r")] - marks.points[marks.index("hip_l")]))
