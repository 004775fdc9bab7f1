"""What can be added by name: our own, and what installed packages offer as entry points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, get_type_hints

from twistcap.errors import InputError

NAME_BYTES = 20
"""Of a name in a result file."""


@dataclass(frozen=True)
class Registry:
    """Makers of one kind of thing, by name.

    Attributes:
        kind: what they make, for messages.
        group: the group of entry points in which installed packages offer more.
        own: name to ``module:attribute``, imported when it is first asked for.
    """

    kind: str
    group: str
    own: Mapping[str, str]

    def names(self) -> tuple[str, ...]:
        """All that there are."""
        return (*self.own, *(point.name for point in entry_points(group=self.group) if point.name not in self.own))

    def get(self, name: str) -> Callable[..., Any]:
        """The maker of a name. Raises InputError for a name that nobody has registered."""
        if name in self.own:
            module, attribute = self.own[name].split(":")
            return getattr(import_module(module), attribute)
        for point in entry_points(group=self.group):
            if point.name == name:
                return point.load()
        raise InputError(f"there is no {self.kind} {name!r}; choose one of {', '.join(self.names()) or 'none'}.")


def check_owners(kind: str, owners: Sequence[Any]) -> None:
    """See that each of a model's cues, predictors or searches has a name of its own that a result file can hold, and
    says what it remembers. Raises InputError where one does not.
    """
    names = [owner.name for owner in owners]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"model: two {kind} have the name {twice[0]!r}; each needs a name of its own.")
    for owner in owners:
        if not owner.name.isascii() or len(owner.name) > NAME_BYTES:
            raise InputError(f"model: the name {owner.name!r} must be of {NAME_BYTES} letters of ASCII at most.")
        memory_type(owner)


def memory_type(owner: Any) -> Any:
    """The type of the memory of a cue, predictor or search: what its `start` is annotated to return, or it says. Raises
    InputError where it is not annotated.
    """
    if hasattr(owner, "memory_type"):
        return owner.memory_type
    try:
        return get_type_hints(type(owner).start)["return"]
    except (KeyError, NameError) as error:
        raise InputError(
            f"model: {owner.name!r} does not say what its start returns; annotate it, since memories are saved."
        ) from error
