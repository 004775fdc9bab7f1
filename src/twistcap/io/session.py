"""The session file: one TOML with what was recorded and how to track it; ``docs/formats/session.md`` lists every key.

Precedence: command line over session over defaults. An unknown key is an error. Paths are relative to the file (or to
its ``data`` folder); ``${NAME}`` and ``${NAME:-default}`` are taken from the environment.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, PrivateAttr, field_validator

from twistcap.doors.strict import dataclass_from, validated
from twistcap.doors.text import brief, read_toml
from twistcap.errors import InputError, check
from twistcap.io.session_tables import (
    FIRST_POSE,
    SOURCES,
    Cameras,
    ClockTable,
    DataPath,
    DetectorTable,
    FirstPoseTable,
    FitGirths,
    GlbBody,
    HumanoidBody,
    KeypointSet,
    MotionsTable,
    ObjBody,
    Output,
    PriorTable,
    Table,
)

if TYPE_CHECKING:
    from twistcap.motion import MotionLibrary
    from twistcap.priors import ParzenPrior
    from twistcap.settings import Settings

_NAMED = 3  # keys of the command line, at most, that a message names


class Session(Table):
    """A recording and how to track it."""

    data: str = "."
    frames: tuple[Annotated[int, Field(ge=0)], int] | None = None
    step: int = Field(1, ge=1, le=100_000)
    fps: float | None = Field(None, ge=0.01, le=100_000)
    time_offset: float = 0.0
    keypoints: Literal["start", "search", "cue"] = "search"
    scale: float = Field(1.0, ge=0.02, le=4)
    cameras: Cameras
    videos: dict[str, DataPath]
    clocks: dict[str, ClockTable] = Field({})
    body: Annotated[HumanoidBody | GlbBody | ObjBody, Field(discriminator="kind", default_factory=HumanoidBody)]
    first_pose: FirstPoseTable = FirstPoseTable()
    fit_girths: FitGirths | None = None
    prior: PriorTable | None = None
    motions: MotionsTable | None = None
    tracker: dict[str, Any] = Field({})
    output: Output = Output()
    _source: str = PrivateAttr(default="")
    _whole: tuple[int, int] | None = PrivateAttr(default=None)

    @field_validator("frames")
    @classmethod
    def _forward(cls, frames: tuple[int, int] | None) -> tuple[int, int] | None:
        if frames is not None and frames[0] > frames[1]:
            raise ValueError(f"{list(frames)} is no range; write [first, last], the smaller number first")
        return frames

    @property
    def source(self) -> str:
        """The file that messages name; empty for what a result keeps of one."""
        return self._source

    def remember(self, source: str, frames: tuple[int, int] | None) -> None:
        """The file that messages name, and the frames that it gives; the command line may have asked for fewer."""
        self._source, self._whole = source, frames

    @property
    def whole(self) -> Session:
        """The same with all frames of the file."""
        return self.model_copy(update={"frames": self._whole})

    @property
    def title(self) -> str:
        """Name of the session file, for headings and folders; of its folder where it is called ``session.toml``, as
        ``twistcap new`` and ``studio`` call all of theirs."""
        path = Path(self._source)
        return (path.resolve().parent.name or path.stem) if path.name == "session.toml" else path.stem

    @property
    def fits_lengths(self) -> bool:
        """Whether the first pose changes the body's lengths: as said, else not those of a GLB, which is somebody."""
        said = self.first_pose.fit_lengths
        return not isinstance(self.body, GlbBody) if said is None else said

    @property
    def keypoint_table(self) -> KeypointSet | DetectorTable | None:
        """Where keypoints come from, if they are named."""
        return self.first_pose.keypoints or self.first_pose.detector

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
    InputError for a file that cannot be read, an unknown key, a wrong value, a missing table, or a predictor, a
    method or a use of keypoints that does not fit the other tables.
    """
    path = Path(path)
    if path.suffix.lower() in (".h5", ".hdf5"):
        raise InputError(f"{path} is a result, not a session; give the session.toml that it was tracked with.")
    data = _expanded(_with_base(read_toml(path, "session"), path), path)
    above = {key: value for key, value in (overrides or {}).items() if value is not None}
    session = _set_over(data, above, path)
    if "frames" in above:
        session.remember(str(path), _set_over(data, above | {"frames": data.get("frames")}, path).frames)
    return session


def _set_over(data: Mapping[str, Any], above: Mapping[str, Any], path: Path) -> Session:
    """The session with the values of dotted keys put over its tables; where only they are wrong, messages name them."""
    tables = _over(data, above)
    try:
        return _checked(tables, path, str(path))
    except InputError:
        if not above or not _sound(data, path):
            raise
    keys = [*above][:_NAMED] + ["…"] * (len(above) > _NAMED)
    return _checked(tables, path, f"{path}, with {', '.join(keys)} set over it")


def _over(data: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of the tables with the values of dotted keys put into them."""
    out = deepcopy(dict(data))
    if out.get("first_pose") == "auto":
        out["first_pose"] = {"auto": True}
    for key, value in above.items():
        *names, last = key.split(".")
        table = out
        for name in names:
            table = table.setdefault(name, {})
            check(f"{key} = {brief(value)}", isinstance(table, dict), f"{name!r} holds no keys; give it its own value")
        table[last] = value
    return out


