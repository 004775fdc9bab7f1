"""The one exception that a user's input can cause."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from os import PathLike

_LONGEST = 299  # characters of a sentence
_TAIL = 100  # of them that are kept of the end of a longer one: its mend
_END = 60  # characters of a long path that a longer sentence keeps: the file's name is there


class InputError(ValueError):
    """Bad input, described in one sentence that names the file, the field and what to do.

    The command line prints the sentence alone and exits with code 2. What a stranger's file has put into it can neither
    make it long nor steer a terminal.
    """

    def __init__(self, message: str) -> None:
        text = "".join(c if c.isprintable() else " " for c in message)
        text = text if len(text) <= _LONGEST else _with_short_paths(text)
        super().__init__(text if len(text) <= _LONGEST else f"{text[: _LONGEST - _TAIL - 3]} … {text[-_TAIL:]}")


def _with_short_paths(text: str) -> str:
    """Text with the end alone of each long path in it."""
    return " ".join(f"…{word[-_END:]}" if "/" in word and len(word) > _END else word for word in text.split(" "))


def check(where: str, holds: object, message: str) -> None:
    """Raise an InputError of a place and a message, without its full stop, where something does not hold."""
    if not holds:
        raise InputError(f"{where}: {message}.")


@contextmanager
def naming(source: str | PathLike[str]) -> Generator[None]:
    """Whatever `InputError` is raised inside names the file `source`."""
    try:
        yield
    except InputError as error:
        if str(source)[-_END // 2 :] in str(error):  # a long path may stand there by its end
            raise
        raise InputError(f"{source}: {error}") from error


def check_choice(where: str, value: object, choices: Iterable[object]) -> None:
    """Check that a value is one of those known. Raises InputError where it is not, with those that are."""
    known = list(choices)
    if value not in known:
        raise InputError(f"{where} is {value!r}; it must be one of {', '.join(map(str, known))}.")
