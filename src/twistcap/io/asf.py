"""Acclaim ASF skeletons and AMC motions in.

No maintained library reads them, so this does, after Lander, "Working with Motion Capture File Formats" (Game
Developer, January 1998), and the files of the CMU graphics lab. A bone turns from its rest direction by C M C⁻¹ in the
one above, with C from the bone's `axis` and M the product of its degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.doors.text import finite_number, read_lines
from twistcap.errors import InputError, check, naming
from twistcap.motion.skeleton import SkeletonMotion

_DEEPEST = 200  # bones in a row
AMC_RATE = 120.0  # Hz; the format has no field for it, CMU's library is recorded at this rate
_INCH = 0.0254

Line = tuple[int, list[str]]
"""Its number and its words."""


@dataclass(frozen=True)
class _Bone:
    """One bone of an ASF: `vector` (3,) from its start to its end, file units; `axis` (3, 3) is C; `dof` as written."""

    vector: Float
    axis: Float
    dof: tuple[str, ...]


@dataclass(frozen=True)
class AsfSkeleton:
    """An ASF: bones by name, root first, and the bone above each; `unit` in m, `degree` in rad."""

    bones: dict[str, _Bone]
    parents: dict[str, str]
    unit: float
    degree: float


def read_amc(path: Path | str, skeleton: Path | str | None = None, rate: float = AMC_RATE) -> SkeletonMotion:
    """The motion of an AMC; joints have the names of the bones that begin there, `<bone>_end` where the last ones end.

    `skeleton` is its ASF; None takes `<stem>.asf` or `<subject>.asf` (08_02: 08.asf) beside it, or the only one there.
    `rate` is in frames per second, which an AMC does not state. Raises InputError if a file is missing or broken,
    naming the line, or for a bone that the ASF does not have.
    """
    path = Path(path)
    check(str(path), path.is_file(), "there is no such file; check its path")
    asf = read_asf(skeleton if skeleton is not None else _asf_beside(path))
    names, parents, offsets = _joints(asf)
    frames = _frames(path, asf)
    local = np.tile(np.eye(3), (len(frames), len(names), 1, 1))
    places = np.zeros((len(frames), 3))
    for s, name in enumerate(names):
        bone = asf.bones.get(name)
        if bone is None or not bone.dof:
            continue
        values = _values(path, frames, name, len(bone.dof))
        C, turn = bone.axis, np.tile(np.eye(3), (len(frames), 1, 1))
        for k, channel in enumerate(bone.dof):
            if channel[0] == "r":
                turn = _about(channel[1], values[:, k] * asf.degree) @ turn
            elif s == 0:
                places[:, "xyz".index(channel[1])] = values[:, k] * asf.unit
        local[:, s] = C @ turn @ C.T
    with naming(path):
        return SkeletonMotion.from_local(path.stem, names, parents, offsets * asf.unit, local, places, rate, "y")


def read_asf(path: Path | str) -> AsfSkeleton:
    """An ASF skeleton. Raises InputError if it cannot be read, or a line is broken, naming it."""
    path = Path(path)
    sections = _sections(path)
    for needed in ("bonedata", "hierarchy"):
        check(str(path), needed in sections, f"not an ASF skeleton (no section :{needed})")
    units = {words[0].lower(): words[-1].lower() for _, words in sections.get("units", []) if words}
    degree = 1.0 if units.get("angle", "deg").startswith("rad") else np.pi / 180.0
    length = finite_number(units.get("length", "1"), f"{path}: length in :units")
    check(str(path), 1e-4 < length < 1e4, f"the length in :units is {length:g}; it must be above 0, such as 0.45")
    unit = _INCH / length
    bones = {"root": _root(path, sections.get("root", []), degree), **_bones(path, sections["bonedata"], degree)}
    return AsfSkeleton(bones, _parents(path, sections["hierarchy"], bones), unit, degree)


def _sections(path: Path) -> dict[str, list[Line]]:
    """Lines as (number, words) under each `:keyword`; brackets and commas count as blanks."""
    out: dict[str, list[Line]] = {}
    current: list[Line] = []
    for number, line in enumerate(read_lines(path), start=1):
        words = line.split("#")[0].replace("(", " ").replace(")", " ").replace(",", " ").split()
        if words and words[0].startswith(":"):
            current = out.setdefault(words[0][1:].lower(), [])
            words = words[1:]
        if words:
            current.append((number, words))
    return out


def _root(path: Path, lines: list[Line], degree: float) -> _Bone:
    rows = {words[0].lower(): (number, words[1:]) for number, words in lines}
    number, order = rows.get("order", (0, ["TX", "TY", "TZ", "RX", "RY", "RZ"]))
    _, axis = rows.get("axis", (0, ["XYZ"]))
    _, angles = rows.get("orientation", (0, ["0", "0", "0"]))
    return _Bone(np.zeros(3), _axis(path, number, [*angles, *axis], degree), _dof(path, number, order))


def _bones(path: Path, lines: list[Line], degree: float) -> dict[str, _Bone]:
    bones: dict[str, _Bone] = {}
    block: dict[str, Line] = {}
    for number, words in lines:
        key = words[0].lower()
        if key == "begin":
            block = {}
        elif key != "end":
            block[key] = (number, words[1:])
        else:
            name = next(iter(block.get("name", (0, []))[1]), "")
            if not name or name in bones:
                raise InputError(f"{path}: line {number}: the bone that ends here has no name, or one used before.")
            bones[name] = _bone(path, block, degree)
    return bones


def _bone(path: Path, block: dict[str, Line], degree: float) -> _Bone:
    """From the lines between begin and end, by their first words; what is not said is zero."""
    direction = _numbers(path, *block["direction"], 3) if "direction" in block else np.zeros(3)
    length = _numbers(path, *block["length"], 1) if "length" in block else 0.0
    axis = _axis(path, *block["axis"], degree) if "axis" in block else np.eye(3)
    return _Bone(length * direction, axis, _dof(path, *block["dof"]) if "dof" in block else ())


def _dof(path: Path, number: int, words: list[str]) -> tuple[str, ...]:
    channels = tuple(word.lower() for word in words)
    for channel in channels:
        if channel not in ("rx", "ry", "rz", "tx", "ty", "tz", "l"):
            raise InputError(f"{path}: line {number}: {channel!r} is no degree of freedom (rx … tz).")
    return channels


def _axis(path: Path, number: int, words: list[str], degree: float) -> Float:
    """C: for the order XYZ, ``Rz Ry Rx``."""
    angles = _numbers(path, number, words[:3], 3) * degree
    order = words[3].lower() if len(words) > 3 else "xyz"
    check(str(path), sorted(order) == ["x", "y", "z"], f"line {number}: the order {order!r} must hold x, y and z")
    out = np.eye(3)
    for axis, angle in zip(order, angles, strict=True):
        out = _about(axis, angle) @ out
    return out


def _about(axis: str, angle: Float | float) -> Float:
    return se3.exp_rotation(np.asarray(angle)[..., None] * np.eye(3)["xyz".index(axis)])


def _parents(path: Path, lines: list[Line], bones: dict[str, _Bone]) -> dict[str, str]:
    parents: dict[str, str] = {}
    for number, words in lines:
        if words[0].lower() in ("begin", "end"):
            continue
        for name in words:
            check(str(path), name in bones, f"line {number}: no bone is called {name!r}")
        parents.update(dict.fromkeys(words[1:], words[0]))
    for name in parents:
        above, steps = name, 0
        while (above := parents.get(above, "")) and steps <= len(parents):
            steps += 1
        if steps > min(len(parents), _DEEPEST):
            raise InputError(f"{path}: the bone {name!r} hangs on itself, or on too many others.")
    return parents


def _joints(asf: AsfSkeleton) -> tuple[list[str], list[int], Float]:
    """Names, parents and offsets, depth first: a bone's joint is where the bone above it ends."""
    names, parents, offsets = ["root"], [-1], [np.zeros(3)]

    def add(above: str, index: int) -> None:
        below = [name for name, parent in asf.parents.items() if parent == above]
        for name in below or ([f"{above}_end"] if above in asf.bones else []):
            names.append(name)
            parents.append(index)
            offsets.append(asf.bones[above].vector)
            if below:
                add(name, len(names) - 1)

    add("root", 0)
    return names, parents, np.array(offsets)


