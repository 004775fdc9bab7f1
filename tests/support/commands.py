"""Commands run in this process."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any, NoReturn

import pytest

from twistcap.cli import main


def run(*arguments: object) -> int:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as done:
        main([str(a) for a in arguments])
    return int(done.value.code or 0)


def document(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """What a command prints with --json: one document, alone on stdout."""
    capsys.readouterr()
    assert run(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one sentence of a refusal: exit code 2, nothing on stdout, no traceback."""
    capsys.readouterr()
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if line.startswith("twistcap: ")]
    assert out == "" and len(lines) == 1 and "Traceback" not in err, err
    return lines[0]


def replace_text(path: Path, old: str, new: str) -> None:
    """The first `old` of a file, which it must have, becomes `new`."""
    text = path.read_text()
    assert old in text, text
    path.write_text(text.replace(old, new, 1))


def interrupted(*_: object) -> NoReturn:
    """What Ctrl-C does to a step. A signal would not: a shell's background job ignores it."""
    raise KeyboardInterrupt


def heeds_interrupts() -> None:
    """Before a command: what a shell starts in the background ignores them, and so would all that it starts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
