"""``twistcap view``: results in the browser, or as one HTML file."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.errors import InputError


def view(
    results: Annotated[list[Path], typer.Argument(help="One or more result.h5.", metavar="RESULT...")],
    save: Annotated[Path | None, typer.Option(help="Write one HTML file and serve nothing.")] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Truth to show too: .npz, .trc, .mot or .sto.", metavar="REF")
    ] = None,
    session: Annotated[Path | None, typer.Option(help="Session that names the videos, if they have moved.")] = None,
    width: Annotated[int, typer.Option(min=32, help="Largest width of the images, px.")] = 360,
    images: Annotated[int, typer.Option(min=0, help="Most frames with images; 0 for none.")] = 120,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on 127.0.0.1; 0 chooses a free one.")] = 0,
    json: terminal.Json = False,
) -> None:
    """Look at results: body in 3D, cameras with their images and outlines, joint angles with ± 2σ, lost frames.

    Examples:

      twistcap view out/walk/result.h5

      twistcap view out/direct/result.h5 out/levelset/result.h5 --reference truth.npz

      twistcap view out/walk/result.h5 --save walk.html
    """
    from twistcap.io.files import replacing

    page = _page(results, reference, session, width, images)
    if save is None:
        serve(page, {}, port)
        return
    with replacing(save) as part:
        part.write_text(page, encoding="utf-8")
    if json:
        terminal.emit({"id": "view", "file": save, "bytes": save.stat().st_size})
    else:
        typer.echo(save)


def serve(page: str, answers: Any, port: int) -> None:
    """Serve until Ctrl-C; the address goes to stdout."""
    from twistcap.pages.server import page_server

    with page_server(page, answers, port) as server:
        typer.echo(f"http://127.0.0.1:{server.server_address[1]}/")
        words.print("Open the page at this address. Ctrl-C ends. From another machine: ssh -L PORT:127.0.0.1:PORT HOST")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            words.print("closed")


def _page(paths: list[Path], reference: Path | None, session: Path | None, width: int, images: int) -> str:
    from twistcap.evaluate.load import load_reference
    from twistcap.evaluate.reference import frame_times
    from twistcap.io.result import read_result
    from twistcap.pages.viewer import Options, view_page

    results = dict(zip(_names(paths), map(read_result, paths), strict=True))
    first = next(iter(results.values()))
    with words.status("reading images, drawing outlines"):
        sources = _sources(first, session) if images else {}
        truth = None if reference is None else load_reference(reference, first.body, partial(frame_times, first))
        title = next(iter(results)) if len(results) == 1 else "twistcap: " + ", ".join(results)
        return view_page(results, sources, truth, title, Options(width, images))


def _names(paths: list[Path]) -> list[str]:
    """Names that distinguish the results: the folder's, or the whole path where two would be alike."""
    short = [path.resolve().parent.name if path.stem == "result" else path.stem for path in paths]
    names = [name if short.count(name) == 1 else str(path) for name, path in zip(short, paths, strict=True)]
    if len(set(names)) < len(names):
        raise InputError("the same result is given twice; give each once.")
    return names


def _sources(result: Any, session: Path | None) -> dict[str, Any]:
    """The recording's images by camera, as the session or the result itself names them; those that exist."""
    from twistcap.io.session import load_session
    from twistcap.io.video import open_source

    videos = load_session(session).videos if session is not None else result.config.get("videos", {})
    sources: dict[str, Any] = {}
    for camera in result.rig:
        path = videos.get(camera.name)
        try:
            source = None if path is None else open_source(path)
        except InputError:
            if session is not None:
                raise
            source = None
        if source is None:
            words.print(f"camera {camera.name}: its video {path or ''} is not found: no images; give --session.")
        elif source.size != camera.size:
            had = f"camera {camera.name!r} had {camera.size}"
            raise InputError(f"video {path} is {source.size} px, but {had}; give the original video.")
        else:
            sources[camera.name] = source
    return sources
