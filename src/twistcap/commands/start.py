"""How well the first pose fits, as `new`, `init` and `track` show it."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from twistcap.commands.terminal import number, say, words
from twistcap.io.start_report import StartReport

_SAME = 0.005  # a length factor that differs less is not shown


def show_start(report: StartReport | None) -> None:
    """Print residuals, stature, length factors and warnings on stderr; nothing where nothing was fitted."""
    if report is None:
        return
    words.print("First pose: px between keypoint and body, the worst joints", style="bold", soft_wrap=True)
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("joint")
    for name in report.cameras:
        table.add_column(name, justify="right")
    for joint, residual in report.worst():
        table.add_row(joint, *(number(px, ".1f") for px in residual))
    table.add_row(f"median of {len(report.names)}", *(number(px, ".1f") for px in report.medians), style="bold")
    words.print(table)
    for sentence in (*sizes_in_words(report), *report.warnings):
        say(sentence)


def sizes_in_words(report: StartReport) -> list[str]:
    """Stature and length factors, a sentence each."""
    fitted = abs(report.stature - report.stated) > 0.001
    height = f"fitted {report.stature:.2f} m, stated {report.stated:.2f} m" if fitted else f"{report.stated:.2f} m"
    odd = {name: factor for name, factor in report.lengths.items() if abs(factor - 1) > _SAME}
    listed = ", ".join(f"{name} {factor:.2f}" for name, factor in odd.items())
    return [f"Stature: {height}.", f"Length factors: {listed}." if odd else "Lengths: those of the body."]


def start_document(report: StartReport | None) -> dict[str, Any] | None:
    """The same as data, for ``--json``."""
    if report is None:
        return None
    return {
        "median_px": dict(zip(report.cameras, report.medians, strict=True)),
        "worst_px": {joint: dict(zip(report.cameras, px, strict=True)) for joint, px in report.worst()},
        "stature_m": report.stature, "stated_m": report.stated, "lengths": report.lengths, "warnings": report.warnings,
    }  # fmt: skip
