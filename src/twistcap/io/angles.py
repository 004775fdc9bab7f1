"""One rotation in two orders: conversion between our poses and OpenSim's coordinates.

OpenSim's full-body models (Rajagopal et al. 2016, DOI 10.1109/TBME.2016.2586891) turn the pelvis about z (tilt), x
(list), y (rotation) and the arm by flexion, adduction, rotation. Our arm turns by adduction first, so that its gimbal
lock is away from the T pose; its axes are the same. Our pronation is 0 with the thumb forward, OpenSim's with the palm
forward, where it is −90° of ours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body

PELVIS_ANGLES = ("pelvis_tilt", "pelvis_list", "pelvis_rotation")
PELVIS_PLACE = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
PELVIS_AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # in OpenSim's frame
REST_TO_OPENSIM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # (x, y, z) -> (x, z, −y)
_LOCKED = 1e-9  # determinant of three axes below which their angles are not defined
# Rajagopal's hip centres in the pelvis frame, whose origin is between the front iliac spines, m.
_HIP = np.array([-0.056276, -0.07849, 0.07726])


def product(angles: Float, axes: Float) -> Float:
    """Rotations (T, 3, 3) by three angles (T, 3) rad about three axes (3, 3; one a row), the first outermost."""
    first, second, third = (se3.exp_rotation(angles[:, k, None] * axes[k]) for k in range(3))
    return first @ second @ third


def spins(angles: Float, axes: Float) -> Float:
    """(T, 3, 3) from the rates of the angles to the angular velocity of ``product(angles, axes)``, outer frame."""
    first, second = (se3.exp_rotation(angles[:, k, None] * axes[k]) for k in range(2))
    return np.stack([np.broadcast_to(axes[0], (len(angles), 3)), first @ axes[1], first @ second @ axes[2]], axis=2)


def rates(angles: Float, axes: Float) -> Float:
    """(T, 3, 3) the inverse of `spins`; huge, but finite, at a gimbal lock."""
    spinning = spins(angles, axes)
    spinning[np.abs(np.linalg.det(spinning)) < _LOCKED] = _LOCKED * np.eye(3)
    return np.asarray(np.linalg.inv(spinning), np.float64)


def decomposed(rotations: Float, axes: Float, near: Float) -> Float:
    """Angles (T, 3) with ``product(angles, axes) == rotations`` (T, 3, 3), continuous in time.

    `axes` (3, 3) are orthonormal, one a row, right- or left-handed; those of the first frame are chosen near `near`
    (3,).
    """
    hand = np.sign(np.linalg.det(axes))
    R = axes @ rotations @ axes.T  # about x, y, z now, backwards if left-handed
    out = np.zeros((len(R), 3))
    for t in range(len(R)):
        out[t] = nearest(hand * _xyz_angles(R[t], hand * (near[0] if t == 0 else out[t - 1, 0])), near)
        near = out[t]
    return out


def _xyz_angles(R: Float, first_if_locked: float) -> Float:
    middle = np.arctan2(R[0, 2], np.hypot(R[0, 0], R[0, 1]))
    if np.hypot(R[0, 0], R[0, 1]) > 1e-7:
        return np.array([np.arctan2(-R[1, 2], R[2, 2]), middle, np.arctan2(-R[0, 1], R[0, 0])])
    # Gimbal lock: only the sum (or difference) of the outer angles is known; the first keeps its value.
    both = np.arctan2(R[1, 0], R[1, 1])
    return np.array([first_if_locked, middle, both - np.sign(R[0, 2]) * first_if_locked])


def nearest(angles: Float, near: Float) -> Float:
    """Of the two solutions for one rotation (..., 3), each up to whole turns, the one nearest to given angles."""
    both = np.stack([angles, angles * [1.0, -1.0, 1.0] + np.pi])
    both -= 2 * np.pi * np.round((both - near) / (2 * np.pi))
    first, second = np.sum((both - near) ** 2, axis=-1, keepdims=True)
    return np.where(first <= second, both[0], both[1])


def pelvis_point(body: Body) -> Float:
    """(3,) rest-pose place of OpenSim's pelvis origin: from the hip centres, at the offset of Rajagopal's pelvis.

    The rest frame's origin for a body without landmarks hip_r and hip_l.
    """
    marks = body.landmarks
    if not {"hip_r", "hip_l"} <= set(marks.names):
        return np.zeros(3)
    right, left = marks.points[marks.index("hip_r")], marks.points[marks.index("hip_l")]
    size = np.linalg.norm(right - left) / (2 * _HIP[2])
    offset = REST_TO_OPENSIM.T @ np.array([_HIP[0], _HIP[1], 0.0])
    return 0.5 * (right + left) - size * offset


def pelvis_coordinates(roots: Float, point: Float, to_file: Float) -> tuple[Float, Float]:
    """Tilt, list, rotation (T, 3) rad and place (T, 3) m of the pelvis, of root motions (T, 4, 4).

    `point` (3,) is that of `pelvis_point`; `to_file` (3, 3) leads from our world's axes to the file's.
    """
    R = to_file @ roots[:, :3, :3] @ REST_TO_OPENSIM.T
    return decomposed(R, PELVIS_AXES, np.zeros(3)), se3.apply(roots, point[None])[:, 0] @ to_file.T


def pelvis_roots(angles: Float, place: Float, point: Float, to_file: Float) -> Float:
    """Root motions (T, 4, 4): the inverse of `pelvis_coordinates`."""
    R = to_file.T @ product(angles, PELVIS_AXES) @ REST_TO_OPENSIM
    return se3.transform(R, place @ to_file - R @ point)


def shoulders_of(body: Body) -> list[tuple[list[int], list[int]]]:
    """For each shoulder of three square axes: its coordinates in the body's order and in OpenSim's (flex, add, rot)."""
    groups: list[tuple[list[int], list[int]]] = []
    for side in ("_r", "_l"):
        names = [f"arm_{part}{side}" for part in ("flex", "add", "rot")]
        if not set(names) <= set(body.coordinate_names):
            continue
        opensim = [body.coordinate(name) for name in names]
        axes = body.twists[opensim, :3]
        if np.allclose(axes @ axes.T, np.eye(3), atol=1e-6):
            groups.append((sorted(opensim), opensim))
    return groups


def complete_coordinates(body: Body, names: Sequence[str]) -> tuple[str, ...]:
    """The body's coordinates that a file in OpenSim's order has: those of a shoulder only where all three are there."""
    ours = body.coordinate_names
    torn = {ours[k] for trio, _ in shoulders_of(body) if not {ours[k] for k in trio} <= set(names) for k in trio}
    return tuple(name for name in ours if name in names and name not in torn)


def zeros_of(body: Body) -> Float:
    """(J,) rad to add to our coordinates for OpenSim's: its pronation starts with the palm forward."""
    return np.array([np.pi / 2 if name.startswith("pro_sup_") else 0.0 for name in body.coordinate_names])


def reordered(body: Body, q: Float, start: Sequence[int], end: Sequence[int]) -> Float:
    """Angles (T, J) with the three coordinates `start`, in their order, expressed in the order `end` instead."""
    axes = body.twists[:, :3]
    out = q.copy()
    rotations = product(q[:, list(start)], axes[list(start)])
    out[:, list(end)] = decomposed(rotations, axes[list(end)], q[0, list(end)] if len(q) else np.zeros(3))
    return out
