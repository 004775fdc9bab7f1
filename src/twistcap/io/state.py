"""A state as bytes, and back: frozen values of arrays, numbers and words, nested as they are.

What a value is made of is in its own annotations, never in the file: reading builds nothing but the types that
the model's own `start` and their fields name. Bodies are not written; they are the model's.
"""

from __future__ import annotations

import io
import json
import types
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from twistcap.arrays import AnyArray, UInt8
from twistcap.body import Body, Pose, Posed
from twistcap.differential.model import DifferentialModel
from twistcap.doors.npz import npz_arrays
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.registry import memory_type
from twistcap.se3 import is_motion
from twistcap.track.model import Model

_DAMAGE = (
    OSError, EOFError, RecursionError, OverflowError, ValueError, TypeError,
    KeyError, IndexError, AttributeError, zipfile.BadZipFile,
)  # fmt: skip
_MEMORIES = ("cues", "predictors", "searches")
_CORRECTED = "corrected"  # no state has a field of this name


def to_bytes(state: Any, corrected: Sequence[Estimate] = ()) -> UInt8:
    """(N,) bytes of a state, and of the estimates that it corrects, with checksums."""
    arrays: list[AnyArray] = []
    layout = _packed(state, arrays) | {_CORRECTED: _packed(corrected, arrays)}
    buffer = io.BytesIO()
    text = np.frombuffer(json.dumps(layout, allow_nan=True).encode(), np.uint8)
    named: dict[str, Any] = {str(k): array for k, array in enumerate(arrays)}
    np.savez(buffer, layout=text, **named)
    return np.frombuffer(buffer.getvalue(), np.uint8)


def from_bytes(data: UInt8, model: Model | DifferentialModel) -> tuple[Any, tuple[Estimate, ...]]:
    """The state of a model, and the estimates that it corrects, which `to_bytes` wrote. Raises InputError for bytes
    that are damaged, or of a model with other cues, predictors or searches.
    """
    try:
        file = npz_arrays(data.tobytes(), "the stored state of the track")
        layout = json.loads(file["layout"].tobytes())
        arrays = [file[str(k)] for k in range(len(file) - 1)]
        reader = _Reader(arrays, model.body)
        corrected = reader.read(tuple[Estimate, ...], layout.pop(_CORRECTED, []))
        state = reader.state(layout, model)
        _check_sizes(state, corrected, model)
        return state, corrected
    except InputError:
        raise
    except _DAMAGE as error:
        fact = "the stored state of the track is damaged, or of another version of twistcap"
        raise InputError(f"{fact}; track anew.") from error


def _check_sizes(state: Any, corrected: Sequence[Estimate], model: Model | DifferentialModel) -> None:
    """Raises ValueError for arrays of another body; kernels would read past their ends."""
    if not isinstance(model, Model):
        return
    rest = Pose.rest(model.body)
    fresh = model.start(rest)
    for item in fields(fresh):
        given, usual = getattr(state, item.name), getattr(fresh, item.name)
        if isinstance(usual, np.ndarray) and (given.shape, given.dtype) != (usual.shape, usual.dtype):
            raise ValueError(item.name)
    poses = [one.pose for one in (*state.past.moments, *corrected)]
    if any(pose.q.shape != rest.q.shape or not is_motion(pose.root, 1e-3) for pose in poses):
        raise ValueError("past")
    own = tuple(range(len(model.rig)))
    if any(tuple(sorted(one.sources)) not in ((), own) for one in (state, *corrected)):
        raise ValueError("sources")
    parts = [e.part_probability for e in corrected if e.part_probability is not None]
    given = {*(e.covariance.shape for e in corrected), *(p.shape for p in parts)}
    if not given <= {fresh.covariance.shape, fresh.support.shape}:
        raise ValueError("corrected")


def _packed(value: Any, arrays: list[AnyArray]) -> Any:
    """JSON of a value, its arrays put aside."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, Posed):
        return _packed(value.pose, arrays)
    if isinstance(value, tuple | list):
        return [_packed(item, arrays) for item in value]
    if isinstance(value, Mapping):
        return {"items": [[_packed(k, arrays), _packed(v, arrays)] for k, v in value.items()]}
    if is_dataclass(value):
        return {f.name: _packed(getattr(value, f.name), arrays) for f in fields(value) if not f.name.startswith("_")}
    raise TypeError(f"a {type(value).__name__} cannot be stored; make memories of dataclasses, arrays and numbers.")


class _Reader:
    """Builds values from what `_packed` made, by annotation."""

    def __init__(self, arrays: list[AnyArray], body: Body) -> None:
        self.arrays, self.body = arrays, body

    def state(self, layout: Mapping[str, Any], model: Model | DifferentialModel) -> Any:
        """The state, of the type that `start` makes; the memories' types are those that their owners annotate."""
        kind = memory_type(model)
        hints, values = get_type_hints(kind), dict[str, Any]()
        if layout.keys() != hints.keys():
            raise InputError("the stored state is of another method; resume with the settings of the first run.")
        for name, packed in layout.items():
            if name in _MEMORIES:
                stored = dict(packed["items"])
                owners = {owner.name: owner for owner in getattr(model, name)}
                if other := stored.keys() ^ owners.keys():
                    raise InputError(
                        f"the stored state and this run differ in the {name} {', '.join(sorted(other))}: the settings"
                        " are others, or another version of twistcap began the track; resume with those, or track anew."
                    )
                values[name] = {key: self.read(memory_type(owners[key]), stored[key]) for key in owners}
            else:
                values[name] = self.read(hints[name], packed)
        return kind(**values)

    def read(self, kind: Any, packed: Any) -> Any:
        """A value of an annotated type."""
        origin, arguments = get_origin(kind), get_args(kind)
        if isinstance(kind, str) or kind is Any:
            raise TypeError("a memory's fields must say their types")
        if origin is np.ndarray or kind is np.ndarray:
            return self.arrays[packed["array"]]
        if origin in (Union, types.UnionType):
            return None if packed is None else self._one_of([k for k in arguments if k is not type(None)], packed)
        if origin is tuple:
            kinds = [arguments[0]] * len(packed) if arguments[-1] is Ellipsis else arguments
            return tuple(self.read(k, item) for k, item in zip(kinds, packed, strict=True))
        if isinstance(origin, type) and issubclass(origin, Mapping):
            return {self.read(arguments[0], k): self.read(arguments[1], v) for k, v in packed["items"]}
        return self._plain(kind, origin, packed)

    def _plain(self, kind: Any, origin: Any, packed: Any) -> Any:
        if kind is type(None) or kind is None:
            return None
        if kind is Posed:
            return Posed(self.body, self.read(Pose, packed))
        if isinstance(kind, type) and is_dataclass(kind):
            made, hints = cast("Callable[..., Any]", kind), get_type_hints(kind)
            known = {f.name: f.init for f in fields(kind)}
            return made(**{k: self.read(hints[k], v) for k, v in packed.items() if known[k]})
        if kind in (int, float, str, bool):
            return kind(packed)
        if origin is Literal:
            return packed
        raise TypeError(f"{kind} cannot be read")

    def _one_of(self, kinds: list[Any], packed: Any) -> Any:
        if len(kinds) != 1:
            raise TypeError("of a union of several types none can be chosen")
        return self.read(kinds[0], packed)
