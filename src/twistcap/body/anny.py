"""The Anny body: a rigged person with a few dozen parameters (NAVER; code Apache-2.0, data CC0).

It needs the extra ``twistcap[anny]`` with torch; only this module imports it. Its bodies are ordinary ones that can be
saved as GLB and tracked without the extra. Brégier et al., *Human Mesh Modeling for Anny Body*, 2025
(arXiv 2511.03589).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module, resources
from typing import Any

import numpy as np

from twistcap import se3
from twistcap.arrays import AnyArray, Float, Int
from twistcap.body.model import Body
from twistcap.body.rig import SkinnedMesh, build_body
from twistcap.body.rig_spec import LandmarkSpec, RigSpec, read_rig
from twistcap.errors import InputError

MISSING = "the Anny body needs the packages anny and torch; install them with: pip install 'twistcap[anny]'."
_TOPOLOGY = "notoes_collapse10pc"  # one closed piece, mirrored in pairs
_VERTICES = 1229  # of it, in the order of the numbers in _MARKS
_BUILD = {"gender": 0.5, "age": 0.7, "muscle": 0.5, "weight": 0.5, "height": 0.5, "proportions": 0.5}  # an adult's
_CHANGES = re.compile(  # Anny's local changes that a silhouette shows: no face, both sides alike
    r"measure-|[lr]-(lower|upper)(arm|leg)-(fat|muscle|scale-(horiz|depth))|[lr]-(hand|foot)-scale|buttocks-volume"
    r"|hip-scale|hip-trans-forward|head-(scale|back)|neck-(scale|back|trans-forward)|breast-volume|stomach-(navel|tone)"
    r"|torso-(scale|vshape|muscle|trans-forward)|bulge"
)
_MARKS: dict[str, tuple[str, tuple[int, ...]]] = {  # near MakeHuman's own vertices of these names, to millimetres
    "toe_r": ("RightFoot", (541, 545, 627)), "small_toe_r": ("RightFoot", (632, 637, 589, 635)),
    "heel_r": ("RightFoot", (586,)), "eye_r": ("Head", (126, 119, 137)), "ear_r": ("Head", (563, 558)),
    "toe_l": ("LeftFoot", (1133, 1137, 1219)), "small_toe_l": ("LeftFoot", (1224, 1228, 1180, 1226)),
    "heel_l": ("LeftFoot", (1176,)), "eye_l": ("Head", (738, 733, 749)), "ear_l": ("Head", (1156, 1149)),
    "head_top": ("Head", (101, 102, 717, 100)), "nose": ("Head", (22,)),
}  # fmt: skip


@dataclass(frozen=True)
class Parameter:
    """A parameter of the body's build.

    Attributes:
        name: Anny's; of a change on both sides, without the side.
        usual, spread: approximate mean and standard deviation over people.
        low, high: bounds.
    """

    name: str
    usual: float
    spread: float
    low: float
    high: float


class AnnyModel:
    """The loaded model. The first time in an environment this takes some minutes; later it reads a cache. Raises
    InputError where the extra is not installed, or its surface is not the one of our landmarks."""

    def __init__(self) -> None:
        try:
            warp, anny, torch = (import_module(name) for name in ("warp", "anny", "torch"))
        except ImportError as error:
            raise InputError(MISSING) from error
        warp.config.quiet = True  # it would write to our standard output
        model: Any = anny.Anny(rig="cmu_mb", topology=_TOPOLOGY, phenotypes="default", local_changes="default")
        _check_surface(len(model.vertex_bone_indices))
        self._model, self._torch = model.to(torch.float64), torch
        self._changes = _groups([name for name in model.local_change_labels if _CHANGES.match(name)])
        whole = [Parameter(name, usual, 0.06 if name == "age" else 0.2, 0.0, 1.0) for name, usual in _BUILD.items()]
        parts = [Parameter(name, 0.0, 0.3, -1.0, 1.0) for name in self._changes]
        #: Six of the whole body (gender from male 0 to female 1, age, …), then changes of single parts.
        self.parameters: tuple[Parameter, ...] = (*whole, *parts)

    def bodies(self, values: Float) -> list[Body]:
        """Bodies of the joints, signs and zero pose of the built-in humanoid.

        Args:
            values: (N, M) of the parameters.
        """
        build, changes = self._inputs(values)
        with self._torch.no_grad():
            coefficients = self._model._get_phenotype_blendshape_coefficients(build, changes, build[:, :0])
            rest = self._model.get_rest_model(coefficients)
        heads, surfaces = _array(rest["rest_bone_heads"]), _array(rest["rest_vertices"])
        return [self._body(*each) for each in zip(heads, surfaces, strict=True)]

    def _inputs(self, values: Float) -> tuple[Any, Any]:
        """Tensors (N, 6) and (N, all local changes)."""
        labels = list(self._model.local_change_labels)
        changes = np.zeros((len(values), len(labels)))
        for k, group in enumerate(self._changes.values()):
            changes[:, [labels.index(name) for name in group]] = values[:, len(_BUILD) + k, None]
        order = [list(_BUILD).index(name) for name in self._model.phenotype_labels]
        return self._torch.as_tensor(values[:, order]), self._torch.as_tensor(changes)

    def _body(self, heads: Float, vertices: Float) -> Body:
        names = tuple(str(name) for name in self._model.bone_labels)
        hips = [heads[names.index(name)] for name in ("RightUpLeg", "LeftUpLeg")]
        parents, frames = np.array(self._model.bone_parents, dtype=np.int32), se3.transform(np.eye(3), heads)
        mesh = SkinnedMesh(
            "anny", "Anny", names, parents, frames, vertices, self._faces, self._weights,
            points={"mid_hip": np.mean(hips, axis=0)}, numbered=vertices,
        )  # fmt: skip
        return build_body(mesh, _rig())

    @cached_property
    def _faces(self) -> Int:
        return np.ascontiguousarray(_array(self._model.get_triangular_faces()), dtype=np.int32)

    @cached_property
    def _weights(self) -> Float:
        """(V, B) weights of Anny's bones."""
        bones, weights = _array(self._model.vertex_bone_indices), _array(self._model.vertex_bone_weights)
        out = np.zeros((len(bones), len(self._model.bone_labels)))
        np.add.at(out, (np.arange(len(bones))[:, None], bones.astype(int)), weights)
        return out


