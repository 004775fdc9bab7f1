"""Motion capture systems: Qualisys' ``.qca.txt`` and Vicon's ``.xcp``. Both are XML, in mm."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from twistcap.arrays import Float
from twistcap.camera import Camera, Rig
from twistcap.doors.text import read_text
from twistcap.errors import InputError, check
from twistcap.io.calibration import made
from twistcap.io.cameras.parts import Asked, attribute, intrinsics, numbers, whole_size, without_fisheye
from twistcap.io.files import write_lines
from twistcap.io.opencv_storage import parsed_xml

_PARTS = 64.0  # of a pixel: Qualisys' unit in images
_FLIP = np.diag([1.0, -1.0, -1.0])  # Qualisys' cameras look along −z, y up
_LENS = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2", "radialDistortion3")


def read_qualisys(path: Path, asked: Asked) -> Rig:
    """The video cameras of a Qualisys calibration. The distortion is taken as written, which fits pictures best.

    Raises InputError: for a damaged file, turned views, or no video camera.
    """
    root, source = _root(path), f"calibration {path}"
    cameras = [_qualisys(element, source, asked) for element in root.findall("cameras/camera") if _is_video(element)]
    check(source, cameras, "it holds no video camera; is it a .qca.txt of Qualisys?")
    return Rig(tuple(cameras))


def write_qualisys(rig: Rig, path: Path) -> None:
    """A ``.qca.txt``; mm."""
    without_fisheye(rig, "a .qca.txt")
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<calibration type="regular" source="twistcap">', "<cameras>"]
    for c in rig:
        R, x = _FLIP @ c.T_cam_world[:3, :3], 1e3 * c.centre
        turn = " ".join(f'r{i + 1}{j + 1}="{float(R[i, j])!r}"' for i in range(3) for j in range(3))
        place = " ".join(f'{axis}="{float(x[k])!r}"' for k, axis in enumerate("xyz"))
        K = _PARTS * c.K
        inner = {"focalLengthU": K[0, 0], "focalLengthV": K[1, 1], "centerPointU": K[0, 2], "centerPointV": K[1, 2]}
        pinhole = " ".join(f'{key}="{float(value)!r}"' for key, value in inner.items())
        lens = " ".join(f'{name}="{float(c.dist[k])!r}"' for k, name in enumerate(_LENS))
        view = f'left="0" top="0" right="{c.size[0] - 1}" bottom="{c.size[1] - 1}"'
        lines += [
            f'<camera active="1" avg-residual="0" serial={quoteattr(c.name)} model="video" viewrotation="0">',
            f"<fov_video {view}/>",
            f"<transform {place} {turn}/>",
            f'<intrinsic {pinhole} skew="0" {lens}/>',
            "</camera>",
        ]
    write_lines(path, [*lines, "</cameras>", "</calibration>"])


def read_vicon(path: Path, asked: Asked) -> Rig:
    """The cameras of a Vicon ``.xcp``: video cameras, or all where none is one. Raises InputError.

    Vicon's radial model takes pixels as they are to pixels without distortion, ``r (1 + k1 r² + k2 r⁴)`` about the
    principal point, px; it is turned round and fitted by OpenCV's k1, k2, k3.
    """
    root, source = _root(path), f"calibration {path}"
    every = root.findall("Camera")
    video = [e for e in every if "video" in e.attrib.get("TYPE", "").lower()] or every
    check(source, video, "it holds no camera; is it an .xcp of Vicon?")
    return Rig(tuple(_vicon(element, source, asked) for element in video))


def write_vicon(rig: Rig, path: Path) -> None:
    """An ``.xcp``; mm. Raises InputError for a lens that Vicon's radial model cannot say."""
    without_fisheye(rig, "an .xcp")
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<Cameras SOURCE="twistcap">']
    for c in rig:
        if np.any(c.dist[2:4]):
            raise InputError(
                f"camera {c.name!r} has tangential distortion, which an .xcp cannot say; choose another format."
            )
        q = " ".join(repr(float(x)) for x in Rotation.from_matrix(c.T_cam_world[:3, :3]).as_quat())
        x = " ".join(repr(float(v)) for v in 1e3 * c.centre)
        k = " ".join(repr(float(v)) for v in _to_vicon(c))
        lines += [
            f'<Camera DEVICEID={quoteattr(c.name)} TYPE="Video" SENSOR_SIZE="{c.size[0]} {c.size[1]}"'
            f' PIXEL_ASPECT_RATIO="{float(c.K[0, 0] / c.K[1, 1])!r}"><KeyFrames>',
            f'<KeyFrame FOCAL_LENGTH="{float(c.K[0, 0])!r}" PRINCIPAL_POINT="{float(c.K[0, 2])!r} {float(c.K[1, 2])!r}"'
            f' ORIENTATION="{q}" POSITION="{x}" VICON_RADIAL2="ViconRadial2 0 0 {k} 0" WORLD_ERROR="0"/>',
            "</KeyFrames></Camera>",
        ]
    write_lines(path, [*lines, "</Cameras>"])


def _root(path: Path) -> Element:
    return parsed_xml(read_text(path).lstrip("\ufeff \n\r\t"), f"calibration {path}")


