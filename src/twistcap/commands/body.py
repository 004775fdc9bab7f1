"""``twistcap body``: make a body of the person who is tracked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words

BodyModel = Literal["session", "anny"]
"""Whose build is fitted."""

body = typer.Typer(name="body", help="Make a body of the person who is tracked.", no_args_is_help=True)


@body.callback()
def common() -> None:
    """Make a body of the person who is tracked."""


@body.command()
def keyviews(
    views: Annotated[Path, typer.Argument(help="TOML that names the four pictures.", metavar="KEYVIEWS.toml")],
    out: Annotated[Path, typer.Option(help="Folder for all files.")] = Path("body"),
) -> None:
    """Build a rigged body from four calibrated key views: front, side, from above, and elbows bent.

    Writes body.glb, which a session reads ([body] kind = "glb"), and steps.png, which shows every step.

    Examples:

      twistcap body keyviews anna.toml --out anna
    """
    from twistcap.acquire.build import build
    from twistcap.acquire.measure import measure
    from twistcap.body.gltf import save_glb
    from twistcap.io.keyviews import read_key_views
    from twistcap.report.acquire import draw_silhouettes, draw_steps

    key_views, line = read_key_views(views)
    folder = terminal.output_folder(out)
    page = draw_silhouettes(key_views, folder / "steps.png")  # what there is to see if a later step fails
    acquired = build(measure(key_views, line))
    page = draw_steps(key_views, acquired, folder / "steps.png")
    save_glb(acquired.body, folder / "body.glb")
    terminal.say(f"stature {acquired.measured.stature:.3f} m. Wrote {folder / 'body.glb'}. Look at {page}.")


@body.command()
def silhouettes(
    views: Annotated[Path, typer.Argument(help="TOML that names the four pictures.", metavar="KEYVIEWS.toml")],
    port: terminal.Port = 0,
) -> None:
    """Cut the person out of the key views in the browser: draw a rectangle, then paint person and background.

    Writes the mask that each view names, or KEYVIEWS_ROLE_mask.png in the folder of the file. It starts from
    background pictures or earlier masks, if there are any.

    Examples:

      twistcap body silhouettes anna.toml

      twistcap body silhouettes anna.toml --port 8765    # on a remote machine: ssh -L 8765:127.0.0.1:8765 HOST
    """
    from twistcap.commands.view import serve
    from twistcap.pages.assemble import page

    with words.status("reading the pictures"):
        cutting = cutting_of(views)
        html = page("cut", f"Silhouettes of {views.stem}", cutting.document())
    serve(html, cutting.answers, port)


def cutting_of(path: Path) -> Any:
    """What `silhouettes` serves. Raises InputError: whatever is wrong with the file or its pictures."""
    from twistcap.io.keyviews import read_uncut
    from twistcap.pages.cutting import Cutting, CutView

    uncut = read_uncut(path)
    notes = {r: "" if u.named else f'Put mask = "{u.target.name}" into [views.{r}].' for r, u in uncut.items()}
    return Cutting({role: CutView(u.image, u.target, u.known) for role, u in uncut.items()}, notes)


@body.command()
def fit(
    sessions: Annotated[
        list[Path],
        typer.Argument(help="Sessions of one person. The body of the first one is fitted.", metavar="SESSION"),
    ],
    out: Annotated[Path, typer.Option(help="Folder for all files.")] = Path("body"),
    frames: Annotated[str | None, typer.Option(help="FIRST:LAST of the first session, both included.")] = None,
    count: Annotated[int, typer.Option("--fit-frames", min=1, help="Most frames of each session to use.")] = 20,
    model: Annotated[
        BodyModel, typer.Option(help="The session's body, or the Anny body (extra twistcap[anny]).")
    ] = "session",
    json: terminal.Json = False,
) -> None:
    """Fit a session's body to all its views: lengths, girths, cross-sections and a smooth offset.

    Writes body.glb, first_pose.json, session.toml (the session with both), before.png, after.png and report.html.
    The silhouettes are the tracker's own. If [fit_girths] names masks, its frames are fitted to the masks.

    Examples:

      twistcap body fit anna.toml --frames 0:59 --out anna

      twistcap body fit walk.toml t_pose.toml --out anna

      twistcap body fit anna.toml --model anny --out anna
    """
    from twistcap.commands.bodyfit import fit_sessions
    from twistcap.io.session import load_session

    spans = [terminal.frame_range(frames), *[None] * (len(sessions) - 1)]
    loaded = [load_session(path, {"frames": span}) for path, span in zip(sessions, spans, strict=True)]
    document: dict[str, Any] = fit_sessions(loaded, sessions[0], terminal.output_folder(out), count, model)
    if json:
        terminal.emit(document)
        return
    terminal.show_rows("body fit", document["rows"])
    for path in document["files"]:
        typer.echo(path)