def _check_surface(count: int) -> None:
    if count != _VERTICES:
        mend = "install the supported one with: pip install 'twistcap[anny]'"
        raise InputError(f"this release of anny has a surface of {count} vertices instead of {_VERTICES}; {mend}.")


def _groups(names: Sequence[str]) -> dict[str, list[str]]:
    """Names of the changes on both sides, by their name without the side."""
    out: dict[str, list[str]] = {}
    for name in names:
        out.setdefault(name.removeprefix("l-").removeprefix("r-").removesuffix("-incr"), []).append(name)
    return out


def _rig() -> RigSpec:
    """The description of Anny's cmu_mb rig, in Anny's axes and for this surface."""
    with resources.as_file(resources.files("twistcap.body") / "rigs" / "anny_cmu_mb.toml") as path:
        spec = read_rig(path)
    marks: dict[str, str | LandmarkSpec] = {k: v for k, v in (spec.landmarks or {}).items() if isinstance(v, str)}
    marks |= {name: LandmarkSpec(joint=bone, vertices=list(at)) for name, (bone, at) in _MARKS.items()}
    marks["mid_hip"] = LandmarkSpec(joint="Hips", point="mid_hip")
    return spec.model_copy(update={"up": "z", "forward": "-y", "scale": 1.0, "landmarks": marks})


def _array(tensor: Any) -> AnyArray:
    return np.asarray(tensor.detach().cpu().numpy())
