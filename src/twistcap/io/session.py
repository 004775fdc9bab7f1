"""The session file: one TOML with what was recorded and how to track it; ``docs/formats/session.md`` lists every key.

Precedence: command line over session over defaults. An unknown key is an error. Paths are relative to the file (or to
its ``data`` folder); ``${NAME}`` and ``${NAME:-default}`` are taken from the environment.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PrivateAttr, ValidationInfo, model_validator

from twistcap.doors.text import read_toml
from twistcap.errors import InputError
from twistcap.io.strict import dataclass_from, validated
from twistcap.motion import MotionKind

if TYPE_CHECKING:
    from twistcap.io.norms import Band
    from twistcap.motion import MotionLibrary
    from twistcap.priors import ParzenPrior
    from twistcap.settings import Settings


def _from_folder(path: str, info: ValidationInfo) -> str:
    folder = (info.context or {}).get("folder", Path())
    return os.path.normpath(Path(folder) / Path(path).expanduser())


DataPath = Annotated[str, AfterValidator(_from_folder)]


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

    `grid` is for videos that were resized or shifted after the cameras were calibrated.
    """

    calibration: DataPath
    unit: Literal["m", "mm"] | None = None
    use: tuple[str, ...] | None = None
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

    format: Literal["body_25", "body_25b", "coco_17"] = "body_25"
    folders: dict[str, DataPath]
    frames: tuple[Annotated[int, Field(ge=0)], ...] = (0,)
    offset: float = 0.0
    person: int | dict[str, int] = 0
    grid: dict[str, Grid] = {}
    calibration: DataPath | None = None
    unit: Literal["m", "mm"] | None = None


FIRST_POSE = "first_pose.json"
"""The file beside a session that is its first pose, where the session names none."""
_SOURCES = ("auto", "file", "clicks", "keypoints")


class FirstPoseTable(Table):
    """``[first_pose]``: one of file, clicks and keypoints, or none: it is found in the images (``"auto"``).

    `plates` is a folder of pictures without the person, ``CAM.png``, for that.
    """

    auto: bool = False
    plates: DataPath | None = None
    file: DataPath | None = None
    frame: int | None = None
    clicks: DataPath | None = None
    keypoints: KeypointSet | None = None
    lengths_from: tuple[KeypointSet, ...] = ()
    fit_lengths: bool = True
    masks: DataPath | None = None
    refine: bool = True
    upright: bool = True

    @model_validator(mode="after")
    def _one_source(self) -> FirstPoseTable:
        given = [name for name in _SOURCES if getattr(self, name)]
        if len(given) > 1:
            raise ValueError(f"give one of auto, file, clicks and keypoints, not {' and '.join(given)}")
        if not given and "auto" in self.model_fields_set:
            raise ValueError("auto is false; give one of file, clicks and keypoints")
        return self

    @property
    def unaided(self) -> bool:
        """Whether it is to be found in the images."""
        return not any((self.file, self.clicks, self.keypoints))


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


class Session(Table):
    """A recording and how to track it."""

    data: str = "."
    frames: tuple[Annotated[int, Field(ge=0)], int] | None = None
    step: int = Field(1, ge=1, le=100_000)
    fps: float | None = Field(None, ge=0.01, le=100_000)
    time_offset: float = 0.0
    scale: float = Field(1.0, ge=0.02, le=4)
    cameras: Cameras
    videos: dict[str, DataPath]
    clocks: dict[str, ClockTable] = {}
    body: Annotated[HumanoidBody | GlbBody | ObjBody, Field(discriminator="kind", default_factory=HumanoidBody)]
    first_pose: FirstPoseTable = FirstPoseTable()
    fit_girths: FitGirths | None = None
    prior: PriorTable | None = None
    motions: MotionsTable | None = None
    tracker: dict[str, Any] = {}
    output: Output = Output()
    _source: str = PrivateAttr(default="")

    def remember(self, source: str) -> None:
        """The file that messages name."""
        self._source = source

    @property
    def title(self) -> str:
        """Name of the session file, for headings."""
        return Path(self._source).stem

    @property
    def tracker_settings(self) -> Settings:
        """``[tracker]`` as the tracker takes it; what ``[prior]`` and ``[motions]`` say goes over it."""
        settings = tracker_settings(self.tracker, self._source)
        if self.motions is not None:
            settings = replace(settings, predictor="motion", motion=self.motions.kind or settings.motion)
        if self.prior is None or self.prior.strength is None:
            return settings
        return replace(settings, prior_strength=self.prior.strength)

    @property
    def pose_prior(self) -> ParzenPrior | None:
        """What ``[prior]`` names, read. Raises InputError for a file that is no prior, or a scale of a coordinate that
        it has not learnt.
        """
        if self.prior is None:
            return None
        from twistcap.io.prior_file import adjusted, read_prior

        return adjusted(read_prior(self.prior.path), self.prior.sigma, self.prior.scale)

    @property
    def motion_library(self) -> MotionLibrary | None:
        """What ``[motions]`` names, read, at its own rate. Raises InputError for a file that is no motion library."""
        if self.motions is None:
            return None
        from twistcap.io.motion_library import read_library

        return read_library(self.motions.path)


