"""Every number that can be set has a range: no rule, cue or table of settings can be made of what cannot be meant."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import pytest

import twistcap
from twistcap.errors import InputError
from twistcap.ranges import Checked, _numeric  # pyright: ignore[reportPrivateUsage]

for module in pkgutil.walk_packages(twistcap.__path__, "twistcap."):
    if not module.name.endswith(("__main__", "anny", "_hdf5_dump")):
        importlib.import_module(module.name)


def kinds(base: type[Any] = Checked) -> Iterator[type[Any]]:
    for kind in base.__subclasses__():
        if is_dataclass(kind):
            yield kind
        yield from kinds(kind)


KINDS = sorted(
    {kind for kind in kinds() if kind.__module__.startswith("twistcap.")}, key=lambda kind: kind.__qualname__
)
NUMBERS = [(kind, name) for kind in KINDS for name, _ in _numeric(kind)]


def made(kind: type[Any], **given: Any) -> Any:
    """One of a kind; what has no default is not looked at when it is made."""
    needed = {f.name: None for f in fields(kind) if f.init and f.default is MISSING and f.default_factory is MISSING}
    return kind(**(needed | given))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_the_defaults_are_in_their_ranges(kind: type[Any]) -> None:
    made(kind)


@pytest.mark.parametrize(("kind", "name"), NUMBERS, ids=lambda value: getattr(value, "__name__", value))
def test_what_cannot_be_meant_is_refused(kind: type[Any], name: str) -> None:
    several = isinstance(getattr(made(kind), name), tuple)
    for value in (float("nan"), float("inf"), -float("inf"), -1e7, 1e300, 10**400, "x", True, ["x"], {}, object()):
        with pytest.raises(InputError, match=name) as caught:
            made(kind, **{name: (value,) if several else value})
        assert len(str(caught.value)) < 300


def test_all_rules_and_settings_are_checked() -> None:
    """A dataclass that is called a rule or settings, or whose fields all have defaults and some are numbers."""
    endings = ("Rule", "Settings", "Config", "Schedule", "Noise")
    modules = [m for name, m in __import__("sys").modules.items() if name.startswith("twistcap.")]
    named = {v for m in modules for v in vars(m).values() if isinstance(v, type) and v.__name__.endswith(endings)}
    unchecked = {k.__name__ for k in named if is_dataclass(k) and k.__module__.startswith("twistcap.")} - {
        k.__name__ for k in KINDS
    }
    assert not unchecked


@pytest.mark.parametrize(
    "table", ["solver_steps = 0", "inflation = nan", "keypoint_sigma = nan", "surface_sigma = 1e300",
              "first_sigma_deg = -0.0", "[differential]\nstray_deg = inf"],
)  # fmt: skip
def test_a_session_says_which_setting(table: str) -> None:
    from twistcap.doors.text import parsed_toml
    from twistcap.io.session import tracker_settings

    with pytest.raises(InputError, match=r"^(session )?walk.toml"):
        tracker_settings(parsed_toml(table, "session walk.toml"), "walk.toml")