def _is_video(element: Element) -> bool:
    model = element.attrib.get("model", "").lower()
    return "video" in model or model == "none" or element.attrib.get("type", "").lower() == "video"


def _qualisys(element: Element, source: str, asked: Asked) -> Camera:
    name = attribute(source, element.attrib, "serial")
    where = f"{source}, camera {name!r}"
    turned = element.attrib.get("viewrotation", "0")
    check(where, turned in ("0", ""), f"its view is turned by {turned} degrees; export the video and it upright")
    theia = "Theia3D's own are not read, but the Qualisys or Vicon file that it was given"
    check(where, element.find("fov_video") is not None, f"<fov_video> is missing; {theia} is")
    view, lens, place = (_child(where, element, tag) for tag in ("fov_video", "intrinsic", "transform"))
    left, top, right, bottom = (_number(where, view, side) for side in ("left", "top", "right", "bottom"))
    keys = ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
    fx, fy, cx, cy = (_number(where, lens, key) / _PARTS for key in keys)
    dist = np.array([_number(where, lens, key) for key in _LENS])
    R = np.array([[_number(where, place, f"r{i}{j}") for j in (1, 2, 3)] for i in (1, 2, 3)])
    centre = asked.metres(1e-3) * np.array([_number(where, place, axis) for axis in "xyz"])
    turn = _FLIP @ R
    size = whole_size(where, right - left + 1, bottom - top + 1)
    return made(where, name, intrinsics(fx, fy, cx - left, cy - top), (turn, -turn @ centre), size, dist)


def _vicon(element: Element, source: str, asked: Asked) -> Camera:
    name = attribute(source, element.attrib, "DEVICEID")
    where = f"{source}, camera {name!r}"
    key = element.find("KeyFrames/KeyFrame")
    if key is None:
        raise InputError(f"{where}: it has no KeyFrame, so it is not calibrated; calibrate it, or remove it.")
    focal = _number(where, key, "FOCAL_LENGTH")
    aspect = float(numbers(where, [element.attrib.get("PIXEL_ASPECT_RATIO", "1")], 1)[0])
    check(where, aspect > 0, "its PIXEL_ASPECT_RATIO must be above 0")
    cx, cy = _list(where, key, "PRINCIPAL_POINT", 2)
    size = whole_size(where, *_list(where, element, "SENSOR_SIZE", 2))
    q = _list(where, key, "ORIENTATION", 4)
    check(where, 0.9 < float(np.linalg.norm(q)) < 1.1, "its ORIENTATION is no quaternion of length 1")
    turn = np.asarray(Rotation.from_quat(q).as_matrix(), dtype=float)
    centre = asked.metres(1e-3) * _list(where, key, "POSITION", 3)
    check(where, focal > 0, "its FOCAL_LENGTH must be above 0")
    dist = _from_vicon(_radial(where, key), focal, size)
    return made(where, name, intrinsics(focal, focal / aspect, cx, cy), (turn, -turn @ centre), size, dist)


def _radial(where: str, key: Element) -> Float:
    """k1 and k2 of Vicon's model, 1/px² and 1/px⁴."""
    if "VICON_RADIAL2" in key.attrib:
        words = key.attrib["VICON_RADIAL2"].split()
        check(where, len(words) >= 5, "its VICON_RADIAL2 has fewer than 5 entries")
        return numbers(where, words[3:5], 2)
    return numbers(where, key.attrib.get("VICON_RADIAL", "0 0").split()[:2], 2)


def _from_vicon(k: Float, focal: float, size: tuple[int, int]) -> Float:
    """(5,) OpenCV's distortion that undoes Vicon's correction, over the image."""
    seen = np.linspace(0.0, 0.55 * float(np.hypot(*size)), 200)[1:]
    straight = seen * (1.0 + k[0] * seen**2 + k[1] * seen**4) / focal
    rows = np.stack([straight**3, straight**5, straight**7], axis=1)
    k1, k2, k3 = np.linalg.lstsq(rows, seen / focal - straight, rcond=None)[0]
    return np.array([k1, k2, 0.0, 0.0, k3])


def _to_vicon(camera: Camera) -> Float:
    """(2,) Vicon's correction that undoes the camera's radial distortion, over its image."""
    focal = float(camera.K[0, 0])
    straight = np.linspace(0.0, 0.55 * float(np.hypot(*camera.size)) / focal, 200)[1:]
    k1, k2, _, _, k3 = camera.dist
    seen = focal * straight * (1.0 + k1 * straight**2 + k2 * straight**4 + k3 * straight**6)
    rows = np.stack([seen**3, seen**5], axis=1)
    scale = np.abs(rows).max(axis=0)
    return np.linalg.lstsq(rows / scale, focal * straight - seen, rcond=None)[0] / scale


def _child(where: str, element: Element, tag: str) -> Element:
    child = element.find(tag)
    if child is None:
        raise InputError(f"{where}: <{tag}> is missing; export the calibration again.")
    return child


def _list(where: str, element: Element, key: str, count: int) -> Float:
    return numbers(f"{where}, {key}", attribute(where, element.attrib, key).split(), count)


def _number(where: str, element: Any, key: str) -> float:
    return float(numbers(f"{where}, {key}", [element.attrib.get(key, "0" if key in _LENS else None)], 1)[0])
