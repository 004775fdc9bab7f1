"""The door for tables, by pydantic models or dataclasses: an unknown key is told with the nearest that exists."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, cast, get_args, get_type_hints

from pydantic import BaseModel, TypeAdapter, ValidationError

from twistcap.doors.text import brief
from twistcap.errors import InputError

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)
_KINDS = {
    "float_type": "a number", "float_parsing": "a number", "finite_number": "a finite number",
    "int_type": "a whole number", "int_parsing": "a whole number", "int_from_float": "a whole number",
    "bool_type": "true or false", "bool_parsing": "true or false", "string_type": "a text in quotes",
    "dict_type": "a table", "model_type": "a table", "model_attributes_type": "a table", "dataclass_type": "a table",
}  # fmt: skip


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
        made = model.model_validate(data, context=dict(context or {}))
    except ValidationError as error:
        raise _described(error, model, data, source) from error
    _check_kinds(data, made, source, ())
    return made


def dataclass_from(kind: type[T], table: Mapping[str, Any], source: str, where: str) -> T:
    """A (nested) dataclass of plain settings from a table, unknown keys and wrong types being errors.

    Absent keys keep their defaults; messages name the file `source` and the table `where`. Raises InputError as
    `validated`; and what the dataclass itself raises.
    """
    _check_keys(kind, table, source, where)
    try:
        made = TypeAdapter(kind).validate_python(dict(table))
    except ValidationError as error:
        raise _wrong_value(source, error.errors(), table, (where,)) from error
    _check_kinds(table, made, source, (where,))
    return made


def _check_keys(kind: type[Any], table: Mapping[str, Any], source: str, where: str) -> None:
    hints = get_type_hints(kind)
    names = [field.name for field in fields(kind)]
    for key, value in table.items():
        if key not in names:
            raise unknown_key(source, key, where, names)
        for below in (hints[key], *get_args(hints[key])):  # itself, or what an optional one may be
            if is_dataclass(below) and isinstance(value, Mapping):
                _check_keys(cast("type[Any]", below), cast("Mapping[str, Any]", value), source, f"{where}.{key}")


def _described(error: ValidationError, model: type[BaseModel], data: Mapping[str, Any], source: str) -> InputError:
    # An unknown key first: it is often why a needed one is missing.
    faults = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    chosen = faults[0]
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
    return _wrong_value(source, faults, data)


def _wrong_value(source: str, faults: Sequence[Any], data: Any, above: tuple[str, ...] = ()) -> InputError:
    """The first fault; where a value may be of several kinds, with all that it may be."""
    first = faults[0]
    path = _given_path(data, first["loc"])
    key = ".".join(map(str, [*above, *(path[:-1] if path and isinstance(path[-1], int) else path)]))
    if first["type"] == "value_error":
        message = str(first["msg"]).removeprefix("Value error, ").removeprefix(f"{key}: ").rstrip(".")
        return InputError(f"{source}: {key}: {message}." if key else f"{source}: {message}.")
    if first["type"] == "union_tag_invalid":
        kind, tag = first["ctx"]["discriminator"].strip("'"), first["ctx"]["tag"]
        choice = " or ".join(first["ctx"]["expected_tags"].rsplit(", ", 1))
        return InputError(f"{source}: '{key}.{kind}' is {brief(tag)}; it must be {choice}.")
    wanted = dict.fromkeys(_wanted(fault) for fault in faults if _given_path(data, fault["loc"]) == path)
    verb = "holds" if path and isinstance(path[-1], int) else "is"
    return InputError(f"{source}: {key!r} {verb} {brief(first['input'])}; it must be {' or '.join(wanted)}.")


def _wanted(fault: Any) -> str:
    """What a value must be, for one who knows TOML and not Python."""
    kind, value = fault["type"], fault["input"]
    if kind in ("tuple_type", "list_type"):
        return f"a list, such as [{_entries(value)}]"
    if kind == "too_long":
        return f"a list of {fault['ctx']['max_length']} or fewer"
    message = str(fault["msg"]).rstrip(".").removeprefix("Input should be ")
    return _KINDS.get(kind) or {"True": "true", "False": "false"}.get(message, f"{message[0].lower()}{message[1:]}")


def _entries(value: Any) -> str:
    """What a list may hold where a value was given instead: a shell takes quotes away, and brackets may be one."""
    if not isinstance(value, str):
        return f"0, {brief(value)}"
    if re.fullmatch(r"[-\d:, \[\]]+", value):
        return ", ".join(re.findall(r"-?\d+", value))
    return (
        ", ".join(brief(word) for word in re.findall(r"[^][,'\" ]+", value)) if value.startswith("[") else brief(value)
    )


def _given_path(data: Any, loc: Sequence[int | str]) -> list[int | str]:
    """The location of a fault as far as what was given has it: without the tags of unions."""
    path = list[int | str]()
    for part in loc:
        listed = enumerate(data) if isinstance(data, (list, tuple)) else ()
        entries: dict[Any, Any] = dict(data if isinstance(data, Mapping) else listed)
        if part in entries:
            path.append(part)
            data = entries[part]
    return path


def _check_kinds(given: Any, made: Any, source: str, path: tuple[str, ...]) -> None:
    """Raises InputError for a text or a truth that was taken for a number, and a number that was for a truth."""
    if isinstance(made, (int, float)):
        if isinstance(given, str) or isinstance(given, bool) != isinstance(made, bool):
            wanted = _KINDS["bool_type" if isinstance(made, bool) else "float_type"]
            raise InputError(f"{source}: {'.'.join(path)!r} is {brief(given)}; it must be {wanted}.")
    elif isinstance(given, Mapping):
        for (key, value), became in zip(given.items(), _made_of(given, made), strict=False):
            _check_kinds(value, became, source, (*path, str(key)))
    elif isinstance(given, (list, tuple)) and isinstance(made, (list, tuple)):
        for value, became in zip(given, made, strict=False):
            _check_kinds(value, became, source, path)


def _made_of(given: Mapping[str, Any], made: Any) -> Iterable[Any]:
    """What became of each entry; the keys of a table may have changed, such as paths."""
    return made.values() if isinstance(made, Mapping) else [getattr(made, key, None) for key in given]


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
