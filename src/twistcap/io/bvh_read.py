"""BVH in. The text is parsed by pybvh; what is ours is the unit, which the format does not state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pybvh

from twistcap.arrays import Float
from twistcap.errors import InputError
from twistcap.motion.skeleton import SkeletonMotion, Up

# Metres per unit that BVH files come in: metres, CMU's (inches / 0.45), inches, centimetres, millimetres.
UNITS = (1.0, 0.0254 / 0.45, 0.0254, 0.01, 0.001)
_ADULT = 1.65  # m; both the height and the span of the arms are near it


def read_bvh(path: Path | str, unit: float | None = None, up: Up | None = None) -> SkeletonMotion:
    """The motion of a BVH; end sites become joints named after theirs, `<joint>_end`.

    Args:
        path: the file.
        unit: metres per unit of the file; None takes that of `UNITS` which makes an adult of the rest pose.
        up: the vertical axis; None takes the one along which the rest pose is drawn.

    Raises InputError if it cannot be read or is no BVH with three rotations a joint, or for numbers that are not
    finite.
    """
    path = Path(path)
    try:
        bvh: Any = pybvh.read_bvh_file(path, warn_on_world_up_disagreement=False)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except Exception as error:  # pybvh raises what its parsing stumbles over: ValueError, IndexError, …
        raise InputError(f"{path}: not a BVH that can be read ({error}).") from error
    tree = bvh.fk_topology
    offsets: Float = np.asarray(tree.offsets, dtype=float)
    places, turns = bvh.to_rotmat()
    moving = np.asarray(tree.joint_idx)
    local = np.where(moving[:, None, None] >= 0, turns[:, moving], np.eye(3))
    scale = unit if unit is not None else _unit(path, _rest(offsets, tree.parent_idx))
    upright = up or ("z" if str(bvh.rest_up).endswith("z") else "y")
    # The root's own offset is not added to its channels, as in Blender and pybvh.
    return SkeletonMotion.from_local(
        path.stem, _names(bvh, tree), list(tree.parent_idx), offsets * scale, local, places * scale, bvh.fps, upright
    )


def _names(bvh: Any, tree: Any) -> list[str]:
    names = [str(node.name) for node in bvh.nodes]
    for s, joint in enumerate(tree.joint_idx):
        if joint < 0:
            names[s] = f"{names[tree.parent_idx[s]]}_end"
    return names


def _rest(offsets: Float, parents: Any) -> Float:
    out = offsets.copy()
    for s in range(1, len(out)):
        out[s] += out[parents[s]]
    return out


def _unit(path: Path, rest: Float) -> float:
    size = float(np.ptp(rest, axis=0).max())
    if not (np.isfinite(size) and size > 0):
        raise InputError(f"{path}: its joints have no distances between them.")
    return min(UNITS, key=lambda unit: abs(np.log(unit * size / _ADULT)))
