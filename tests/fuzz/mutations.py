"""Seeded damage to files: of bytes, and of what JSON, TOML, text, NPZ, HDF5 and GLB hold."""

from __future__ import annotations

import io
import json
import random
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import h5py
import numpy as np

NUMBERS: tuple[Any, ...] = (0, -1, 1, 2**31, -(2**63), 10**400, 1e308, -1e308, 1e-320, float("nan"), float("inf"), 0.5)
OTHERS: tuple[Any, ...] = (
    None,
    True,
    "",
    "x" * 5000,
    "\x1b[2J\0",
    "../../etc/passwd",
    [],
    {},
    [[]],
    [1, "a"],
    {"a": {}},
)
WORDS = ("nan", "inf", "-1", "1e999", "0", "1_0", "9" * 5000, "", "x", "\0", "\x1b[31m", "١", "}", "]", "[" * 2000)


def of_bytes(data: bytes, rng: random.Random) -> bytes:
    """Flips, cuts, runs that are doubled, zeroed or moved."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 60))):
        if not out:
            return b""
        at, kind = rng.randrange(len(out)), rng.randrange(6)
        end = min(len(out), at + rng.choice((1, 4, 8, 64, 1000)))
        if kind == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at:end] = bytes(rng.randrange(256) for _ in range(end - at))
        elif kind == 2:
            out[at:end] = rng.choice((b"\0", b"\xff")) * (end - at)
        elif kind == 3:
            del out[at : rng.choice((end, len(out)))]
        elif kind == 4:
            out[at:at] = out[at:end]
        else:
            out[at : at + 4] = struct.pack("<I", rng.choice((0, 1, 0x7FFFFFFF, 0xFFFFFFFF, len(data))))
    return bytes(out)


def of_text(data: bytes, rng: random.Random) -> bytes:
    """Words and lines of a text swapped, dropped, doubled or replaced."""
    words = re.split(rb"(\s+|[,;=\[\]{}:])", data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(words))
        kind = rng.randrange(4)
        if kind == 0:
            words[at] = rng.choice(WORDS).encode()
        elif kind == 1:
            words[at : at + rng.choice((1, 2, 10))] = []
        elif kind == 2:
            words[at:at] = words[at : at + rng.choice((1, 2, 10, 100))]
        else:
            other = rng.randrange(len(words))
            words[at], words[other] = words[other], words[at]
        words = words or [b""]
    return b"".join(words)


def of_tree(content: Any, rng: random.Random) -> Any:
    """One to three places of nested tables and lists changed."""
    content = json.loads(json.dumps(content))
    for _ in range(rng.choice((1, 1, 2, 3))):
        places = list(_places(content))
        if not places:
            return deepcopy(rng.choice(OTHERS))
        holder, key = rng.choice(places)
        kind = rng.randrange(8)
        if kind < 3:
            holder[key] = rng.choice(NUMBERS)
        elif kind < 5:
            holder[key] = deepcopy(rng.choice(OTHERS))
        elif kind == 5:
            del holder[key]
        elif kind == 6:
            _, other = rng.choice(places)
            holder[key] = {str(other): holder[key]}
        else:
            for _ in range(rng.choice((3, 60, 250))):
                holder[key] = [holder[key]]
    return content


def _places(content: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    waiting = [content]
    while waiting and len(found) < 20000:
        here = waiting.pop()
        keys: Any = list(here) if isinstance(here, dict) else range(len(here)) if isinstance(here, list) else ()
        found += [(here, key) for key in keys]
        waiting += [here[key] for key in keys]
    return found


def of_json(data: bytes, rng: random.Random) -> bytes:
    return json.dumps(of_tree(json.loads(data), rng)).encode()


def of_array(array: Any, rng: random.Random) -> Any:
    """Another value, shape or type of an array."""
    array = np.array(array)
    kind = rng.randrange(8)
    if kind < 3 and array.size and array.dtype.kind in "fiub":
        flat = array.astype(float).ravel()
        for _ in range(rng.choice((1, 1, 5, flat.size))):
            flat[rng.randrange(flat.size)] = rng.choice([float(n) for n in NUMBERS if abs(n) < 10**300 or n != n])
        with np.errstate(all="ignore"):
            return flat.reshape(array.shape).astype(rng.choice((array.dtype, np.float64)))
    if kind == 3:
        return array[:-1] if array.ndim and len(array) else np.zeros(3)
    if kind == 4:
        return np.concatenate([array, array]) if array.ndim else np.zeros(0)
    if kind == 5:
        return array.T if array.ndim > 1 else array[..., None]
    if kind == 6:
        return (
            array.astype(rng.choice(("S8", "U2", "c16", "f2"))) if array.dtype.kind in "fiub" else np.zeros(array.shape)
        )
    return rng.choice((np.zeros((0,)), np.zeros((2, 2, 2), np.int64), np.array("word"), np.array(b"\xff\xfe")))


def of_npz(data: bytes, rng: random.Random) -> bytes:
    """Arrays changed, dropped or renamed; headers that lie; members that are packed to nothing."""
    with np.load(io.BytesIO(data)) as file:
        arrays = dict(file)
    name, kind = rng.choice(list(arrays)), rng.randrange(8)
    out = io.BytesIO()
    if kind < 5:
        arrays[name] = of_array(arrays[name], rng)
    elif kind == 5:
        arrays[rng.choice(("other", "a/b", "x" * 300))] = arrays.pop(name)
    if kind < 6:
        np.savez_compressed(out, **arrays)
        return out.getvalue()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, array in arrays.items():
            member = io.BytesIO()
            np.save(member, array)
            raw = member.getvalue()
            if key == name:
                huge = rng.choice((b"(9999999999,)", b"(-5,)", b"(99999, 99999)", b"(1," * 300))
                raw = re.sub(rb"\([^)]*\)", huge, raw, count=1) if kind == 6 else raw + bytes(1 << 24)
            archive.writestr(f"{key}.npy", raw)
    return out.getvalue()


def of_hdf5(path: Path, rng: random.Random) -> None:
    """A dataset or an attribute changed, dropped, made huge, linked elsewhere, nested or stored outside."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = rng.choice(names)
        node: Any = file[name]
        kind = rng.randrange(14)
        if kind < 6 and isinstance(node, h5py.Dataset):
            _replaced(file, name, of_array(node[()], rng) if node.dtype.kind != "O" else rng.choice(OTHERS[2:5]))
        elif kind < 8 and node.attrs:
            key = rng.choice(list(node.attrs))
            node.attrs[key] = rng.choice((*NUMBERS[:5], *NUMBERS[6:], *(o for o in OTHERS[1:4]), np.zeros(3), b"\xff"))
        elif kind == 8:
            del file[name]
        elif kind == 9:
            del file[name]
            file[name] = rng.choice(
                (h5py.SoftLink("/frames"), h5py.SoftLink("/nothing"), h5py.ExternalLink("/etc/passwd", "/"), file["/"])
            )
        elif kind == 10:
            del file[name]
            file.create_dataset(name, (1 << rng.choice((20, 33, 50)),), "f8", chunks=(1024,))
        elif kind == 11:
            del file[name]
            file.create_dataset(name, (16,), "u1", external=[("/etc/hostname", 0, 16)])
        elif kind == 12:
            _replaced(file, name, np.zeros(1 << 22))
        elif "@config" not in name:
            file.attrs["config"] = rng.choice(
                ("[" * 900, "{}", "null", '{"videos": 3}', '{"videos": {"cam0": 7}}', "{", '{"a": 1e999}')
            )


