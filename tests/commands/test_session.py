"""`twistcap session`: a session checked, and the settings listed as they are in code and docs."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from support.commands import document, refusal, run
from twistcap.settings import Settings

PAGE = Path(__file__).parents[2] / "docs" / "formats" / "settings.md"


def test_every_setting_is_listed_with_its_default(capsys: pytest.CaptureFixture[str]) -> None:
    listed = {row["key"]: row for row in document(capsys, "session", "--explain")["settings"]}
    page = " ".join(PAGE.read_text(encoding="utf-8").split())
    assert len(listed) <= 45
    for item in fields(Settings):
        if item.name != "differential":
            row = listed[f"tracker.{item.name}"]
            assert len(row["meaning"]) > 20
            assert f"**`{item.name}`** (`{row['default']}`):" in page, f"docs/formats/settings.md lacks {item.name}"
    assert any(key.startswith("tracker.differential.") for key in listed)


def test_the_list_is_readable(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("session", "--explain") == 0
    assert "tracker.surface_sigma" in capsys.readouterr().out


def test_a_session_is_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no file is named" in refusal(capsys, "session")
    assert run("studio", tmp_path / "walk", "--size", "96x70", "--views", "2", "--frames", "2") == 0
    found = document(capsys, "session", tmp_path / "walk" / "session.toml")
    assert len(found["cameras"]) == 2
    assert run("session", tmp_path / "walk" / "session.toml") == 0
