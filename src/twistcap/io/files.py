"""Text and NPZ out; what cannot be written is an `InputError` in one sentence. What comes in: see `twistcap.doors`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.errors import InputError


def write_lines(path: Path, lines: Sequence[str]) -> None:
    """A text file, each line ended."""
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error


def write_npz(path: str | Path, what: str, **arrays: Any) -> Path:
    """A compressed NPZ at that very path; `what` it is stands in messages."""
    path = Path(path)
    try:
        with path.open("wb") as file:  # a path without .npz would be given one
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise InputError(f"{what} {path} cannot be written: {error.strerror}; choose another path.") from error
    return path
