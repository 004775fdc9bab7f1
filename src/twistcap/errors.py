"""The one exception that a user's input can cause."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf


class InputError(ValueError):
    """Bad input, described in one sentence that names the file, the field and what to do.

    The command line prints the sentence alone and exits with code 2.
    """


def check(where: str, holds: object, message: str) -> None:
    """Raise an InputError of a place and a message, without its full stop, where something does not hold."""
    if not holds:
        raise InputError(f"{where}: {message}.")


def check_numbers(
    where: str, settings: object, positive: tuple[str, ...] = (), not_negative: tuple[str, ...] = ()
) -> None:
    """Check fields of settings when these are made.

    Args:
        where: what they are settings of, for the message.
        settings: their holder.
        positive: names of fields that must be finite and above 0.
        not_negative: names of fields that must be finite and 0 or more.

    Raises:
        InputError: for the first field that is not; NaN never is.
    """
    for name in (*positive, *not_negative):
        value = getattr(settings, name)
        if not (0 <= value < inf) or (value == 0 and name in positive):
            bound = "above 0" if name in positive else "of 0 or more"
            raise InputError(f"{where}: {name} is {value}; it must be a finite number {bound}.")


def check_choice(where: str, value: object, choices: Iterable[object]) -> None:
    """Check that a value is one of those known.

    Raises:
        InputError: where it is not, with those that are.
    """
    known = list(choices)
    if value not in known:
        raise InputError(f"{where} is {value!r}; it must be one of {', '.join(map(str, known))}.")
