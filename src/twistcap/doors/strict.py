"""The door for tables, by pydantic models or dataclasses: an unknown key is told with the nearest that exists."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, cast, get_args, get_type_hints

from pydantic import BaseModel, TypeAdapter, ValidationError

from twistcap.doors.text import brief
from twistcap.errors import InputError

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)


def unknown_key(source: str, key: str, table: str, valid: Iterable[str]) -> InputError:
    """The error for a key that does not exist, with the nearest that does."""
    valid = sorted(valid)
    near = difflib.get_close_matches(key, valid, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"the keys are {', '.join(valid)}."
    where = f"in [{table}]" if table else "at the top"
    return InputError(f"{source}: unknown key {key!r} {where}; {hint}")


def validated(model: type[M], data: Mapping[str, Any], source: str, context: Mapping[str, Any] | None = None) -> M:
    """`model` made from `data`. Raises InputError for the first thing wrong, with the key, the file and what would be
    right.
    """
    try:
        return model.model_validate(data, context=dict(context or {}))
    except ValidationError as error:
        raise _described(error, model, source) from error


def dataclass_from(kind: type[T], table: Mapping[str, Any], source: str, where: str) -> T:
    """A (nested) dataclass of plain settings from a table, unknown keys and wrong types being errors.

    Absent keys keep their defaults; messages name the file `source` and the table `where`. Raises InputError as
    `validated`; and what the dataclass itself raises.
    """
    _check_keys(kind, table, source, where)
    try:
        return TypeAdapter(kind).validate_python(dict(table))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([where, *map(str, first["loc"])])
        raise _wrong_value(source, key, first) from error


def _check_keys(kind: type[Any], table: Mapping[str, Any], source: str, where: str) -> None:
    hints = get_type_hints(kind)
    names = [field.name for field in fields(kind)]
    for key, value in table.items():
        if key not in names:
            raise unknown_key(source, key, where, names)
        for below in (hints[key], *get_args(hints[key])):  # itself, or what an optional one may be
            if is_dataclass(below) and isinstance(value, Mapping):
                _check_keys(cast("type[Any]", below), cast("Mapping[str, Any]", value), source, f"{where}.{key}")


def _described(error: ValidationError, model: type[BaseModel], source: str) -> InputError:
    # An unknown key first: it is often why a needed one is missing.
    chosen = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")[0]
    loc = chosen["loc"]
    holder, tagless = _walk(model, loc[:-1])
    if chosen["type"] == "extra_forbidden" and holder is not None:
        return unknown_key(source, str(loc[-1]), ".".join(tagless), holder.model_fields)
    path = ".".join(map(str, [*tagless, *loc[-1:]]))
    if chosen["type"] == "missing" and isinstance(loc[-1], int):
        return InputError(
            f"{source}: the list {'.'.join(tagless)!r} has too few entries; it needs {loc[-1] + 1} or more."
        )
    if chosen["type"] == "missing":
        return InputError(f"{source}: the key {path!r} is missing; add it.")
    return _wrong_value(source, path, chosen)


def _wrong_value(source: str, key: str, error: Any) -> InputError:
    message = str(error["msg"]).removeprefix("Value error, ").rstrip(".")
    if error["type"] == "value_error":
        return InputError(f"{source}: {key}: {message}." if key else f"{source}: {message}.")
    return InputError(f"{source}: {key!r} is {brief(error['input'])}; {message[0].lower()}{message[1:]}.")


def _walk(model: type[BaseModel], loc: Sequence[int | str]) -> tuple[type[BaseModel] | None, list[str]]:
    """The model that an error's location leads to, and the location without the tags of unions."""
    candidates, path = [model], list[str]()
    for part in loc:
        tagged = [
            c for c in candidates if "kind" in c.model_fields and part in get_args(c.model_fields["kind"].annotation)
        ]
        if len(candidates) > 1 and tagged:
            candidates = tagged
            continue
        path.append(str(part))
        if isinstance(part, str) and part in candidates[0].model_fields:
            candidates = _models_in(candidates[0].model_fields[part].annotation)
        if not candidates:
            return None, path
    return candidates[0], path


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]
