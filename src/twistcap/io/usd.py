"""USD with UsdSkel: the skinned body and its motion, written by OpenUSD (usd-core).

Space is that of a GLB of ours: y up, facing +z, m. There is one joint for each segment, at its proximal joint; in the
rest pose, which is the bind pose, joints have no rotation. A time code is a frame of the recording's rate; frames that
were dropped have none. Names that USD does not allow are changed; the skeleton's ``jointNames`` has them as they are.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.body import Body
from twistcap.body._gltf_buffers import TO_REST
from twistcap.body.gltf_write import local_motions
from twistcap.errors import InputError
from twistcap.io.files import replacing
from twistcap.io.playback import Playback

_PARTS = ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdSkel", "Vt")
_GREY = 0.8


def write_usd(path: Path | str, body: Body, played: Playback) -> None:
    """Write ``/person`` (SkelRoot) with ``body`` (Mesh), ``skeleton`` and ``motion`` (SkelAnimation with a sample for
    each frame, whose custom data ``twistcap`` hold `Playback.flags`). Raises InputError where usd-core is not
    installed, or if the file cannot be written."""
    pxr = _pxr()
    stage = pxr.Usd.Stage.CreateInMemory()
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.y)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    rate = round(played.rate, 6)
    codes = np.round(played.times * rate, 6)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(float(codes[0]))
    stage.SetEndTimeCode(float(codes[-1]))
    root = pxr.UsdSkel.Root.Define(stage, "/person")
    stage.SetDefaultPrim(root.GetPrim())
    joints = _joint_paths(pxr, body)
    skeleton = _add_skeleton(pxr, stage, body, joints)
    motion = _add_motion(pxr, stage, body, joints, played, codes)
    pxr.UsdSkel.BindingAPI.Apply(skeleton).CreateAnimationSourceRel().SetTargets([motion.GetPath()])
    pxr.UsdSkel.BindingAPI.Apply(_add_mesh(pxr, stage, body)).CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    with replacing(path) as part:
        part.touch()  # an error of the disk is told by Python, not by USD
        stage.GetRootLayer().Export(str(part))


def _pxr() -> Any:
    """USD's modules, by name."""
    try:
        return SimpleNamespace(**{name: import_module(f"pxr.{name}") for name in _PARTS})
    except ImportError as error:
        raise InputError("USD needs usd-core; install it with: pip install 'twistcap[usd]'.") from error


def _joint_paths(pxr: Any, body: Body) -> list[str]:
    """Each joint below the one above it, such as ``pelvis/femur_r``, all different."""
    paths = list[str]()
    for name, above in zip(body.segment_names, body.segment_parent, strict=True):
        start = f"{paths[above]}/" if above >= 0 else ""
        plain = start + pxr.Tf.MakeValidIdentifier(name)
        paths.append(plain if plain not in paths else f"{plain}_{len(paths)}")
    return paths


def _add_skeleton(pxr: Any, stage: Any, body: Body, joints: list[str]) -> Any:
    skeleton = pxr.UsdSkel.Skeleton.Define(stage, "/person/skeleton")
    origins, above = body.joint_origins @ TO_REST, body.segment_parent
    offsets = origins - np.where((above >= 0)[:, None], origins[above], 0.0)
    skeleton.CreateJointsAttr(joints)
    skeleton.CreateJointNamesAttr(list(body.segment_names))
    for create, places in (
        (skeleton.CreateBindTransformsAttr, origins), (skeleton.CreateRestTransformsAttr, offsets),
    ):  # fmt: skip
        create(
            pxr.Vt.Matrix4dArray([pxr.Gf.Matrix4d().SetTranslate(pxr.Gf.Vec3d(*place)) for place in places.tolist()])
        )
    return skeleton.GetPrim()


def _add_mesh(pxr: Any, stage: Any, body: Body) -> Any:
    """The surface, with the bindings of all its vertices."""
    mesh, K = pxr.UsdGeom.Mesh.Define(stage, "/person/body"), body.skin_weights.shape[1]
    points = _vectors(pxr, body.vertices @ TO_REST)
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(pxr.UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateFaceVertexCountsAttr([3] * len(body.faces))
    mesh.CreateFaceVertexIndicesAttr(_numbers(pxr.Vt.IntArray, body.faces, np.int32))
    mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([pxr.Gf.Vec3f(_GREY)])
    binding = pxr.UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateGeomBindTransformAttr(pxr.Gf.Matrix4d(1.0))
    held = np.where(body.skin_weights > 0, body.skin_segments, 0)
    binding.CreateJointIndicesPrimvar(False, K).Set(_numbers(pxr.Vt.IntArray, held, np.int32))
    binding.CreateJointWeightsPrimvar(False, K).Set(_numbers(pxr.Vt.FloatArray, body.skin_weights, np.float32))
    return mesh.GetPrim()


def _add_motion(pxr: Any, stage: Any, body: Body, joints: list[str], played: Playback, codes: Float) -> Any:
    motion = pxr.UsdSkel.Animation.Define(stage, "/person/motion")
    motion.CreateJointsAttr(joints)
    motion.CreateScalesAttr([pxr.Gf.Vec3h(1.0)] * len(joints))
    turns, places = motion.CreateRotationsAttr(), motion.CreateTranslationsAttr()
    rotations, translations = local_motions(body, body.joint_origins, played.poses)
    for code, rotation, translation in zip(codes.tolist(), rotations, translations, strict=True):
        turns.Set(pxr.Vt.QuatfArray([pxr.Gf.Quatf(w, x, y, z) for x, y, z, w in rotation.tolist()]), code)
        places.Set(_vectors(pxr, translation), code)
    spans = played.flags | {"lost": pxr.Vt.IntArray([end for span in played.flags["lost"] for end in span])}
    motion.GetPrim().SetCustomDataByKey("twistcap", spans)
    return motion.GetPrim()


def _vectors(pxr: Any, values: Float) -> Any:
    return pxr.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def _numbers(kind: Any, values: AnyArray, dtype: Any) -> Any:
    return kind.FromNumpy(np.ascontiguousarray(values.ravel(), dtype))
