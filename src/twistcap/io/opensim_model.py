"""The fitted body as an OpenSim model: its segments, joints, coordinates, surface and markers.

Bodies have OpenSim's axes in the rest pose and their origin in the upper joint; the pelvis has it between the front
spines. Coordinates are those of the MOT (`io.coordinates`), so that the motion plays on the model as it is. Masses are
those of water in each segment's hull, together in the whole surface: a start for dynamics, no measurement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from twistcap.arrays import Float
from twistcap.body import Body, Landmarks
from twistcap.body.joints import Joint, joints_of
from twistcap.errors import InputError
from twistcap.io import angles as convert
from twistcap.io.markers import TO_FILE, WorldAxes

_WATER = 1000.0  # kg/m³
_GRAVITY = np.array([0.0, 0.0, -9.80665])  # m/s², in our world
_SPECK = 0.01  # kg; a body without a surface of its own
_FREE = 99.0  # m or rad, either way: coordinates of the root are not limited
_ROUND = 2 * np.pi  # rad


def opensim_model(body: Body, marks: Landmarks, axes: WorldAxes = "opensim") -> ET.Element:
    """The document of a model with the markers of `marks`. Each segment's surface is the mesh ``<segment>.obj``.

    Raises InputError for a body that OpenSim cannot hold: sliding coordinates, four or more axes through a point.
    """
    joints = joints_of(body)
    origins = _origins(body, joints)
    model = ET.Element("Model", name=body.name)
    units = {"length_units": "meters", "force_units": "N", "gravity": _numbers(TO_FILE[axes] @ _GRAVITY)}
    add_texts(model, {"credits": "Made by twistcap of a tracked body.", **units})
    bodies, joined = _set(model, "BodySet", "bodyset"), _set(model, "JointSet", "jointset")
    masses = _masses(body, joints, origins)
    for n, joint in enumerate(joints):
        bodies.append(_body(joint, masses[n], joint.name == body.segment_names[joint.segment]))
        joined.append(_joint(body, joints, n, origins))
    model.append(marker_set(body, marks))
    return document(model)


def marker_set(body: Body, marks: Landmarks) -> ET.Element:
    """The markers, each fixed to the body of its segment."""
    joints = joints_of(body)
    origins = {j.name: at for j, at in zip(joints, _origins(body, joints), strict=True)}
    out = ET.Element("MarkerSet", name="markerset")
    objects = ET.SubElement(out, "objects")
    for name, segment, point in zip(marks.names, marks.segments, marks.points, strict=True):
        owner = body.segment_names[segment]
        marker = ET.SubElement(objects, "Marker", name=name)
        place = _numbers(convert.REST_TO_OPENSIM @ (point - origins[owner]))
        add_texts(marker, {"socket_parent_frame": f"/bodyset/{owner}", "location": place, "fixed": "true"})
    return out


def meshes(body: Body) -> dict[str, str]:
    """The surface of each segment as an OBJ in the axes of its OpenSim body."""
    joints = joints_of(body)
    out = dict[str, str]()
    for joint, origin in zip(joints, _origins(body, joints), strict=True):
        faces = body.faces[body.face_part == joint.segment]
        if joint.name == body.segment_names[joint.segment] and len(faces):
            used, corners = np.unique(faces, return_inverse=True)
            points = (body.vertices[used] - origin) @ convert.REST_TO_OPENSIM.T
            lines = [f"v {_numbers(point)}" for point in points]
            lines += [f"f {a} {b} {c}" for a, b, c in corners.reshape(-1, 3) + 1]
            out[joint.name] = "\n".join(lines) + "\n"
    return out


def _origins(body: Body, joints: Sequence[Joint]) -> list[Float]:
    """(3,) rest-pose origin of each OpenSim body, m."""
    return [joint.origin if joint.parent >= 0 else convert.pelvis_point(body) for joint in joints]


def _body(joint: Joint, mass: tuple[float, Float, Float], whole: bool) -> ET.Element:
    out = ET.Element("Body", name=joint.name)
    if whole:
        mesh = ET.SubElement(ET.SubElement(out, "attached_geometry"), "Mesh", name=f"{joint.name}_surface")
        add_texts(mesh, {"socket_frame": "..", "mesh_file": f"{joint.name}.obj"})
    kilogram, centre, inertia = mass
    six = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    add_texts(out, {"mass": _numbers([kilogram]), "mass_center": _numbers(centre), "inertia": _numbers(six)})
    return out


def _joint(body: Body, joints: Sequence[Joint], number: int, origins: Sequence[Float]) -> ET.Element:
    joint = joints[number]
    if joint.parent < 0:
        return _root_joint(joint)
    above = joints[joint.parent]
    out = ET.Element("CustomJoint", name=f"{joint.name}_joint")
    order, zeros = _order(body, joint), convert.zeros_of(body)
    at = convert.REST_TO_OPENSIM @ (origins[number] - origins[joint.parent])
    _frames(out, above.name, joint.name, f"/bodyset/{above.name}", at)
    coordinates = ET.SubElement(out, "coordinates")
    for k in order:
        low, high = body.limits[k] + zeros[k]
        if len(order) == 3 and body.coordinate_names[k].startswith("arm_"):  # our limits are of another order
            low, high = -_ROUND, _ROUND
        _coordinate(coordinates, body.coordinate_names[k], float(zeros[k]), float(low), float(high))
    turning = [(body.coordinate_names[k], convert.REST_TO_OPENSIM @ body.twists[k, :3], -zeros[k]) for k in order]
    _spatial(out, turning, [])
    return out


def _order(body: Body, joint: Joint) -> Sequence[int]:
    """The coordinates as OpenSim turns them."""
    if len(joint.coordinates) > 3:
        raise InputError(
            f"body {body.name!r}: joint {joint.name!r} has more than three axes, which OpenSim cannot hold."
        )
    orders = {tuple(ours): opensim for ours, opensim in convert.shoulders_of(body)}
    return orders.get(joint.coordinates, joint.coordinates)


def _root_joint(joint: Joint) -> ET.Element:
    out = ET.Element("CustomJoint", name=f"ground_{joint.name}")
    _frames(out, "ground", joint.name, "/ground", np.zeros(3))
    coordinates = ET.SubElement(out, "coordinates")
    for name in (*convert.PELVIS_ANGLES, *convert.PELVIS_PLACE):
        _coordinate(coordinates, name, 0.0, -_FREE, _FREE)
    turning = [(name, axis, 0.0) for name, axis in zip(convert.PELVIS_ANGLES, convert.PELVIS_AXES, strict=True)]
    _spatial(out, turning, convert.PELVIS_PLACE)
    return out


def _frames(joint: ET.Element, above: str, below: str, parent: str, at: Float) -> None:
    add_texts(joint, {"socket_parent_frame": f"{above}_offset", "socket_child_frame": f"{below}_origin"})
    frames = ET.SubElement(joint, "frames")
    for name, owner, place in ((f"{above}_offset", parent, at), (f"{below}_origin", f"/bodyset/{below}", np.zeros(3))):
        frame = ET.SubElement(frames, "PhysicalOffsetFrame", name=name)
        add_texts(frame, {"socket_parent": owner, "translation": _numbers(place), "orientation": "0 0 0"})


def _coordinate(parent: ET.Element, name: str, default: float, low: float, high: float) -> None:
    out = ET.SubElement(parent, "Coordinate", name=name)
    add_texts(out, {"default_value": _numbers([default]), "range": _numbers([low, high]), "clamped": "false"})


def _spatial(joint: ET.Element, turning: Sequence[tuple[str, Float, float]], moving: Sequence[str]) -> None:
    """Rotations about up to three axes, each (coordinate, axis, angle at 0), and translations along x, y and z."""
    out = ET.SubElement(joint, "SpatialTransform")
    for n, axis in enumerate(_three([axis for _, axis, _ in turning])):
        name, _, start = turning[n] if n < len(turning) else ("", axis, 0.0)
        _transform_axis(out, f"rotation{n + 1}", name, axis, start)
    for n, axis in enumerate(np.eye(3)):
        _transform_axis(out, f"translation{n + 1}", moving[n] if moving else "", axis, 0.0)


def _three(axes: Sequence[Float]) -> list[Float]:
    """The axes and, for those that are missing, others that are square to them."""
    out = list(axes)
    while len(out) < 3:
        across = [np.cross(out[0], other) for other in (out[1:] or np.eye(3))] if out else list(np.eye(3))
        longest = max(across, key=lambda v: float(np.linalg.norm(v)))
        out.append(longest / np.linalg.norm(longest))
    return out


def _transform_axis(parent: ET.Element, name: str, coordinate: str, axis: Float, start: float) -> None:
    out = ET.SubElement(parent, "TransformAxis", name=name)
    add_texts(out, {"coordinates": coordinate, "axis": _numbers(axis)})
    moving = ("LinearFunction", {"coefficients": _numbers([1.0, start])})
    kind, texts = moving if coordinate else ("Constant", {"value": "0"})
    add_texts(ET.SubElement(out, kind, name="function"), texts)


def _masses(body: Body, joints: Sequence[Joint], origins: Sequence[Float]) -> list[tuple[float, Float, Float]]:
    """Mass kg, centre (3,) m and inertia (3, 3) kg m² about it of each OpenSim body, in its axes."""
    out = [_speck()] * len(joints)
    for n, (joint, origin) in enumerate(zip(joints, origins, strict=True)):
        points = body.vertices[body.vertex_part == joint.segment]
        if joint.name == body.segment_names[joint.segment]:
            out[n] = _solid((points - origin) @ convert.REST_TO_OPENSIM.T)
    corners = body.vertices[body.faces]
    whole = _WATER * float(np.sum(np.linalg.det(corners))) / 6.0
    if whole <= 0:
        raise InputError(
            f"body {body.name!r}: its faces look inward, so that it has no volume; turn their corners round."
        )
    share = whole / sum(mass for mass, _, _ in out)
    return [(share * mass, centre, share * inertia) for mass, centre, inertia in out]


def _speck() -> tuple[float, Float, Float]:
    return _SPECK, np.zeros(3), 1e-5 * np.eye(3)


def _solid(points: Float) -> tuple[float, Float, Float]:
    """Of the hull of points (N, 3), filled with water: by tetrahedra from the mean point."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # too few points, or all in a plane
        return _speck()
    middle = points.mean(axis=0)
    corners = points[hull.simplices] - middle
    volumes = np.abs(np.linalg.det(corners)) / 6.0
    sums = corners.sum(axis=1)
    centre = volumes @ sums / (4.0 * volumes.sum())
    squares = np.einsum("tki,tkj->tij", corners, corners) + np.einsum("ti,tj->tij", sums, sums)
    second = np.einsum("t,tij->ij", volumes, squares) / 20.0 - volumes.sum() * np.outer(centre, centre)
    inertia = np.trace(second) * np.eye(3) - second
    mass = _WATER * float(volumes.sum())
    return (mass, middle + centre, _WATER * inertia) if mass > _SPECK else _speck()


def _set(model: ET.Element, kind: str, name: str) -> ET.Element:
    return ET.SubElement(ET.SubElement(model, kind, name=name), "objects")


def document(child: ET.Element) -> ET.Element:
    """An OpenSim file of one object."""
    out = ET.Element("OpenSimDocument", Version="40000")
    out.append(child)
    return out


def add_texts(parent: ET.Element, texts: Mapping[str, str]) -> None:
    """An element for each text, by tag."""
    for tag, text in texts.items():
        ET.SubElement(parent, tag).text = text


def _numbers(values: Sequence[float] | Float) -> str:
    return " ".join(f"{value:.10g}" for value in values)
