"""The study file: one TOML with many subjects and trials; ``docs/formats/study.md`` lists every key."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from twistcap.doors.strict import validated
from twistcap.doors.text import read_lines, read_toml, toml_value
from twistcap.errors import InputError, check
from twistcap.io.provenance import flat
from twistcap.io.session import Session, load_session
from twistcap.io.session_tables import DataPath, Output, Table

BODY = "body"
"""The folder of a subject in which its fitted body lies."""
_NEEDED = ("subject", "trial", "session")
_NAME = re.compile(r"\w[\w.-]*")  # it names a folder


class StudyBody(Table):
    """``[body]``: whether a body is fitted once a subject, on how many of its trials, on how many frames of each."""

    fit: bool = True
    trials: int = Field(default=1, ge=1)
    frames: int = Field(default=20, ge=1)


class StudyOutput(Output):
    """``[output]``: the keys of a session's, and what the rows of the table are: frames, or per cents of strides."""

    overlay: bool = False
    over: Literal["frame", "cycle"] = "frame"
    filter: Literal["butterworth", "smoother"] = "butterworth"
    cutoff: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _one_filter(self) -> StudyOutput:
        if self.filter == "smoother" and self.cutoff is not None:
            raise ValueError("the smoother takes no cutoff, the covariance gives it; leave 'cutoff' away")
        return self


class StudyFile(Table):
    """What is done to every trial of a study."""

    trials: DataPath
    session: dict[str, Any] = Field(default_factory=dict[str, Any])
    body: StudyBody = StudyBody()
    refine: bool | dict[str, Any] = True
    output: StudyOutput = StudyOutput()


@dataclass(frozen=True)
class Trial:
    """One recording of a subject: its session, and keys of it that are other in this study."""

    subject: str
    trial: str
    session: Path
    keys: Mapping[str, Any] = field(hash=False)

    @property
    def name(self) -> str:
        """As messages call it."""
        return f"{self.subject}/{self.trial}"

    def folder(self, study: Path) -> Path:
        """Where all files of it lie."""
        return study / self.subject / self.trial

    def read(self, common: Mapping[str, Any]) -> Session:
        """The session, with the `common` keys of the study and its own. Raises InputError as `load_session`."""
        return load_session(self.session, {**common, **self.keys})


@dataclass(frozen=True)
class Study:
    """A study and its trials, in the order of its table."""

    about: StudyFile
    trials: tuple[Trial, ...]

    @property
    def subjects(self) -> dict[str, tuple[Trial, ...]]:
        """The trials of each subject."""
        names = dict.fromkeys(trial.subject for trial in self.trials)
        out: dict[str, list[Trial]] = {name: [] for name in names}
        for trial in self.trials:
            out[trial.subject].append(trial)
        return {name: tuple(trials) for name, trials in out.items()}


def load_study(path: Path) -> Study:
    """Read and check a study file and the list of its trials; sessions are read later, each with its trial.

    Raises InputError for a file that cannot be read, an unknown key, a wrong value, a trial that is named twice, or
    none at all.
    """
    context = {"folder": path.parent}
    about: StudyFile = validated(StudyFile, read_toml(path, "study"), str(path), context)
    source = Path(about.trials).absolute()
    if source.is_dir():
        found = sorted(source.glob("*/*/session.toml"))
        trials = tuple(Trial(session.parts[-3], session.parts[-2], session, {}) for session in found)
    else:
        trials = tuple(_in_table(source))
    check(f"study {path}", trials, f"{source} names no trial; it needs rows, or SUBJECT/TRIAL/session.toml")
    for trial in trials:
        _check_names(trial, source)
    (name, count), *_ = Counter(trial.name for trial in trials).most_common(1)
    if count > 1:
        raise InputError(f"{source}: the trial {name} is there {count} times; give each a name of its own.")
    return Study(about.model_copy(update={"session": flat("", about.session)}), trials)


def _check_names(trial: Trial, source: Path) -> None:
    for kind, name in (("subject", trial.subject), ("trial", trial.trial)):
        if not _NAME.fullmatch(name):
            mend = "use letters, digits, '-', '_' and '.'"
            raise InputError(f"{source}: the {kind} {name!r} cannot be the name of a folder; {mend}.")
    if trial.trial == BODY:
        raise InputError(
            f"{source}: a trial of {trial.subject} is called {BODY!r}; that folder is the body's, rename it."
        )


def _in_table(path: Path) -> Iterator[Trial]:
    """Rows of a CSV; columns beyond the needed ones are keys of the session, their cells values as in TOML."""
    rows = csv.DictReader(read_lines(path), strict=True)
    try:
        missing = [name for name in _NEEDED if name not in (rows.fieldnames or ())]
        if missing:
            mend = "its first line must name the columns, with commas between"
            raise InputError(f"{path}: the column {missing[0]!r} is missing; {mend}.")
        for row in rows:
            yield _of_row(row, path, rows.line_num)
    except csv.Error as error:
        raise InputError(f"{path}: line {rows.line_num} is no line of a CSV ({error}).") from error


def _of_row(row: Mapping[Any, Any], path: Path, line: int) -> Trial:
    if None in row or None in row.values():
        raise InputError(f"{path}: line {line} has not as many cells as the first line has names.")
    cells = {name: cell.strip() for name, cell in row.items()}
    empty = [name for name in _NEEDED if not cells[name]]
    if empty:
        raise InputError(f"{path}: line {line} has no {empty[0]}; fill the cell.")
    keys = {name: toml_value(cell) for name, cell in cells.items() if cell and name not in _NEEDED}
    return Trial(cells["subject"], cells["trial"], path.parent / cells["session"], keys)
