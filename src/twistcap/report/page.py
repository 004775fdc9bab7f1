"""The one-page report: a single HTML file with its pictures inside, readable without a network."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path
from urllib.parse import quote

from twistcap.evaluate.metrics import Row
from twistcap.io.files import replacing

METHODS = (
    "T. Brox, B. Rosenhahn and D. Cremers: Contours, Optic Flow, and Prior Knowledge: Cues for Capturing 3D Human "
    "Motion in Videos. In: Human Motion, Springer 2008.",
    "B. Rosenhahn, T. Brox and H.-P. Seidel: Scaled Motion Dynamics for Markerless Motion Capture. CVPR 2007, "
    "doi:10.1109/CVPR.2007.383128.",
    "C. Bregler and J. Malik: Tracking People with Twists and Exponential Maps. CVPR 1998, "
    "doi:10.1109/CVPR.1998.698581.",
)
"""What to cite with twistcap: the papers whose methods it follows."""


@dataclass(frozen=True)
class Headline:
    """A number at the top of the report; `good` colours it green or red, None leaves it plain."""

    label: str
    value: str
    unit: str = ""
    good: bool | None = None


@dataclass(frozen=True)
class Figure:
    """A picture to put into the page, with a caption: the path of a PNG, or the bytes of a PNG or JPEG. A `photo` keeps
    its colours on a dark page."""

    picture: Path | bytes
    caption: str
    photo: bool = False


@dataclass(frozen=True)
class Statement:
    """A sentence of the verdict; `good` marks it green or red, None amber."""

    text: str
    good: bool | None = None


def write_report(
    folder: Path | str, title: str, rows: Sequence[Row], *, lead: str = "", verdict: Sequence[Statement] = (),
    statements: Sequence[str] = (), headlines: Sequence[Headline] = (), stills: Sequence[Figure] = (),
    figures: Sequence[Figure] = (), cameras: Sequence[Row] = (), video: Path | None = None,
    files: Mapping[Path, str] | None = None, notes: Sequence[str] = (), advice: Sequence[str] = (),
    name: str = "report.html",
) -> Path:  # fmt: skip
    """Write a stand-alone HTML page; every text is escaped, pictures are embedded, nothing is loaded from a network.

    Args:
        folder, name: of the page, whose path is returned; the video and the files are linked relative to it.
        title, lead, rows: heading, the sentence under it, and table of measures.
        verdict: what is reliable and what is not, first of all.
        statements: sentences on lost frames and cameras, below the headlines.
        headlines: the few numbers that matter, in large type.
        stills, figures, video: pictures and plots to embed, and the overlay, which is linked.
        cameras: table of what each camera did.
        files: other files, path to description.
        notes, advice: remarks below the table; what to do, above the pictures.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">{escape(lead)}</p>',
        _verdict(verdict),
        _cards(headlines),
        _list("Lost frames and cameras", [escape(sentence) for sentence in statements]),
        _list("What to do", [escape(line) for line in advice]),
        _stills(stills),
        _video(folder, video),
        "\n".join(_figure(figure, "plot photo" if figure.photo else "plot") for figure in figures),
        _table("Cameras", cameras),
        _table("Measures", rows),
        _list("Notes", [escape(note) for note in notes]),
        _list("Files", _links(folder, files or {})),
        _FOOTER,
    ]
    path = folder / name
    with replacing(path) as part:
        part.write_text(_document(title, parts), encoding="utf-8")
    return path


def headline_rows(rows: Sequence[Row], wanted: Mapping[str, str]) -> list[Headline]:
    """Headlines from table rows: metric to label; a metric that the table lacks is left out."""
    by_metric = {line["metric"]: line for line in rows}
    found = [(by_metric[metric], label) for metric, label in wanted.items() if metric in by_metric]
    return [Headline(label, number(line["value"]), line["unit"], line["holds"]) for line, label in found]


def number(value: float | None) -> str:
    """A value with three significant digits, whole from 100 on; a dash where there is none."""
    if value is None:
        return "–"
    if value == int(value) or abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"


def unit(name: str) -> str:
    """A unit as people write it, escaped."""
    return {"deg": "°"}.get(name, escape(name))


_FOOTER = (
    "<footer>Made with twistcap. Please cite its repository and the methods that it follows:"
    f"<ul>{''.join(f'<li>{escape(paper)}</li>' for paper in METHODS)}</ul></footer>"
)


