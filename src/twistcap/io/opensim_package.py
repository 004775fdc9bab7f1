"""The OpenSim package: model, markers, motion and set-ups of inverse kinematics and scaling, in one folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body, Landmarks, Pose, Posed
from twistcap.body.surface_markers import surface_markers
from twistcap.errors import check
from twistcap.io.files import write_lines
from twistcap.io.markers import WorldAxes, write_trc
from twistcap.io.motion_files import LOST_THROUGHOUT, opensim_names, write_mot
from twistcap.io.opensim_model import add_texts, document, marker_set, meshes, opensim_model
from twistcap.io.result import Result

_CENTRES = {"hip": "HJC", "knee": "KJC", "ankle": "AJC", "shoulder": "SJC", "elbow": "EJC", "wrist": "WJC"}
_STATIC = np.arange(10) / 60.0  # s; the rest pose as a static trial
# How bodies of a model with Rajagopal's names are scaled: axes, bodies of the right side, and pairs of markers.
_BOTH = "XYZ"
_MEASURES: Sequence[tuple[str, str, Sequence[str], Sequence[tuple[str, str]]]] = (
    ("pelvis_depth", "X", ("pelvis",), (("RASI", "RPSI"), ("LASI", "LPSI"))),
    ("pelvis_size", "YZ", ("pelvis",), (("RHJC", "LHJC"),)),
    ("torso_depth", "X", ("torso",), (("CLAV", "C7"),)),
    ("torso_height", "Y", ("torso",), (("C7", "RPSI"), ("C7", "LPSI"))),
    ("torso_width", "Z", ("torso",), (("RSJC", "LSJC"),)),
    ("thigh", _BOTH, ("femur", "patella"), (("HJC", "KJC"),)),
    ("shank", _BOTH, ("tibia",), (("KJC", "AJC"),)),
    ("foot", _BOTH, ("talus", "calcn", "toes"), (("CAL", "TOE"), ("CAL", "MT5"))),
    ("upper_arm", _BOTH, ("humerus",), (("SJC", "EJC"),)),
    ("forearm", _BOTH, ("ulna", "radius", "hand"), (("EJC", "FAradius"), ("EJC", "FAulna"))),
)


def write_opensim(folder: Path, result: Result, axes: WorldAxes = "opensim", fill: bool = False) -> None:
    """Writes the package into a folder, which is made if need be.

    ``model.osim`` is the fitted body, with ``Geometry`` and the surface markers of `body.surface_markers`;
    ``markers.xml`` these alone. ``markers.trc`` and ``joints.trc`` are the motion as points, ``angles.mot`` as
    coordinates of the model. Frames that are lost or unseen, without `fill`, are left out of the motion, since OpenSim
    stops there. ``ik.xml`` solves the motion again from the markers. ``scale.xml`` scales a generic model with
    Rajagopal's names, ``generic.osim``, to ``static.trc``, the rest pose. Raises InputError for a body that OpenSim
    cannot hold, or where a file cannot be written.
    """
    body, known = _named(result.body), result.known | fill
    check(str(folder), known.any(), LOST_THROUGHOUT)
    stuck, centres = surface_markers(body), _centres(body)
    model = opensim_model(body, stuck, axes)
    (folder / "Geometry").mkdir(parents=True, exist_ok=True)
    _write_xml(folder / "model.osim", model)
    _write_xml(folder / "markers.xml", document(marker_set(body, stuck)))
    for name, mesh in meshes(body).items():
        write_lines(folder / "Geometry" / f"{name}.obj", mesh.splitlines())
    write_mot(
        folder / "angles.mot", body, result.times, result.poses, axes, known=result.known, fill=fill,
        frames=result.indices,
    )  # fmt: skip
    shown = [pose for pose, there in zip(result.poses, known, strict=True) if there]
    for name, marks in {"markers": stuck, "joints": centres}.items():
        write_trc(folder / f"{name}.trc", result.times[known], marks.names, _moved(body, marks, shown), axes=axes)
    both = stuck.and_those(centres)
    standing = _moved(body, both, [Pose.rest(body)] * len(_STATIC))
    standing[..., 2] -= standing[..., 2].min()
    write_trc(folder / "static.trc", _STATIC, both.names, standing, axes=axes)
    _write_xml(folder / "ik.xml", _inverse_kinematics(stuck.names, result.times[known]))
    _write_xml(folder / "scale.xml", _scaling({*stuck.names, *centres.names}))


def _named(body: Body) -> Body:
    """The body with names that OpenSim takes; files are called after its segments."""
    parts, coordinates = opensim_names(body.segment_names), opensim_names(body.coordinate_names)
    return replace(body, name=opensim_names([body.name])[0], segment_names=parts, coordinate_names=coordinates)


def _centres(body: Body) -> Landmarks:
    """The body's landmarks; joint centres have Rajagopal's names."""
    marks = body.landmarks
    names = [_centre_name(name) for name in marks.names]
    return Landmarks(tuple(names), marks.segments, marks.points)


def _centre_name(mark: str) -> str:
    name, _, side = mark.rpartition("_")
    return side.upper() + _CENTRES[name] if name in _CENTRES else mark


def _moved(body: Body, marks: Landmarks, poses: Sequence[Pose]) -> Float:
    """(T, M, 3) places of the marks, m."""
    whole = np.ones((len(marks.names), 1))
    return np.stack([Posed(body, pose).points(marks.segments[:, None], whole, marks.points) for pose in poses])


def _inverse_kinematics(names: Sequence[str], times: Float) -> ET.Element:
    tool = ET.Element("InverseKinematicsTool", name="twistcap")
    add_texts(tool, {"model_file": "model.osim", "constraint_weight": "Inf", "accuracy": "1e-07"})
    _tasks(tool, names)
    files = {"marker_file": "markers.trc", "coordinate_file": "", "output_motion_file": "ik.mot"}
    add_texts(tool, {**files, "time_range": _span(times), "report_errors": "true", "results_directory": "."})
    return document(tool)


def _span(times: Float) -> str:
    return f"{float(times[0])!r} {float(times[-1])!r}"


def _tasks(parent: ET.Element, names: Sequence[str]) -> None:
    tasks = ET.SubElement(ET.SubElement(parent, "IKTaskSet"), "objects")
    for name in names:
        add_texts(ET.SubElement(tasks, "IKMarkerTask", name=name), {"apply": "true", "weight": "1"})


def _scaling(known: set[str]) -> ET.Element:
    """Scaling of a generic model by the distances of markers; its own markers are not moved."""
    tool = ET.Element("ScaleTool", name="twistcap")
    maker = ET.SubElement(tool, "GenericModelMaker")
    add_texts(maker, {"model_file": "generic.osim", "marker_set_file": "Unassigned"})
    scaler = ET.SubElement(tool, "ModelScaler")
    add_texts(scaler, {"apply": "true", "scaling_order": "measurements"})
    measured = ET.SubElement(ET.SubElement(scaler, "MeasurementSet"), "objects")
    for name, axes, bodies, pairs in _MEASURES:
        for side in ("",) if pairs[0][0] in known else ("R", "L"):
            sided = [(side + one, side + other) for one, other in pairs if {side + one, side + other} <= known]
            owners = [f"{body}_{side.lower()}" if side else body for body in bodies]
            if sided:
                measured.append(_measurement(f"{name}_{side.lower()}" if side else name, axes, owners, sided))
    files = {"marker_file": "static.trc", "output_model_file": "generic_scaled.osim"}
    add_texts(scaler, {**files, "time_range": _span(_STATIC), "preserve_mass_distribution": "true"})
    return document(tool)


def _measurement(name: str, axes: str, bodies: Sequence[str], pairs: Sequence[tuple[str, str]]) -> ET.Element:
    out = ET.Element("Measurement", name=name)
    add_texts(out, {"apply": "true"})
    of_pairs = ET.SubElement(ET.SubElement(out, "MarkerPairSet"), "objects")
    for pair in pairs:
        add_texts(ET.SubElement(of_pairs, "MarkerPair"), {"markers": " ".join(pair)})
    of_bodies = ET.SubElement(ET.SubElement(out, "BodyScaleSet"), "objects")
    for body in bodies:
        add_texts(ET.SubElement(of_bodies, "BodyScale", name=body), {"axes": " ".join(axes)})
    return out


def _write_xml(path: Path, whole: ET.Element) -> None:
    ET.indent(whole)
    write_lines(path, ['<?xml version="1.0" encoding="UTF-8"?>', ET.tostring(whole, encoding="unicode")])
