"""Common to all commands: progress and words on stderr, one JSON document on stdout, output folders."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from twistcap.errors import InputError

if TYPE_CHECKING:
    from twistcap.io.result import Result

words = Console(stderr=True, highlight=False, markup=False)  # names of files, cameras and joints may have brackets
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document alone on standard output.")]
Videos = Annotated[
    list[str] | None, typer.Option(help="A video, a folder, or images. Write CAMERA=PATH if the name is not enough.")
]
MoreVideos = Annotated[list[str] | None, typer.Argument(help="More videos, as for --videos.", metavar="[VIDEO]...")]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Port on 127.0.0.1; 0 chooses a free one.")]
Frames = Annotated[str | None, typer.Option(help="Frames FIRST:LAST, both included. Default: all.")]
Coordinates = Annotated[
    str | None, typer.Option(help="Joint coordinates, separated by commas. Default: all that every file has.")
]
Advance = Callable[[str], None]
_made = list[Path]()  # folders of this run, inner ones first; they go again where nothing is written into them


def run_command(app: typer.Typer, name: str, arguments: Sequence[str] | None, called: str | None = None) -> None:
    """Run an app; bad input, or a file that cannot be used, ends with one sentence on stderr and exit code 2."""
    try:
        app(args=None if arguments is None else list(arguments), prog_name=called)
    except InputError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:  # a full disk, a folder that may not be written
        fact = f"{error.filename or 'a file'} cannot be used: {error.strerror or error}"
        print(f"{name}: {fact}; choose another place, or see who may write there.", file=sys.stderr)
        sys.exit(2)
    except (SystemExit, SystemError) as error:  # by Ctrl-C, as typer and numba's kernels pass it on
        if by_ctrl_c(error):
            print(f"{name}: interrupted; nothing more is written.", file=sys.stderr)
            sys.exit(130)
        raise
    finally:
        while _made:
            with suppress(OSError):  # it holds something
                _made.pop(0).rmdir()


def by_ctrl_c(error: BaseException | None) -> bool:
    """Whether Ctrl-C is what led to an error."""
    if error is None or isinstance(error, KeyboardInterrupt):
        return error is not None
    return by_ctrl_c(error.__cause__) or by_ctrl_c(error.__context__)


@contextmanager
def progress(title: str, total: int) -> Generator[Advance]:
    """A bar on stderr; call the function that it gives once per step, with a short note."""
    with _bar() as bar:
        task = bar.add_task(title, total=total, note="")
        yield lambda note="": bar.update(task, advance=1, note=note)


@contextmanager
def status(title: str) -> Generator[Callable[..., None]]:
    """A bar on stderr for work of unknown length; call the function that it gives with (note, done, total).

    It is full at the end, also where less was to be done than was said.
    """
    with _bar() as bar:
        task = bar.add_task(title, total=None, note="")

        def report(note: str, done: int = 0, total: int | None = None) -> None:
            bar.update(task, completed=done, total=total, note=note)

        yield report
        whole = bar.tasks[0].total or 1
        bar.update(task, completed=whole, total=whole)


def _bar() -> Progress:
    title, note = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}"))
    return Progress(title, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), note, console=words)


def tell_compiling() -> None:
    """Say that the kernels will be compiled, where numba keeps none for this machine and user."""
    from twistcap.render.raster import rasterise

    kept = Path(str(rasterise.stats.cache_path))  # beside the code, or where NUMBA_CACHE_DIR or the user's cache is
    if not any(kept.glob("raster.rasterise-*.nbi")):
        words.print("The first run on this machine compiles the kernels; it takes some minutes, later runs do not.")


def say(sentence: str) -> None:
    """A sentence on stderr, as it is: lines are not broken."""
    words.print(sentence, soft_wrap=True)


def finish(document: Mapping[str, Any], json: bool, tell: Callable[[Any], None]) -> None:
    """The end of a run: its document for programs, or what `tell` makes of it for people."""
    (emit if json else tell)(document)


def emit(document: Mapping[str, Any]) -> None:
    """Print one JSON document on stdout; NaN and infinity become null."""
    typer.echo(json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False))


def show_rows(title: str, rows: list[Any]) -> None:
    """A table of measures on stdout; columns that say nothing are left out."""
    shown = {"case": [row["case"] for row in rows], "measure": [row["metric"] for row in rows]}
    shown |= {"value": [_value(row) for row in rows], "unit": [row["unit"] for row in rows]}
    shown |= {"to reach": [str(row["target"] or "") for row in rows]}
    shown |= {"lost": ["" if row["lost"] is None else str(row["lost"]) for row in rows]}
    if len(set(shown["case"])) == 1:
        del shown["case"]
    filled = {name: cells for name, cells in shown.items() if any(cells)}
    left = [name for name in filled if name in ("case", "measure", "unit")]
    show_table(title, list(filled), list(zip(*filled.values(), strict=True)), left)


def _value(row: Any) -> Text:
    number = row["value"]
    value = "–" if number is None else f"{number:.3g}" if abs(number) < 100 else f"{number:.0f}"
    return Text(value, {True: "green", False: "red", None: ""}[row["holds"]])


def show_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str | Text]], left: Sequence[str] = ("",)
) -> None:
    """A table of texts on stdout; the columns `left` begin at the left, the others end at the right."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for name in columns:
        table.add_column(name, justify="left" if name in left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console(highlight=False, markup=False).print(table)


def number(value: float, form: str = ".2f") -> str:
    """A number in a table; a dash where there is none."""
    return format(value, form) if math.isfinite(value) else "–"


def new_calibration(out: Path, own: Path) -> Path:
    """The file for a calibration in a folder. Raises InputError where the session's own is there."""
    goal = (output_folder(out) / "Calib.toml").resolve()
    if goal == own.resolve():
        raise InputError(f"{goal} is the session's own calibration, which is never replaced; give another --out.")
    return goal


def output_folder(path: str | Path) -> Path:
    """The folder, created if it does not exist; at the end of a run it goes again if it is empty.

    Raises InputError where it cannot be made.
    """
    folder = Path(path)
    _made.extend(parent for parent in (folder, *folder.parents) if not parent.exists())
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"folder {folder} cannot be made: {error.strerror}; choose another folder.") from error
    return folder


