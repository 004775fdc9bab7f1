"""One self-contained HTML file out of a template, our script, vendored libraries and data."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from typing import Any

import cv2
import numpy as np

from twistcap.arrays import AnyArray

_MODULES: Mapping[str, str] = {"three": "three.module.min.js", "orbit": "OrbitControls.js"}
_SCRIPTS: Mapping[str, tuple[str, ...]] = {
    "view": ("view.js", "plots.js"),
    "init": ("loupe.js", "picking.js", "init.js"),
    "points": ("loupe.js", "picking.js", "points.js"),
    "cut": ("cut.js",),
}
_STYLES: Mapping[str, tuple[str, ...]] = {"init": ("picking.css",), "points": ("picking.css",)}
_TYPES: Mapping[str, str] = {"float32": "f4", "uint8": "u1", "uint16": "u2", "uint32": "u4"}


def asset(name: str) -> str:
    """Text of a file of ``pages/assets``."""
    return (files("twistcap.pages") / "assets" / name).read_text(encoding="utf-8")


def packed(array: AnyArray) -> dict[str, Any]:
    """An array as the scripts' ``unpack`` reads it: type, shape and little-endian bytes in base64.

    Args:
        array: float32, uint8, uint16 or uint32; anything else is taken to float32.
    """
    kept = array if array.dtype.name in _TYPES else array.astype(np.float32)
    code = _TYPES[kept.dtype.name]
    content = np.ascontiguousarray(kept, dtype="<" + code).tobytes()
    return {"type": code, "shape": list(array.shape), "data": base64.b64encode(content).decode()}


def jpeg(image: AnyArray, width: int, quality: int = 80) -> str:
    """An RGB or grey uint8 image as a JPEG data URL, made smaller where it is wider than `width` px."""
    factor = min(1.0, width / image.shape[1])
    size = (max(1, round(image.shape[1] * factor)), max(1, round(image.shape[0] * factor)))
    small = image if factor == 1.0 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    bgr = small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    content = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    return "data:image/jpeg;base64," + base64.b64encode(content).decode()


def page(name: str, title: str, data: Mapping[str, Any]) -> str:
    """The HTML of ``assets/NAME.html`` with its styles and scripts, the libraries and `data` inside.

    The title is escaped here. `data` is what JSON can hold, finite numbers only; the script finds it in ``#data``.
    """
    codes = {key: base64.b64encode(asset(f"vendor/{file}").encode()).decode() for key, file in _MODULES.items()}
    modules = {key: f"data:text/javascript;base64,{code}" for key, code in codes.items()}
    parts = {
        "title": escape(title),
        "style": "\n".join(map(asset, ("common.css", *_STYLES.get(name, ())))),
        "script": "\n".join(map(asset, ("common.js", *_SCRIPTS[name]))),
        "data": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "plot_style": asset("vendor/uPlot.min.css"),
        "plot_script": asset("vendor/uPlot.iife.min.js"),
        "modules": json.dumps({"imports": modules}),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], asset(f"{name}.html"))