def _replaced(file: Any, name: str, value: Any) -> None:
    del file[name]
    value = np.asarray(value)
    if value.dtype.kind == "U":
        value = value.astype("S")
    file.create_dataset(name, data=value if value.dtype.kind in "fiubcS" else np.zeros(2))


def of_glb(data: bytes, rng: random.Random) -> bytes:
    """The JSON chunk changed, or values of the binary one."""
    length = int.from_bytes(data[12:16], "little")
    text, rest = data[20 : 20 + length], data[20 + length :]
    if rng.random() < 0.8:
        text = of_json(text, rng)
        text += b" " * (-len(text) % 4)
    else:
        rest = rest[:8] + of_bytes(rest[8:], rng)
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest)) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + rest


STRUCTURED: dict[str, Callable[[bytes, random.Random], bytes]] = {
    ".json": of_json, ".npz": of_npz, ".glb": of_glb, ".mhskel": of_json, ".mhw": of_json,
    **dict.fromkeys((".toml", ".csv", ".trc", ".mot", ".bvh", ".amc", ".asf", ".obj", ".target"), of_text),
}  # fmt: skip


def mutate(source: Path, target: Path, rng: random.Random) -> None:
    """A damaged copy of a file."""
    if source.suffix == ".h5" and rng.random() < 0.6:
        shutil.copyfile(source, target)
        of_hdf5(target, rng)
        return
    data = source.read_bytes()
    damage = STRUCTURED.get(source.suffix, of_bytes)
    if rng.random() < 0.3:
        damage = of_bytes
    try:
        target.write_bytes(damage(data, rng))
    except RecursionError:  # deeper than JSON can be written; a deep text is among the WORDS
        target.write_bytes(of_bytes(data, rng))
