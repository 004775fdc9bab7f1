"""``twistcap session``: what a session file says, and what can be set of the tracker."""

from __future__ import annotations

import re
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError


def session(
    session: Annotated[Path | None, typer.Argument(help="Session TOML to check.", metavar="[SESSION]")] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="List the keys of [tracker] with units and defaults.")
    ] = False,
    json: terminal.Json = False,
) -> None:
    """Check a session file and all that it names, or list the settings of the tracker.

    Examples:

      twistcap session walk/session.toml

      twistcap session --explain
    """
    if explain:
        _print_settings(json)
        return
    if session is None:
        raise InputError("session: no file is named; give a session.toml, or --explain.")
    from twistcap.io.recording import body_in_words, rate_in_words
    from twistcap.io.session import load_session
    from twistcap.io.session_check import check_session

    loaded = load_session(session)
    views = check_session(loaded)
    changed = {name: value for name, value in vars(loaded.tracker_settings).items() if name in loaded.tracker}
    body = body_in_words(loaded)
    document = {"id": "session", "session": session, "cameras": sorted(loaded.videos), "tracker": changed, "body": body}
    if json:
        terminal.emit(document)
        return
    terminal.say(f"{session} is a session with {len(loaded.videos)} videos: {', '.join(sorted(loaded.videos))}")
    for said in filter(None, (rate_in_words(loaded, views), body)):
        terminal.say(said)
    terminal.say(f"settings of the tracker that it changes: {', '.join(changed) or 'none'}")


def explained(settings: type[Any], prefix: str = "tracker") -> list[dict[str, str]]:
    """Key, default and meaning of every setting of a dataclass, those of the tables in it included."""
    texts, hints, rows = _attributes(settings.__doc__ or ""), get_type_hints(settings), list[dict[str, str]]()
    for item in fields(settings):
        key = f"{prefix}.{item.name}"
        if is_dataclass(hints[item.name]):
            rows += explained(hints[item.name], key)
        else:
            rows.append({"key": key, "default": _default(item), "meaning": texts[item.name]})
    return rows


def _attributes(docstring: str) -> dict[str, str]:
    """Name to text of the ``Attributes:`` section."""
    section = docstring.partition("Attributes:")[2]
    entries = re.split(r"\n        (?=\w[\w, ]*: )", section)
    out: dict[str, str] = {}
    for entry in entries[1:]:
        names, _, text = entry.partition(": ")
        out.update((name.strip(), " ".join(text.split())) for name in names.split(","))
    return out


def _default(item: Field[Any]) -> str:
    value = item.default if item.default is not MISSING else "(table)"
    return "by method" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _print_settings(json: bool) -> None:
    from twistcap.settings import Settings

    rows = explained(Settings)
    if json:
        terminal.emit({"id": "settings", "settings": rows})
        return
    columns = ("key", "default", "what it is")
    terminal.show_table("Settings of the tracker", columns, [tuple(row.values()) for row in rows], columns)
