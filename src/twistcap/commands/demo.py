"""``twistcap demo``: render, track and report a synthetic walk whose truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.errors import InputError

if TYPE_CHECKING:
    from twistcap.commands.follow import Timing


def demo(
    out: Annotated[Path, typer.Option(help="Folder for all files.")] = Path("demo"),
    frames: Annotated[int, typer.Option(min=2, help="Number of frames, at 60 per second.")] = 60,
    views: Annotated[int, typer.Option(min=1, max=8, help="Number of cameras.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Number that chooses person, room and walk.")] = 0,
    mismatch: Annotated[bool, typer.Option("--mismatch", help="Girths, joints and cameras a little wrong.")] = False,
    method: Annotated[str, typer.Option(help="direct or levelset.")] = "direct",
    json: terminal.Json = False,
) -> None:
    """Render a walk in several views, track it, and compare the result with the truth.

    Writes result.h5, overlay.mp4, angles.png, joint_errors.png, joints.trc, angles.csv and report.html.

    Examples:

      twistcap demo

      twistcap demo --out /tmp/demo --views 2 --seed 3

      twistcap demo --mismatch --json
    """
    document = run_demo(terminal.output_folder(out), frames, views, seed, mismatch, method)
    if json:
        terminal.emit(document)
        return
    terminal.show_rows("The studio walk against its truth", document["rows"])
    words.print(f"{document['ms_per_frame']:.1f} ms per frame (median, without rendering)")
    terminal.say(f"Look at {document['report']}.")


def run_demo(
    folder: Path, frames: int = 60, views: int = 4, seed: int = 0, mismatch: bool = False, method: str = "direct"
) -> dict[str, Any]:
    """The demo's files in a folder; what ``--json`` prints."""
    from twistcap.build import build
    from twistcap.commands.follow import follow, held
    from twistcap.io.lock import WriteLock
    from twistcap.io.result import ResultWriter, read_result
    from twistcap.io.session import tracker_settings
    from twistcap.studio import StudioConfig, capture
    from twistcap.track import Tracker

    settings = tracker_settings({"method": method}, "the command line")
    path = folder / "result.h5"
    terminal.tell_compiling()
    with WriteLock(path) as lock:
        if (done := held(path)) is not None and "demo" not in done.config:
            raise InputError(f"{path} holds {len(done)} tracked frames; choose another folder with --out.")
        scene = capture(StudioConfig(seed, views, frames=frames, condition="mismatch" if mismatch else "exact"))
        pictures: list[Any] = []
        with terminal.progress("rendering", frames) as advance:
            for frame in scene.frames():
                pictures.append(frame)
                advance("")
        tracker = Tracker(build(scene.body, scene.rig, settings))
        tracker.start(scene.first_pose, pictures[0].time)
        recorded = {"demo": {"seed": seed, "views": views, "mismatch": mismatch}, "tracker": {"method": method}}
        with ResultWriter(path, scene.body, scene.rig, recorded, room=frames, lock=lock) as writer:
            timing = follow(pictures, frames, tracker, writer)
        return _reported(scene, pictures, read_result(path), folder, timing)


def _reported(scene: Any, pictures: list[Any], result: Any, folder: Path, timing: Timing) -> dict[str, Any]:
    from twistcap.commands import outputs
    from twistcap.evaluate.load import load_reference
    from twistcap.evaluate.reference import compare
    from twistcap.io.exports import export
    from twistcap.io.synthetic import write_truth
    from twistcap.report.page import Headline, headline_rows
    from twistcap.report.plots import joint_error_plot
    from twistcap.report.verdict import chosen_rows

    with words.status("writing plots, exports and the overlay"):
        write_truth(scene, folder / "truth.npz")
        truth = load_reference(folder / "truth.npz", result.body, lambda rows: result.times[:rows])
        comparison = compare(result, truth, "studio walk")
        exports = [export(result, kind, folder) for kind in ("trc", "csv")]
        plots = {outputs.write_angle_plot(result, folder, truth): "Joint angles (± 2σ) and the truth, dashed"}
        if errors := comparison.joints:
            plot = joint_error_plot(folder / "joint_errors.png", result.times, errors.names, errors.raw)
            plots[plot] = "Joint position errors"
        video = outputs.write_overlay(result, pictures, scene.rig.pinhole(), folder, scene.config.fps, "twistcap demo")
        units = {row["unit"]: row["metric"] for row in reversed(comparison.rows)}  # the first of each
        wanted = {units[unit]: units[unit] for unit in ("deg", "mm", "frames") if unit in units}
        wanted |= {"KHE": "error of knees, hips and elbows"}
        speed = Headline("per frame, without decoding", f"{timing.median:.0f}", "ms")
        lead = f"A synthetic walk in {len(scene.rig)} views, tracked from its first pose and compared with its truth."
        headlines = [*headline_rows(comparison.rows, wanted), speed]
        chosen = set(result.indices[chosen_rows(result)].tolist())
        stills = outputs.stills_of(result, [f for f in pictures if f.index in chosen], scene.rig.pinhole())
        page = outputs.write_page(folder, "twistcap demo", lead, headlines, comparison.rows, plots, result, stills)
    path = folder / "result.h5"
    about = {"id": "demo", "rows": comparison.rows, "ms_per_frame": timing.median, "result": path, "report": page}
    return about | {"files": [path, *exports, *plots, video, page]}
