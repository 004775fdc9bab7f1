"""``twistcap calibrate``: cameras from recordings of a board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.commands.points import clicked
from twistcap.errors import InputError, check_choice

if TYPE_CHECKING:
    from twistcap.calibrate.calibrate import Calibration

_LENSES = {"auto": ("brown", "fisheye"), "brown": ("brown",), "fisheye": ("fisheye",)}


Folder = Annotated[Path, typer.Argument(help="Folder for Calib.toml and the page; created.", metavar="DIR")]
TheBoard = Annotated[
    str, typer.Option("--board", help="board.toml of `twistcap board`, or as charuco:5x7:40:30:4X4_50.")
]
LensOf = Annotated[
    list[str] | None,
    typer.Option("--lens-of", help="CAMERA=PATH: pictures of the board by that camera alone, for its lens."),
]
Points = Annotated[
    Path | None, typer.Option(help="JSON of measured points of the scene, instead of videos; with --lens-of.")
]
Click = Annotated[
    list[str] | None,
    typer.Option(help="With --points: click them in the browser, in this video or picture folder of each camera."),
]
Floor = Annotated[
    int | None, typer.Option(min=0, help="Frame of the first camera in which the board lies on the floor, face up.")
]
Lens = Annotated[str, typer.Option(help="auto, brown (OpenCV's 5 numbers) or fisheye.")]
Looks = Annotated[int, typer.Option(min=3, help="Frames of each video in which the board is looked for.")]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Of --click, on 127.0.0.1; 0 chooses a free one.")]
Clocks = Annotated[bool, typer.Option(help="Find by how much cameras show other moments.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an older DIR/Calib.toml.")]


def calibrate(
    folder: Folder, board: TheBoard, videos: terminal.Videos = None, more: terminal.MoreVideos = None,
    lone: LensOf = None, points: Points = None, click: Click = None, floor: Floor = None, lens: Lens = "auto",
    looks: Looks = 400, clocks: Clocks = True, port: Port = 0, overwrite: Overwrite = False,
    json: terminal.Json = False,
) -> None:  # fmt: skip
    """Calibrate cameras by videos of a board that is carried about: DIR/Calib.toml and DIR/calibration.html.

    Cameras may have been started by hand, and have different frame rates.

    Examples:

      twistcap calibrate rig --board board.toml --videos filmed/ --floor 0

      twistcap calibrate rig --board charuco:5x7:40:30:4X4_50 --videos left=a.mp4 --videos right=b.mp4

      twistcap calibrate rig --board chessboard:8x5:60 --videos together/ --lens-of left=lens/left

      twistcap calibrate rig --board chessboard:8x5:60 --points points.json --lens-of lenses/

      twistcap calibrate rig --board chessboard:8x5:60 --points points.json --click scene/ --lens-of lenses/
    """
    from twistcap.calibrate.board import board_of
    from twistcap.calibrate.calibrate import Options, calibrated

    check_choice("--lens", lens, _LENSES)
    chosen: Any = _LENSES[lens]
    options, alone = Options(chosen, looks, floor=floor, clocks=clocks), sources_of(lone or [])
    sources = sources_of([*(videos or []), *(more or [])])
    if (points is None) != bool(sources):
        raise InputError("give videos of the board, as --videos, or measured points, as --points; one of the two.")
    if points is not None and floor is not None:
        raise InputError("--floor is for videos of the board; with --points the world is that of the points.")
    if click and json:
        raise InputError("--click opens a page; it does not go with --json.")
    terminal.check_free(terminal.output_folder(folder) / "Calib.toml", overwrite=overwrite)  # before the work
    points = _clicked(points, click, alone, port) if click else points
    with terminal.status("calibrating") as report:
        if points is not None:
            found = _by_points(points, board_of(board), options, alone, report)
        else:
            _check_alone(alone, sources)
            found = calibrated(sources, board_of(board), options, alone, report)
    write(found, folder, json)


def _by_points(points: Path, board: Any, options: Any, alone: dict[str, Any], report: Any) -> Calibration:
    from twistcap.calibrate.calibrate import alone_seen, found_variant
    from twistcap.calibrate.scene import calibrated_by_scene, read_scene

    scene = read_scene(points)
    _check_lenses(alone)
    names = tuple(alone)
    scene.sightings(names)  # that each camera sees enough is known before the work
    board = found_variant(list(alone.values()), board)
    sightings = alone_seen(alone, names, board, options, report)
    sizes = {c: source.size for c, source in enumerate(alone.values())}
    return calibrated_by_scene(scene, sightings, board, names, sizes, options, report=report)


def _clicked(points: Path | None, click: list[str], alone: dict[str, Any], port: int) -> Path:
    if points is None:
        raise InputError("--click is for measured points; name their JSON with --points.")
    _check_lenses(alone)
    return clicked(points, sources_of(click), alone, port)


def _check_lenses(alone: dict[str, Any]) -> None:
    if not alone:
        raise InputError("--points needs pictures of the board by each camera, as --lens-of, for the lenses.")


def sources_of(texts: list[str]) -> dict[str, Any]:
    """Open recordings by camera: as said, else the name of the file or folder. Raises InputError."""
    from twistcap.io.new_session import recordings
    from twistcap.io.video import open_source

    out: dict[str, Any] = {}
    for said, path in (pair for text in texts for pair in recordings(text)):
        name = said or Path(path.split("%")[0].rstrip("/")).stem
        if name in out:
            raise InputError(f"camera {name!r} is given two recordings; write CAMERA=PATH.")
        out[name] = open_source(path)
    return out


def write(found: Calibration, folder: Path, json: bool = False) -> None:
    """``Calib.toml`` and the page; the numbers in the terminal."""
    from twistcap.calibrate.advice import camera_rows, sentences
    from twistcap.io.calibration import write_rig
    from twistcap.io.files import pasted
    from twistcap.report.calibration import write_calibration_page

    terminal.output_folder(folder)
    path = folder / "Calib.toml"
    write_rig(found.rig, path, floor=found.floor_known)
    page = write_calibration_page(found, folder, f"Calibration {folder.resolve().name}")
    if json:
        about = {"id": "calibrate", "file": path, "page": page}
        terminal.emit(about | {"cameras": camera_rows(found), "statements": sentences(found)})
        return
    typer.echo(path)
    typer.echo(page)
    for sentence in sentences(found):
        typer.echo(sentence, err=True)
    begin = f"twistcap new DIR --calibration {pasted(path)} --videos VIDEOS"
    typer.echo(f"Next, begin a session:  {begin}", err=True)


def _check_alone(alone: dict[str, Any], sources: dict[str, Any]) -> None:
    for name, source in alone.items():
        if name not in sources:
            raise InputError(f"--lens-of names the camera {name!r}, which has no video; name it in --videos.")
        if source.size != sources[name].size:
            sizes = " and ".join(f"{w}×{h}" for w, h in (source.size, sources[name].size))
            raise InputError(f"camera {name}: its lens pictures and its video differ in size ({sizes} pixels).")