def output_file(path: Path, option: str, ending: str, *read: Any) -> None:
    """See that a file has the ending of what is written, unless that is a folder, and make its folder.

    Raises InputError as `check_replaceable`; `read` are the files that the command reads, as `keeping` takes them.
    """
    from twistcap.io.files import check_replaceable, keeping

    special = path.exists() and not path.is_file() and not path.is_dir()  # such as /dev/stdout
    if ending and not path.name.lower().endswith(ending) and not special:
        raise InputError(f"{option} is {path}; name a file that ends in {ending}.")
    with keeping(*read):
        check_replaceable(path)
    output_folder(path.parent)


def check_free(*paths: Path, overwrite: bool) -> None:
    """Raises InputError for a file that is there already, unless it may be replaced."""
    for path in paths:
        if path.is_file() and not overwrite:
            raise InputError(f"{path} exists; choose another place, or replace it with --overwrite.")


def frame_range(text: str | None, option: str = "--frames") -> tuple[int, int] | None:
    """``10:20`` as frames 10 to 20, both included. Raises InputError where it reads otherwise, or is reversed."""
    if text is None:
        return None
    first, colon, last = text.partition(":")
    if not (colon and first.isdigit() and last.isdigit()):
        raise InputError(f"{option} is {text!r}; write FIRST:LAST, both included, such as 0:99.")
    if int(first) > int(last):
        raise InputError(f"{option} is {text!r}, a range that is reversed; write {last}:{first}.")
    return int(first), int(last)


def result_file(path: Path) -> Path:
    """The result that a run's folder holds; a path that is no folder stays. Raises InputError for one without any."""
    if not path.is_dir():
        return path
    for name in ("result.h5", "refined.h5"):  # as `track` and `refine` write them
        if (path / name).is_file():
            return path / name
    raise InputError(f"folder {path} holds no result.h5; name the folder that `twistcap track` wrote, or the file.")


ResultFile = Annotated[
    Path, typer.Argument(help="result.h5 of a track, or its folder.", metavar="RESULT", callback=result_file)
]


def tracked(path: Path, frames: str | None = None) -> Result:
    """The result in a file, of the frames FIRST:LAST if given. Raises InputError where it has none of them."""
    from twistcap.io.result import read_result

    span, whole = frame_range(frames), read_result(path)
    result = whole.within(*span) if span else whole
    if not len(result):
        held = f" in {frames}; it has {whole.indices[0]} to {whole.indices[-1]}, see --frames" if len(whole) else ""
        raise InputError(f"result file {path} has no frame{held}.")
    tell_range(path, whole, span)
    if result.unfinished:
        say(f"{path} {result.unfinished}; `twistcap track` goes on with --resume")
    return result


def tell_range(path: Path, whole: Result, span: tuple[int, int] | None) -> None:
    """A sentence where frames are asked for that a result does not have, beside those that it has."""
    first, last = whole.indices[[0, -1]]
    if span and (span[0] < first or span[1] > last):
        say(f"{path} has frames {first} to {last} alone, not all of {span[0]}:{span[1]}")


def names_in(text: str | None) -> list[str] | None:
    """``a, b`` as names; None where none are given."""
    return [name.strip() for name in text.split(",")] if text else None


def image_size(text: str) -> tuple[int, int]:
    """``1920x1080`` as (width, height). Raises InputError where it reads otherwise."""
    width, _, height = text.lower().partition("x")
    if not all(side.isdigit() and len(side) < 6 and int(side) for side in (width, height)):
        raise InputError(f"--size is {text!r}; write WIDTHxHEIGHT, such as 1920x1080.")
    return int(width), int(height)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
