"""What ``twistcap body fit`` does: open, fit, judge, write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twistcap.adjust.body_fit import FitRule, Fitted, Take, fit_body
from twistcap.adjust.body_fit.fields import Build
from twistcap.adjust.body_fit.judge import Agreement, agreement
from twistcap.adjust.body_fit.parametric import Model, carried_pose, matched
from twistcap.body.gltf import save_glb
from twistcap.commands.body import BodyModel
from twistcap.commands.terminal import status, tell_compiling, words
from twistcap.doors.text import read_toml
from twistcap.evaluate.metrics import Row, percentile_known, row
from twistcap.io.files import check_replaceable, keeping
from twistcap.io.pose_file import write_pose
from twistcap.io.recording import Recording, image_masks, open_together
from twistcap.io.session import Session


def fit_sessions(
    sessions: Sequence[Session], source: Path, folder: Path, count: int, model: BodyModel = "session"
) -> dict[str, Any]:
    """Fit the first session's body, or another model in its place, to all of them; what ``--json`` prints."""
    from twistcap.report.bodyfit import draw_fit, write_page

    with keeping(source, [session.model_dump(mode="json") for session in sessions]):
        check_replaceable(*_goals(folder))
    tell_compiling()
    build, anny = None, None
    if model == "anny":
        from twistcap.body.anny import AnnyModel

        anny = AnnyModel()
    with words.status("reading the sessions, fitting the first poses"):
        recordings = open_together(sessions)
        if anny is not None:
            build, recordings = _with_model(anny, recordings)
        takes = [_take(recording) for recording in recordings]
    rule = FitRule(frames=count)
    total = rule.rounds * (sum(len(take.frames) for take in takes) + rule.steps)
    with status("fitting the body") as report:
        notes = iter(range(1, total + 1))
        fitted = fit_body(recordings[0].body, takes, rule, lambda note: report(note, next(notes, total), total), build)
    files = _written(fitted, recordings[0], source, folder)
    with words.status("measuring and drawing"):
        seen = [(take.rig, frames) for take, frames in zip(takes, fitted.frames, strict=True)]
        before = [agreement(fitted.begun, *s, p) for s, p in zip(seen, fitted.begun_poses, strict=True)]
        after = [agreement(fitted.body, *s, p) for s, p in zip(seen, fitted.poses, strict=True)]
        rows = [line for t, a, b in zip(takes, before, after, strict=True) for line in _rows(t.name, a, b)]
        pictures = draw_fit(fitted, takes, folder)
        page = write_page(folder, sessions[0].title, rows, fitted.factors, pictures, files)
    return {"id": "body fit", "rows": rows, "factors": fitted.factors, "files": [*files, *pictures, page]}


def _with_model(model: Model, recordings: Sequence[Recording]) -> tuple[Build, list[Recording]]:
    """The model in place of the sessions' body, of its lengths, and in its first poses."""
    build = matched(model, recordings[0].body)
    body = model.bodies(build.start[None])[0]
    poses = [carried_pose(r.body, r.first_pose, body, r.views.image_rig) for r in recordings]
    return build, [replace(r, body=body, first_pose=p) for r, p in zip(recordings, poses, strict=True)]


def _take(recording: Recording) -> Take:
    session = recording.session
    config = session.tracker_settings
    if config.method == "differential" or config.predictor == "motion":  # the fit looks at contours, and at this person
        config = replace(config, method="direct", predictor="constant_velocity")
    masks = image_masks(session, recording.rig)
    return Take(recording.views.image_rig, recording.views, recording.first_pose, config, session.title, masks)


def _rows(name: str, before: Agreement, after: Agreement) -> list[Row]:
    out: list[tuple[str, str, float, str]] = []
    for case, result in ((f"{name}, before", before), (f"{name}, after", after)):
        for unit, values in (("px", result.px), ("mm", result.mm)):
            out.append((case, "surface to silhouette, mean", float(values.mean()), unit))
            out.append((case, "surface to silhouette, p95", percentile_known(values, 95), unit))
        out += [(case, "IoU with the segmentation", result.iou, ""), (case, "IoU of the visual hulls", result.hull, "")]
    for part, sizes in after.by_part().items():
        out += [(f"{name}, after", f"{part}, {m}", mm, "mm") for m, mm in zip(("mean", "p95"), sizes, strict=True)]
    return [row(*line) for line in out]


def _written(fitted: Fitted, recording: Recording, source: Path, folder: Path) -> list[Path]:
    """The body, the first pose, and a session that takes both (unless the first session has a base itself)."""
    body, pose, session = _goals(folder)
    save_glb(fitted.body, body)
    first = recording.views.indices[0]
    write_pose(pose, fitted.body, fitted.first_poses[0], frame=first)
    if "base" in read_toml(source, "session"):
        return [body, pose]
    text = f"# {source.name} with the body of twistcap body fit. Its pose is that of frame {first}.\n"
    text += f'base = {_quoted(source)}\n\n[body]\nkind = "glb"\npath = {_quoted(body)}\n\n'
    session.write_text(text + f"[first_pose]\nfile = {_quoted(pose)}\n", encoding="utf-8")
    return [body, pose, session]


def _goals(folder: Path) -> tuple[Path, Path, Path]:
    return folder / "body.glb", folder / "first_pose.json", folder / "session.toml"


def _quoted(path: Path) -> str:
    return "'" + str(path.resolve()) + "'"
