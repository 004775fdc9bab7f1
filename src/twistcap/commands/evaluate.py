"""``twistcap evaluate``: a result against a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import number
from twistcap.errors import check_choice

if TYPE_CHECKING:
    from twistcap.evaluate.agreement import Agreement, Distance
    from twistcap.io.markers import WorldAxes


def evaluate(
    result: terminal.ResultFile,
    reference: Annotated[
        Path, typer.Option(help="Truth or keypoints (.npz), .trc, .c3d, .mot, .sto, or a folder CAM/frame_XXXX.png.")
    ],
    time_offset: Annotated[float, typer.Option(help="Seconds to add to the reference's clock.")] = 0.0,
    exclude: Annotated[list[str] | None, typer.Option(help="Part to ignore: NAME or NAME:FIRST-LAST (rows).")] = None,
    axes: Annotated[str, typer.Option(help="World of a TRC or C3D: opensim, pose2sim, z_up.")] = "opensim",
    align: Annotated[
        bool, typer.Option("--align", help="Move the reference's clock to where the motions agree.")
    ] = False,
    register: Annotated[bool, typer.Option("--register", help="Turn and move the reference's world likewise.")] = False,
    json: terminal.Json = False,
) -> None:
    """Compare a result with a reference: angles (deg), joint positions (mm), silhouettes (IoU), lost frames.

    Angles and positions are given raw, and with the constant offset of each joint removed; then for each joint, with
    bias, limits of agreement and CMC. A frame is lost where a joint is over 150 mm off, the sequence where joints are
    over 20 mm off on average.

    Examples:

      twistcap evaluate out/result.h5 --reference /tmp/walk/truth.npz

      twistcap evaluate out/result.h5 --reference joints.trc --time-offset 0.0217 --exclude wrist_r:76-79

      twistcap evaluate out/result.h5 --reference vicon.c3d --axes z_up --align --register

      twistcap evaluate out/result.h5 --reference masks --json
    """
    from twistcap.evaluate.reference import evaluate as compare
    from twistcap.io.markers import TO_FILE

    check_choice("--axes", axes, TO_FILE)
    comparison = compare(
        terminal.tracked(result), reference, time_offset, exclude=exclude or (), axes=cast("WorldAxes", axes),
        align=align, register=register,
    )  # fmt: skip
    if json:
        terminal.emit({"id": "evaluate", **comparison.as_dict()})
        return
    terminal.show_rows(f"{result} against {reference}", comparison.rows)
    if comparison.angles:
        _show_agreements(comparison.agreements)
    if comparison.joints:
        _show_distances(comparison.distances)
    for note in comparison.notes:
        terminal.say(f"note: {note}")


def _show_agreements(found: list[Agreement]) -> None:
    columns = ["angles, deg", "bias", "lower", "upper", "RMSE", "less\nbias", "r", "CMC"]
    rows = [
        [a.name, number(a.bias), number(a.lower), number(a.upper), number(a.rmse), number(a.rmse_offset_removed),
         number(a.correlation, ".3f"), number(a.cmc, ".3f")]
        for a in found
    ]  # fmt: skip
    terminal.show_table("Result less reference: bias, limits of agreement (±1.96 SD), …", columns, rows, columns[:1])


def _show_distances(found: list[Distance]) -> None:
    columns = ["joints, mm", "mean", "RMSE", "p95", "mean, offset removed"]
    rows = [[d.name, *(number(x, ".1f") for x in (d.mean, d.rmse, d.p95, d.offset_removed))] for d in found]
    terminal.show_table("Distances", columns, rows, columns[:1])
