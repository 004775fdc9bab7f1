"""The tables of a session file: their keys, types and defaults, as pydantic models."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from twistcap.io.model_file import is_address, is_model_file
from twistcap.motion import MotionKind

if TYPE_CHECKING:
    from twistcap.body import Body
    from twistcap.io.norms import Band


def _from_folder(path: str, info: ValidationInfo) -> str:
    folder = (info.context or {}).get("folder", Path())
    return os.path.normpath(Path(folder) / Path(path).expanduser())


DataPath = Annotated[str, AfterValidator(_from_folder)]


def _model_in_folder(name: str, info: ValidationInfo) -> str:
    return _from_folder(name, info) if is_model_file(name) and not is_address(name) else name


ModelName = Annotated[str, AfterValidator(_model_in_folder)]
"""A model file by path or address, see `io.model_file`, or the name of an installed detector."""


def _known_format(name: str) -> str:
    from twistcap.io.exports import FORMATS

    FORMATS.get(name)
    return name


ExportName = Annotated[str, AfterValidator(_known_format)]
Factors = dict[str, Annotated[float, Field(gt=0)]]


class Table(BaseModel):
    """A TOML table; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CameraGrid(Table):
    """How a video's pixels relate to its calibration's: ``video = scale · calibration + offset``, per axis (x, y)."""

    scale: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]] | None = None


class Cameras(Table):
    """``[cameras]``: calibration file, its unit, the cameras to use (all) and the height of the floor (m, or false).

    `up` is the axis of the calibration that is up; the world is turned so that it is z. `grid` is for videos that were
    resized or shifted after the cameras were calibrated.
    """

    calibration: DataPath
    unit: Literal["m", "mm"] | None = None
    use: tuple[str, ...] | None = None
    up: Literal["x", "-x", "y", "-y", "z", "-z"] | None = None
    floor: float | Literal[False] = 0.0
    grid: dict[str, CameraGrid] = {}


class ClockTable(Table):
    """``[clocks.CAM]``: a camera's own time t, 0 at its first image, is ``rate t + offset`` (s) of the recording.

    `fps` replaces the time stamps of its video.
    """

    offset: float = Field(0.0, ge=-1e6, le=1e6)
    rate: float = Field(1.0, ge=0.01, le=100)
    fps: float | None = Field(None, ge=0.01, le=100_000)


class HumanoidBody(Table):
    """``[body] kind = "humanoid"``: the built-in person."""

    kind: Literal["humanoid"] = "humanoid"
    variant: Literal["full", "legs"] = "full"
    stature: float = Field(default=1.75, gt=0.3, lt=3.0)
    lengths: Factors = {}
    girths: Factors = {}
    thorax: bool = False
    neck: bool = True
    clavicles: bool = False
    wrists: bool = False


class _Loaded(Table):
    """A body of files, and the factors on its size."""

    path: DataPath
    rig: DataPath | None = None
    stature: float = Field(default=1.0, gt=0)
    lengths: Factors = {}
    girths: Factors = {}


class GlbBody(_Loaded):
    """``[body] kind = "glb"``: a skinned GLB or glTF and the TOML that describes its joints."""

    kind: Literal["glb"]

    @cached_property
    def described(self) -> tuple[Body, str]:
        """The body at its own size, and where the meaning of its joints is from; the file is parsed once."""
        from twistcap.body.gltf import load_described

        return load_described(self.path, self.rig)


class ObjBody(_Loaded):
    """``[body] kind = "obj"``: an OBJ with a MakeHuman-style rig and weights."""

    kind: Literal["obj"]
    weights: DataPath | None = None
    spec: DataPath | None = None
    targets: dict[DataPath, float] = {}


class Grid(Table):
    """How a detector's pixels relate to the video's: ``detector = scale · video + offset``, per axis (x, y), px."""

    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