def _asf_beside(path: Path) -> Path:
    for stem in (path.stem, path.stem.split("_")[0]):
        if (beside := path.with_name(f"{stem}.asf")).is_file():
            return beside
    others = sorted(path.parent.glob("*.asf"))
    if len(others) != 1:
        there = f"are several ({', '.join(p.name for p in others)})" if others else "is none"
        mend = "name it (--skeleton, in Python skeleton=…)"
        raise InputError(f"{path}: it needs its ASF skeleton, beside it there {there}; {mend}.")
    return others[0]


def _frames(path: Path, asf: AsfSkeleton) -> list[dict[str, Line]]:
    """For each frame, the line number and the words of each bone."""
    frames: list[dict[str, Line]] = []
    for number, line in enumerate(read_lines(path), start=1):
        words = line.split("#")[0].split()
        if not words or words[0].startswith(":"):
            continue
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif words[0] not in asf.bones:
            raise InputError(f"{path}: line {number}: the ASF skeleton has no bone {words[0]!r}.")
        elif not frames:
            raise InputError(f"{path}: line {number}: a frame must start with its number.")
        else:
            frames[-1][words[0]] = (number, words[1:])
    check(str(path), frames, "it has no frames")
    return frames


def _values(path: Path, frames: list[dict[str, Line]], name: str, dof: int) -> Float:
    """(N, dof) of a bone; a frame without it is an error, unless no frame has it."""
    if not any(name in frame for frame in frames):
        return np.zeros((len(frames), dof))
    for n, frame in enumerate(frames):
        if name not in frame:
            raise InputError(f"{path}: frame {n + 1} has no line for {name!r}.")
    return np.array([_numbers(path, *frame[name], dof) for frame in frames])


def _numbers(path: Path, number: int, words: list[str], count: int) -> Float:
    check(str(path), len(words) == count, f"line {number}: {count} numbers must stand here, not {len(words)}")
    return np.array([finite_number(word, f"{path}: line {number}") for word in words])
