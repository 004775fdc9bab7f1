"""How far calibrated cameras are from the true ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.camera import Rig


def errors(found: Rig, true: Rig) -> Float:
    """(C, 3) error of the focal length in %, of the rotation in degrees, of the centre in mm."""
    rows = list[list[float]]()
    for a, b in zip(found, true, strict=True):
        turn = se3.log_rotation(a.T_cam_world[:3, :3] @ b.T_cam_world[:3, :3].T)
        focal = 100 * abs(np.sqrt(a.K[0, 0] * a.K[1, 1] / (b.K[0, 0] * b.K[1, 1])) - 1)
        rows.append([focal, float(np.rad2deg(np.linalg.norm(turn))), 1e3 * float(np.linalg.norm(a.centre - b.centre))])
    return np.array(rows)


def aligned(found: Rig, true: Rig) -> Rig:
    """The rig, moved as a whole so that rotations and centres fit the true ones best."""
    turn = np.sum([b.T_cam_world[:3, :3].T @ a.T_cam_world[:3, :3] for a, b in zip(found, true, strict=True)], axis=0)
    U, _, Vt = np.linalg.svd(turn)
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    shift = np.mean([b.centre - R @ a.centre for a, b in zip(found, true, strict=True)], axis=0)
    back = se3.inverse(se3.transform(R, shift))
    return Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ back) for c in found))
