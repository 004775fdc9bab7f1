"""``twistcap view``: results in the browser, or as one HTML file."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.errors import InputError

if TYPE_CHECKING:
    from twistcap.pages.server import PageServer

_LAST_WORD = 0.3  # s in which the last answer reaches the page
_FRAMES = 120  # with images


def view(
    results: Annotated[list[Path], typer.Argument(help="One or more result.h5, or folders.", metavar="RESULT...")],
    save: Annotated[Path | None, typer.Option(help="Write one HTML file and serve nothing.")] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Truth to show too: .npz, .trc, .c3d, .mot or .sto.", metavar="REF")
    ] = None,
    session: Annotated[Path | None, typer.Option(help="Session that names the videos, if they have moved.")] = None,
    width: Annotated[int, typer.Option(min=32, help="Largest width of the images, px.")] = 360,
    images: Annotated[
        int | None, typer.Option(min=0, help="Most frames with images. Default: 120 with --session, else none.")
    ] = None,
    port: terminal.Port = 0,
    json: terminal.Json = False,
) -> None:
    """Look at results: body in 3D, cameras with their images and outlines, joint angles with ± 2σ, lost frames.

    Examples:

      twistcap view out/walk/result.h5

      twistcap view out/direct/result.h5 out/levelset/result.h5 --reference truth.npz

      twistcap view out/walk/result.h5 --save walk.html
    """
    from twistcap.io.files import replacing

    if json and save is None:
        raise InputError("view: --json goes with --save; a page that is served has no document.")
    if save is not None:
        terminal.output_file(save, "--save", ".html", results, reference, session)
    page = _page(list(map(terminal.result_file, results)), reference, session, width, images)
    if save is None:
        serve(page, {}, port)
        return
    with replacing(save) as part:
        part.write_text(page, encoding="utf-8")
    if json:
        terminal.emit({"id": "view", "file": save, "bytes": save.stat().st_size})
    else:
        typer.echo(save)


def serve(page: str, answers: Any, port: int, done: Event | None = None) -> None:
    """Serve until Ctrl-C, or until `done`; the address goes to stdout."""
    from twistcap.pages.server import page_server

    with page_server(page, answers, port) as server:
        typer.echo(server.url)
        words.print("Open the page at this address. Ctrl-C ends. From another machine: ssh -L PORT:127.0.0.1:PORT HOST")
        if done is not None:
            Thread(target=_closed_when, args=(done, server), daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            words.print("closed")


def _closed_when(done: Event, server: PageServer) -> None:
    done.wait()
    time.sleep(_LAST_WORD)
    server.shutdown()


def _page(paths: list[Path], reference: Path | None, session: Path | None, width: int, images: int | None) -> str:
    from twistcap.evaluate.load import load_reference
    from twistcap.evaluate.reference import frame_times
    from twistcap.io.result import read_result
    from twistcap.pages.viewer import Options, view_page

    results = dict(zip(_names(paths), map(read_result, paths), strict=True))
    first = next(iter(results.values()))
    if not any(map(len, results.values())):
        raise InputError(f"result file {paths[0]} has no frame; there is nothing to view.")
    with words.status("reading images, drawing outlines"):
        sources = _sources(first, session, images)
        if reference is not None and reference.is_dir():
            raise InputError(
                f"the reference {reference} is a folder; masks are for twistcap evaluate, give a file here."
            )
        truth = None if reference is None else load_reference(reference, first.body, partial(frame_times, first))
        title = next(iter(results)) if len(results) == 1 else "twistcap: " + ", ".join(results)
        return view_page(results, sources, truth, title, Options(width, _FRAMES if images is None else images))


def _names(paths: list[Path]) -> list[str]:
    """Names that distinguish the results: the folder's, or the whole path where two would be alike."""
    short = [path.resolve().parent.name if path.stem == "result" else path.stem for path in paths]
    names = [name if short.count(name) == 1 else str(path) for name, path in zip(short, paths, strict=True)]
    if len(set(names)) < len(names):
        raise InputError("the same result is given twice; give each once.")
    return names


def _sources(result: Any, session: Path | None, images: int | None) -> dict[str, Any]:
    """The recording's images by camera, as the given session names them; those that exist.

    What a result names itself is only read where images are asked for: it may be a stranger's, and name any file.
    """
    from twistcap.io.session import load_session

    named = result.config.get("videos") if session is None else load_session(session).videos
    videos = {name: path for name, path in named.items() if isinstance(path, str)} if isinstance(named, dict) else {}
    if images == 0 or (session is None and images is None):
        if images is None and videos:
            how = f"--session SESSION or --images {_FRAMES} shows them"
            terminal.say(f"no images: the result names those of {len(videos)} cameras; {how}.")
        return {}
    return {camera.name: source for camera in result.rig if (source := _source(camera, videos, session)) is not None}


def _source(camera: Any, videos: dict[str, str], session: Path | None) -> Any:
    from twistcap.io.video import check_size, open_source

    path = videos.get(camera.name)
    try:
        source = None if path is None else open_source(path)
    except InputError:
        if session is not None:
            raise
        source = None
    if source is None:
        reason = f"its video {path or ''} is not found: no images; give --session"
        terminal.say(f"camera {camera.name}: {reason}.")
        return None
    check_size(source, camera)
    terminal.say(f"camera {camera.name}: images of {path}")
    return source
