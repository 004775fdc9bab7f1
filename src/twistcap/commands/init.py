"""``twistcap init``: the first pose from joints that are clicked in the browser."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.commands.view import serve
from twistcap.errors import InputError


def init(
    session: Annotated[Path, typer.Argument(help="Session TOML.", metavar="SESSION")],
    out: Annotated[Path | None, typer.Option(help="Pose file (.json) to write. Default: the session's own.")] = None,
    detector: Annotated[
        str | None, typer.Option(help="Keypoint detector to start from: MODEL.onnx, or the name of one.")
    ] = None,
    people: Annotated[str | None, typer.Option(help="With --detector RTMPose: a YOLOX that finds people.")] = None,
    auto: Annotated[bool, typer.Option("--auto", help="Start from the pose that is found in the images.")] = False,
    port: terminal.Port = 0,
) -> None:
    """Click joints of the first frame in two or more views. The body follows, and SESSION reads what you save.

    Examples:

      twistcap init walk/session.toml

      twistcap init walk/session.toml --auto

      twistcap init walk/session.toml --detector rtmo.onnx

      twistcap init walk/session.toml --port 8765    # on a remote machine: ssh -L 8765:127.0.0.1:8765 HOST
    """
    from twistcap.io.session import load_session
    from twistcap.pages.assemble import page

    with words.status("reading the first frame of every view"):
        loaded = load_session(session)
        clicking = clicking_of(loaded, session, out, detector, people)
        if auto:
            start_unaided(clicking)
        html = page("init", f"First pose of {session.parent.resolve().name}", clicking.document())
    terminal.say(f"Save writes {clicking.target.path}.")
    serve(html, {**clicking.answers, "/save": partial(save, clicking)}, port)


def save(clicking: Any, question: Mapping[str, Any]) -> Mapping[str, Any]:
    """Save, and show in the terminal how well the saved pose fits."""
    from twistcap.commands.start import show_start

    answer = clicking.answers["/save"](question)
    show_start(clicking.reported)
    return answer


def clicking_of(
    session: Any, path: Path, out: Path | None = None, detector: str | None = None, people: str | None = None
) -> Any:
    """What `init` serves, with existing clicks or keypoints.

    InputError for session, videos, detector or `out`, and for a camera alone without a saved pose.
    """
    from twistcap.adjust.first_pose.keypoints import check_views
    from twistcap.io.detectors import detected
    from twistcap.io.recording import body_of, rig_of, views_of
    from twistcap.io.unaided import silhouettes_of
    from twistcap.pages.clicking import Clicking, clicks_of

    rig, body = rig_of(session), body_of(session)
    views = views_of(session, rig)
    images = views.recorded(views.indices[0])
    target = target_of(session, path, out)
    clicking = Clicking(session, rig, images, body, target, silhouettes_of(session, views))
    keypoints = detected(detector, images, rig, people) if detector is not None else _known(session, clicking, views)
    if keypoints is not None:
        clicking.clicks = clicks_of(keypoints, rig, body.landmarks.names)
    _with_saved_pose(clicking)
    if clicking.shown is None:
        check_views(rig)
    return clicking


def start_unaided(clicking: Any) -> None:
    """Show the pose that is found in the images; InputError where none is clear."""
    from twistcap.body import Posed
    from twistcap.io.recording import floor_of, views_of
    from twistcap.io.unaided import found_unaided

    session, views = clicking.session, views_of(clicking.session, clicking.rig)
    proof = found_unaided(session, clicking.generic, views, floor_of(session))
    clicking.shown = Posed(clicking.generic, proof.first)


def target_of(session: Any, path: Path, out: Path | None) -> Any:
    """Where to write, and what the user must still change in the session."""
    from twistcap.pages.clicking import Target

    table = session.first_pose
    if out is not None and out.suffix.lower() != ".json":
        raise InputError(f"--out is {out}; a pose is written as JSON, so name a file that ends in .json.")
    if out is not None:
        read = session.model_dump(mode="json", exclude={"first_pose": {"file"}})
        terminal.output_file(out, "--out", ".json", read)  # before the clicks
    if out is None and table.file is not None and Path(table.file).suffix.lower() == ".json":
        return Target(Path(table.file), "file")
    if out is None and table.clicks is not None:
        return Target(Path(table.clicks), "clicks")
    chosen = out or path.parent / "first_pose.json"
    if out is None and chosen.exists():
        raise InputError(f"{chosen} exists, and {path} does not read it; name another file with --out.")
    note = f'The session does not read this file: put [first_pose] file = "{chosen.name}" into {path.name}.'
    if out is None and table.unaided and not table.auto:
        return Target(chosen, "file")
    same = table.file is not None and Path(table.file).resolve() == chosen.resolve()
    return Target(chosen, "file", "" if same else note)


def _known(session: Any, clicking: Any, views: Any) -> Any:
    """Earlier clicks, or the keypoints that the session names or has detected, of the nearest frame."""
    from twistcap.io.keypoints import read_clicks
    from twistcap.io.recording import detections_of, keypoints_of
    from twistcap.pages.clicking import clicks_beside

    path = clicking.target.path
    earlier = path if clicking.target.kind == "clicks" else clicks_beside(path)
    if earlier.is_file():
        return read_clicks(earlier, clicking.rig.names, clicking.generic.landmarks.names)
    first = views.indices[0]
    if (detector := session.first_pose.detector) is not None:
        near = min(detector.frames or (first,), key=lambda frame: abs(frame - first))
        return detections_of(detector.model_copy(update={"frames": (near,)}), clicking.rig, views)[0]
    table = session.first_pose.keypoints
    if table is None:
        return None
    nearest = min(range(len(table.frames)), key=lambda k: abs(table.frames[k] + table.offset - first))
    return keypoints_of(table, clicking.rig, views)[nearest]


def _with_saved_pose(clicking: Any) -> None:
    """Start from the pose that was saved before, with its sliders."""
    from twistcap.body import Posed
    from twistcap.io.pose_file import body_at, read_pose, read_proportions

    path = clicking.target.path
    if clicking.target.kind == "file" and path.is_file():
        body = body_at(path, clicking.generic)
        clicking.shown = Posed(body, read_pose(path, body))
        clicking.proportions = read_proportions(path) or clicking.proportions
