"""``twistcap evaluate``: a result against a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from twistcap.commands import terminal

if TYPE_CHECKING:
    from twistcap.io.markers import WorldAxes


def evaluate(
    result: Annotated[Path, typer.Argument(help="result.h5 of a track.", metavar="RESULT")],
    reference: Annotated[
        Path, typer.Option(help="Truth or keypoints (.npz), .trc, .mot, .sto, or a folder CAM/frame_XXXX.png.")
    ],
    time_offset: Annotated[float, typer.Option(help="Seconds to add to the reference's clock.")] = 0.0,
    exclude: Annotated[list[str] | None, typer.Option(help="Part to ignore: NAME or NAME:FIRST-LAST (rows).")] = None,
    axes: Annotated[str, typer.Option(help="World of a TRC: opensim, pose2sim, z_up.")] = "opensim",
    json: terminal.Json = False,
) -> None:
    """Compare a result with a reference: angles (deg), joint positions (mm), silhouettes (IoU), lost frames.

    Angles and positions are given raw, and with the constant offset of each joint removed.

    Examples:

      twistcap evaluate out/result.h5 --reference /tmp/walk/truth.npz

      twistcap evaluate out/result.h5 --reference joints.trc --time-offset 0.0217 --exclude wrist_r:76-79

      twistcap evaluate out/result.h5 --reference masks --json
    """
    from twistcap.evaluate.reference import evaluate as compare
    from twistcap.io.result import read_result

    comparison = compare(
        read_result(result), reference, time_offset, exclude=exclude or (), axes=cast("WorldAxes", axes)
    )
    if json:
        terminal.emit({"id": "evaluate", **comparison.as_dict()})
        return
    terminal.show_rows(f"{result} against {reference}", comparison.rows)
    for note in comparison.notes:
        terminal.words.print(f"note: {note}")
