"""Settings whose numbers are checked when they are made: what cannot be meant is refused in one sentence.

A float must be finite and 0 or more, an int a whole number of 0 or more, unless the annotation of the field is
one of the narrower or wider kinds below. Neither may be beyond `_GREATEST`.
"""

from __future__ import annotations

import types
from dataclasses import dataclass, fields
from functools import cache
from numbers import Integral, Real
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from twistcap.doors.text import brief
from twistcap.errors import InputError

_GREATEST = 1e6
_LEAST = 1e-9  # of what must be above 0


@dataclass(frozen=True)
class Range:
    """Of finite numbers, both ends included."""

    least: float = 0.0
    most: float = _GREATEST

    def __str__(self) -> str:
        if self.most == _GREATEST:
            return "above 0" if self.least == _LEAST else f"from {self.least:g} on, and not huge"
        return f"above 0, at most {self.most:g}" if self.least == _LEAST else f"from {self.least:g} to {self.most:g}"


Positive = Annotated[float, Range(_LEAST)]
Share = Annotated[float, Range(0.0, 1.0)]
PartOfOne = Annotated[float, Range(_LEAST, 1.0)]
Signed = Annotated[float, Range(-_GREATEST)]
Count = Annotated[int, Range(1, 1e5)]


class Checked:
    """The base of dataclasses of settings. One that has a ``__post_init__`` of its own calls this one too."""

    def __init_subclass__(cls, where: str = "", **others: Any) -> None:
        """`where` is what messages call these settings; the name of the class where none is given."""
        super().__init_subclass__(**others)
        cls._where = where or cls.__name__

    def __post_init__(self) -> None:
        """Raises InputError for the first number that is of another type, not finite, or out of its range."""
        for name, hint in _numeric(type(self)):
            fault = _fault(getattr(self, name), hint)
            if fault:
                raise InputError(f"{self._where}: {name} is {brief(getattr(self, name))}; it must be {fault}.")


@cache
def _numeric(kind: type[Any]) -> tuple[tuple[str, Any], ...]:
    hints = get_type_hints(kind, include_extras=True)
    return tuple((field.name, hints[field.name]) for field in fields(kind) if _is_numeric(hints[field.name]))


def _is_numeric(hint: Any) -> bool:
    if get_origin(hint) is Annotated:
        return isinstance(hint.__metadata__[0], Range)
    if get_origin(hint) in (Union, types.UnionType, tuple):
        kinds = [argument for argument in get_args(hint) if argument not in (type(None), Ellipsis)]
        return bool(kinds) and all(_is_numeric(argument) for argument in kinds)
    return hint in (float, int)


def _fault(value: Any, hint: Any) -> str | None:
    """What a value must be and is not."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        faults = [None if kind is type(None) and value is None else _fault(value, kind) for kind in arguments]
        return None if None in faults else next(fault for fault in faults if fault)
    if origin is tuple:
        if not isinstance(value, (tuple, list)):
            return "a list of numbers"
        kinds = [arguments[0]] * len(value) if Ellipsis in arguments else arguments
        if len(kinds) != len(value):
            return f"{len(kinds)} numbers"
        return next((fault for item, kind in zip(value, kinds, strict=True) if (fault := _fault(item, kind))), None)
    if hint is type(None):
        return "left out"
    bounds, plain = (hint.__metadata__[0], arguments[0]) if origin is Annotated else (Range(), hint)
    kind, wanted = (Integral, "a whole number") if plain is int else (Real, "a finite number")
    number: Any = value if isinstance(value, kind) and not isinstance(value, bool) else float("nan")
    good = bounds.least <= number <= bounds.most
    return None if good else f"{wanted} {bounds}"
