"""OpenCV's YAML and XML files of matrices, numbers and names, as far as calibrations use them; nothing is executed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from twistcap.arrays import Float
from twistcap.doors.text import finite_number, read_text
from twistcap.errors import InputError, check

_MOST = 10_000  # numbers of a matrix
_MATRIX = re.compile(
    r"^([\w.\-]+):\s*!!opencv-matrix\s*\n\s+rows:\s*(\d{1,5})\s*\n\s+cols:\s*(\d{1,5})\s*\n\s+dt:\s*\"?(\w+)\"?\s*\n"
    r"\s+data:\s*\[([^\]]*)\]",
    re.M,
)
_SCALAR = re.compile(r"^([\w.\-]+):[ \t]+\"?([^\s\"\[!][^\n\"]*)\"?[ \t]*$", re.M)
_NAMES = re.compile(r"^names:[ \t]*\n((?:[ \t]*-[ \t]*[^\n]+\n?)+)|^names:\s*\[([^\]]*)\]", re.M)


def read_storage(path: Path) -> dict[str, Any]:
    """Matrices (rows, columns), numbers and texts by name, and ``names``, a list. Raises InputError."""
    text, source = read_text(path), f"calibration {path}"
    if text.lstrip().startswith("<"):
        return _of_xml(parsed_xml(text, source), source)
    check(source, ":" in text, "it is no YAML or XML file of OpenCV")
    found: dict[str, Any] = {name: value.strip() for name, value in _SCALAR.findall(text)}
    for name, rows, columns, _, data in _MATRIX.findall(text):
        found[name] = _matrix(data.replace(",", " ").split(), int(rows), int(columns), f"{source}, {name!r}")
    listed = _NAMES.search(text)
    if listed is not None:
        items = (listed[1] or listed[2] or "").replace(",", "\n").splitlines()
        found["names"] = [item.strip().lstrip("-").strip().strip("\"'") for item in items if item.strip()]
    return found


def storage_lines(entries: dict[str, Any]) -> str:
    """The YAML text of matrices, names and texts, as OpenCV reads it."""
    out = ["%YAML:1.0", "---"]
    for name, value in entries.items():
        if isinstance(value, np.ndarray):
            numbers = ", ".join(repr(float(x)) for x in value.ravel())
            rows, columns = value.reshape(value.shape[0], -1).shape
            out += [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
            out += [f"   data: [ {numbers} ]"]
        elif isinstance(value, list):
            out += [f"{name}:", *(f'   - "{item}"' for item in value)]
        else:
            out.append(f"{name}: {value}")
    return "\n".join(out) + "\n"


def parsed_xml(text: str, source: str) -> ElementTree.Element:
    """The root of an XML text without document types, which could grow without end. Raises InputError."""
    check(source, "<!DOCTYPE" not in text and "<!ENTITY" not in text, "it declares a document type; remove that part")
    try:
        return ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{source} is not valid XML: {error}.") from error


def _of_xml(root: ElementTree.Element, source: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for entry in root:
        where, text = f"{source}, {entry.tag!r}", (entry.text or "").strip()
        if entry.get("type_id") == "opencv-matrix":
            sizes = [(entry.findtext(side) or "").strip() for side in ("rows", "cols")]
            check(where, all(s.isdigit() and len(s) < 6 for s in sizes), "its rows and cols must be whole numbers")
            found[entry.tag] = _matrix((entry.findtext("data") or "").split(), int(sizes[0]), int(sizes[1]), where)
        else:
            found[entry.tag] = [w.strip('"') for w in text.split()] if entry.tag == "names" else text.strip('"')
    return found


def _matrix(words: list[str], rows: int, columns: int, where: str) -> Float:
    check(
        where, 0 < rows * columns <= _MOST and len(words) == rows * columns, f"it must hold {rows} × {columns} numbers"
    )
    return np.array([finite_number(word, where) for word in words]).reshape(rows, columns)