def _document(title: str, parts: Sequence[str]) -> str:
    """The page of its parts, without those that are empty."""
    css = (resources.files("twistcap.report") / "report.css").read_text(encoding="utf-8")
    head = '<meta charset="utf-8">\n<meta name="viewport" content="width=device-width, initial-scale=1">'
    head += f"\n<title>{escape(title)}</title>\n<style>\n{css}</style>"
    body = "\n".join(part for part in parts if part)
    return f'<!doctype html>\n<html lang="en">\n<head>\n{head}\n</head>\n<body>\n{body}\n</body>\n</html>\n'


def _links(folder: Path, files: Mapping[Path, str]) -> list[str]:
    return [
        f'<a href="{_link(folder, path)}"><code>{escape(path.name)}</code></a> {escape(text)}'
        for path, text in files.items()
    ]


def _cards(headlines: Sequence[Headline]) -> str:
    cards = [
        f'<div class="card{_mark(h.good)}"><b>{escape(h.value)} <small>{unit(h.unit)}</small></b>'
        f"<span>{escape(h.label)}</span></div>"
        for h in headlines
    ]
    return f'<div class="cards">{"".join(cards)}</div>' if cards else ""


def _mark(good: bool | None) -> str:
    return "" if good is None else " good" if good else " bad"


def _video(folder: Path, video: Path | None) -> str:
    if video is None:
        return ""
    link = _link(folder, video)
    return (
        f'<h2>Overlay</h2>\n<figure><video controls loop muted playsinline preload="auto" src="{link}"></video>'
        f"<figcaption>The tracked body over every view; right is orange, left is blue. "
        f"A lost frame has a red border, and its most doubtful limbs are red. "
        f'<a href="{link}">{escape(video.name)}</a></figcaption></figure>'
    )


def _verdict(statements: Sequence[Statement]) -> str:
    kinds = {True: "good", False: "bad", None: "amber"}
    items = [f'<li class="{kinds[s.good]}">{escape(s.text)}</li>' for s in statements]
    return f'<section class="verdict"><h2>Verdict</h2><ul>{"".join(items)}</ul></section>' if items else ""


def _stills(stills: Sequence[Figure]) -> str:
    pictures = "".join(_figure(still, "still") for still in stills)
    return f'<h2>Stills</h2>\n<div class="stills">{pictures}</div>' if pictures else ""


def _figure(figure: Figure, kind: str) -> str:
    """A plot is as wide as it must be to be read, and scrolls where the page is narrower."""
    picture, caption = figure.picture, escape(figure.caption)
    content = picture if isinstance(picture, bytes) else picture.read_bytes()
    mime = "png" if content[1:4] == b"PNG" else "jpeg"
    image = (
        f'<img decoding="async" alt="{caption}" src="data:image/{mime};base64,{base64.b64encode(content).decode()}">'
    )
    scroll = f'<div class="scroll" tabindex="0" role="region" aria-label="{caption}">{image}</div>'
    shown = scroll if kind.startswith("plot") else image
    return f'<figure class="{kind}">{shown}<figcaption>{caption}</figcaption></figure>'


def _table(title: str, rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    targets = any(line["target"] for line in rows)
    head = "<th>case</th><th>measure</th><th class=n>value</th><th>unit</th>"
    head += "<th class=n>to reach</th>" if targets else ""
    lines = [
        f"<tr><td>{escape(line['case'])}</td><td>{escape(line['metric'])}</td>"
        f'<td class="n{_mark(line["holds"])}">{number(line["value"])}</td><td>{unit(line["unit"])}</td>'
        + (f'<td class="n">{escape(line["target"] or "")}</td></tr>' if targets else "</tr>")
        for line in rows
    ]
    body = "\n".join(lines)
    table = f"<table><tr>{head}</tr>\n{body}\n</table>"
    return f'<h2>{title}</h2>\n<div class="scroll" tabindex="0" role="region" aria-label="{title}">{table}</div>'


def _list(title: str, items: Sequence[str]) -> str:
    return f"<h2>{title}</h2>\n<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>" if items else ""


def _link(folder: Path, path: Path) -> str:
    """Relative link from the page's folder, so that the folder can be moved or sent as it is."""
    absolute = path if path.is_absolute() or path.exists() else folder / path
    return escape(quote(Path(os.path.relpath(absolute.resolve(), folder.resolve())).as_posix()))