class KeypointSet(Table):
    """2D keypoints of some instants: a folder of OpenPose-style JSON files per camera.

    `frames` are file numbers; file j belongs to video frame ``j + offset``.
    """

    format: Literal["body_25", "body_25b", "coco_17", "halpe_26", "coco_133", "blazepose"] = "body_25"
    folders: dict[str, DataPath]
    frames: tuple[Annotated[int, Field(ge=0)], ...] = (0,)
    offset: float = 0.0
    person: Literal["auto"] | Annotated[int, Field(ge=0)] | dict[str, Annotated[int, Field(ge=0)]] = "auto"
    grid: dict[str, Grid] = {}
    calibration: DataPath | None = None
    unit: Literal["m", "mm"] | None = None


class DetectorTable(Table):
    """``[first_pose.detector]``: what finds 2D keypoints in the images of `frames`, by default the first one.

    `people` is a model that finds people, for one that needs them. ``detector = "rtmo.onnx"`` says `model` alone.
    """

    model: ModelName
    people: ModelName | None = None
    frames: tuple[Annotated[int, Field(ge=0)], ...] = ()


_BY_NAME = BeforeValidator(lambda given: {"model": given} if isinstance(given, str) else given)
FIRST_POSE = "first_pose.json"
"""The file beside a session that is its first pose, where the session names none."""
SOURCES = ("auto", "file", "clicks", "keypoints", "detector")


class FirstPoseTable(Table):
    """``[first_pose]``: one of file, clicks, keypoints and detector, or none: it is found in the images.

    For that, `plates` is a folder of pictures without the person, ``CAM.png``, and `at` says who is meant: by camera,
    a pixel (x, y) of the first frame on the trunk.
    """

    auto: bool | None = None
    plates: DataPath | None = None
    at: dict[str, tuple[float, float]] = {}
    file: DataPath | None = None
    frame: int | None = None
    clicks: DataPath | None = None
    keypoints: KeypointSet | None = None
    detector: Annotated[DetectorTable | None, _BY_NAME] = None
    lengths_from: tuple[KeypointSet, ...] = ()
    fit_lengths: bool | None = None
    masks: DataPath | None = None
    refine: bool = True
    upright: bool = True

    @model_validator(mode="after")
    def _one_source(self) -> FirstPoseTable:
        given = [name for name in SOURCES if getattr(self, name)]
        if len(given) > 1:
            raise ValueError(f"give one of auto, file, clicks, keypoints and detector, not {' and '.join(given)}")
        if not given and self.auto is False:
            raise ValueError("auto is false; give one of file, clicks, keypoints and detector")
        if self.at and not self.unaided:
            raise ValueError(f"at says whom to look for, but {given[0]} gives the pose; leave one of them out")
        return self

    @property
    def unaided(self) -> bool:
        """Whether it is to be found in the images."""
        return not any((self.file, self.clicks, self.keypoints, self.detector))


class PriorTable(Table):
    """``[prior]``: a pose prior that `twistcap prior train` made, and how much it counts."""

    path: DataPath
    strength: float | None = Field(None, ge=0)
    sigma: float | None = Field(None, gt=0)
    scale: Factors = {}


class MotionsTable(Table):
    """``[motions]``: training motion of `twistcap motions build`, which predicts also without images."""

    path: DataPath
    kind: MotionKind | None = None


class FitGirths(Table):
    """``[fit_girths]``: one girth factor per kind of segment, fitted on given silhouettes."""

    masks: DataPath
    frames: tuple[Annotated[int, Field(ge=0)], ...] = (0,)


class Output(Table):
    """``[output]``: folder, and which files beside result.h5 to write, and how; see `io.exports`."""

    folder: str | None = None
    overlay: bool = True
    report: bool = True
    exports: tuple[ExportName, ...] = ("trc", "csv")
    axes: Literal["opensim", "pose2sim", "z_up"] = "opensim"
    angles: Literal["opensim", "isb"] = "opensim"
    fill: bool = False
    norms: DataPath | None = None
    norms_speed: str = "Free"

    @property
    def gait_norms(self) -> Mapping[str, Band]:
        """What `norms` names, read; see `io.norms`. Raises InputError for a file of another kind."""
        from twistcap.io.norms import read_norms

        return {} if self.norms is None else read_norms(Path(self.norms), self.norms_speed)
