"""What is printed is what was meant: names of files, cameras and joints may look like rich's markup."""

from __future__ import annotations

import pytest

from support.commands import run
from twistcap.commands import terminal

NAME = "walk [2026] [/bold].mp4"


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def test_a_table_shows_names_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.show_table(NAME, [f"column {NAME}"], [[f"cell {NAME}"]])
    row = {"case": NAME, "metric": NAME, "value": 1.5, "unit": "px", "target": "≤ 1", "lost": None, "holds": False}
    terminal.show_rows("rows", [row, row | {"case": "other"}])
    printed = capsys.readouterr().out
    assert printed.count(NAME) == 6 and f"column {NAME}" in printed and f"cell {NAME}" in printed
    assert "1.5" in printed and "[red]" not in printed


def test_progress_shows_names_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.progress(f"films {NAME}", 1) as advance:
        advance(f"camera {NAME}")
    with terminal.status(f"reads {NAME}") as report:
        report(f"pass {NAME}", 1, 2)
    terminal.words.print(f"said {NAME}")
    printed = capsys.readouterr().err
    for text in (f"films {NAME}", f"camera {NAME}", f"reads {NAME}", f"pass {NAME}", f"said {NAME}"):
        assert text in printed


def test_the_settings_are_listed_with_the_tables_that_they_need(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("session", "--explain") == 0
    assert "needs `[motions]`" in " ".join(capsys.readouterr().out.replace("│", " ").split())