def _sound(data: Mapping[str, Any], path: Path) -> bool:
    try:
        _checked(data, path, str(path))
    except InputError:
        return False
    return True


def _checked(data: Mapping[str, Any], path: Path, source: str) -> Session:
    """The session of its tables; `source` begins messages."""
    given = dict(data)
    if isinstance(given.get("body"), dict):
        given["body"] = {"kind": "humanoid"} | given["body"]
    given["first_pose"] = _first_pose(given.get("first_pose", {}), path.parent / FIRST_POSE, source)
    folder = path.parent / str(given.get("data", "."))
    session: Session = validated(Session, given, source, {"folder": folder})
    session.remember(str(path), session.frames)
    tracker_settings(session.tracker, source)
    _check_fitting(session, source)
    return session


def _first_pose(table: Any, beside: Path, source: str) -> Any:
    """The table; where it names nothing, with the file that `twistcap init` has left beside the session."""
    if isinstance(table, str):
        check(source, table == "auto", f"'first_pose' is {brief(table)}; it must be a table, or 'auto'")
        return {"auto": True}
    if isinstance(table, dict) and beside.is_file() and not any(name in table for name in SOURCES):
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
    alone = "tracker.method 'differential' uses brightness alone"
    if method == "differential" and tables:
        raise InputError(f"{source}: {alone}; remove {tables}, or choose 'direct'.")
    if session.keypoints == "cue":
        if session.keypoint_table is None:
            lacks = "keypoints are to be a cue, but [first_pose] names neither keypoints nor a detector"
            raise InputError(f"{source}: {lacks}; name one, or remove the key.")
        check(source, method != "differential", f"{alone}; remove keypoints = 'cue', or choose 'direct'")


def _with_base(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """A session over the one that its `base` names, table by table; its paths stay relative to its own folder."""
    if "base" not in data:
        return data
    base = path.parent / str(data.pop("base"))
    below = read_toml(base, "session")
    check(f"session {path}", "base" not in below, f"its base {base} has a base itself; name the last one")
    below["data"] = os.path.relpath(base.parent / str(_expanded(below.get("data", "."), base)), path.parent)
    return _merged(_without_replaced(below, data), data)


def _without_replaced(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Less what the session above puts in its place: a body of another kind, another source of the first pose."""
    out = dict(below)
    body, pose = above.get("body"), above.get("first_pose")
    kinds = {table.get("kind", "humanoid") for table in (body, out.get("body")) if isinstance(table, dict)}
    if len(kinds) > 1:
        del out["body"]
    if isinstance(pose, dict) and isinstance(out.get("first_pose"), dict) and any(name in pose for name in SOURCES):
        out["first_pose"] = {k: v for k, v in out["first_pose"].items() if k not in (*SOURCES, "lengths_from")}
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