def load_session(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Session:
    """Read and check a session file.

    `overrides` are what the command line says, by dotted key (``tracker.method``); None values are passed over. Raises
    InputError for a file that cannot be read, an unknown key, a wrong value, a missing table, or a predictor or
    method that does not fit ``[motions]`` and ``[prior]``.
    """
    path = Path(path)
    data = _expanded(_with_base(read_toml(path, "session"), path), path)
    for key, value in (overrides or {}).items():
        if value is not None:
            *above, last = key.split(".")
            table = data
            for name in above:
                table = table.setdefault(name, {})
            table[last] = value
    if "body" in data and isinstance(data["body"], dict):
        data["body"].setdefault("kind", "humanoid")
    data["first_pose"] = _first_pose(data.get("first_pose", {}), path.parent / FIRST_POSE)
    folder = path.parent / str(data.get("data", "."))
    session: Session = validated(Session, data, str(path), {"folder": folder})
    session.remember(str(path))
    tracker_settings(session.tracker, str(path))
    _check_fitting(session, str(path))
    return session


def _first_pose(table: Any, beside: Path) -> Any:
    """The table; where it names nothing, with the file that `twistcap init` has left beside the session."""
    if table == "auto":
        return {"auto": True}
    if isinstance(table, dict) and beside.is_file() and not any(name in table for name in _SOURCES):
        return table | {"file": str(beside.resolve())}
    return table


def tracker_settings(table: Mapping[str, Any], source: str) -> Settings:
    """`Settings` from their table. Raises InputError for an unknown key or a wrong value."""
    from twistcap.settings import Settings

    return dataclass_from(Settings, table, source, "tracker")


def _check_fitting(session: Session, source: str) -> None:
    """Motion predicts where ``[motions]`` names a library, and only there; brightness alone takes nothing learnt."""
    method, predictor = session.tracker.get("method"), session.tracker.get("predictor")
    if session.motions is not None and predictor not in (None, "motion"):
        both = f"[motions] makes motion the predictor, but tracker.predictor is {predictor!r}"
        raise InputError(f"{source}: {both}; remove one.")
    if session.motions is None and predictor == "motion":
        lacks = "tracker.predictor is 'motion', but no [motions] names a library"
        raise InputError(f"{source}: {lacks}; give its path there, of twistcap motions build.")
    tables = " and ".join(f"[{name}]" for name in ("prior", "motions") if getattr(session, name) is not None)
    if method == "differential" and tables:
        alone = "tracker.method 'differential' uses brightness alone"
        raise InputError(f"{source}: {alone}; remove {tables}, or choose 'direct'.")


def _with_base(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """A session over the one that its `base` names, table by table; its paths stay relative to its own folder."""
    if "base" not in data:
        return data
    base = path.parent / str(data.pop("base"))
    below = read_toml(base, "session")
    if "base" in below:
        raise InputError(f"session {path}: its base {base} has a base itself; name the last one.")
    below["data"] = os.path.relpath(base.parent / str(_expanded(below.get("data", "."), base)), path.parent)
    return _merged(_without_replaced(below, data), data)


def _without_replaced(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Less what the session above puts in its place: a body of another kind, another source of the first pose."""
    out = dict(below)
    body, pose = above.get("body"), above.get("first_pose")
    kinds = {table.get("kind", "humanoid") for table in (body, out.get("body")) if isinstance(table, dict)}
    if len(kinds) > 1:
        del out["body"]
    if isinstance(pose, dict) and isinstance(out.get("first_pose"), dict) and any(name in pose for name in _SOURCES):
        out["first_pose"] = {k: v for k, v in out["first_pose"].items() if k not in (*_SOURCES, "lengths_from")}
    return out


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    both = {k: _merged(below[k], v) for k, v in above.items() if isinstance(v, dict) and isinstance(below.get(k), dict)}
    return below | above | both


def _expanded(value: Any, path: Path) -> Any:
    """All strings with ``${NAME}`` and ``${NAME:-default}`` filled in."""
    if isinstance(value, dict):
        return {key: _expanded(item, path) for key, item in value.items()}
    if isinstance(value, list):
        return [_expanded(item, path) for item in value]
    if isinstance(value, str):
        return re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", lambda match: _variable(match, path), value)
    return value


def _variable(match: re.Match[str], path: Path) -> str:
    value = os.environ.get(match[1]) or match[2]
    if value is None:
        mend = f"set it, or write ${{{match[1]}:-default}}"
        raise InputError(f"{path}: the environment variable {match[1]} is not set; {mend}.")
    return value
