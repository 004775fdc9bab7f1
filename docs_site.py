"""What ``make docs`` adds to the pages of docs/: the pages of the root, and a reference made from the docstrings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).parent
PAGES = ("CONVENTIONS.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")
FOLDERS = ("reproduce", "benchmarks", "notebooks")  # whose README is a page
REFERENCE = {
    "Track": ("twistcap.track", "twistcap.hindsight", "twistcap.build", "twistcap.settings", "twistcap.estimate"),
    "Bodies": ("twistcap.body", "twistcap.body.humanoid", "twistcap.body.gltf", "twistcap.body.shape"),
    "Cameras": ("twistcap.camera", "twistcap.io.calibration"),
    "Files": (
        "twistcap.io.session", "twistcap.io.recording", "twistcap.io.result", "twistcap.io.exports",
        "twistcap.io.study",
    ),
    "Your own cue, predictor, prior, search": (
        "twistcap.cues", "twistcap.cues.observation", "twistcap.predict", "twistcap.priors", "twistcap.search",
        "twistcap.terms",
    ),
    "Refine and fit": ("twistcap.adjust.refine", "twistcap.adjust.body_fit", "twistcap.adjust.first_pose"),
    "Measure": ("twistcap.evaluate.gait", "twistcap.evaluate.agreement", "twistcap.evaluate.metrics"),
    "Studio": ("twistcap.studio",),
}  # fmt: skip


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages."""
    pages = {f"project/{name}": (ROOT / name).read_text(encoding="utf-8") for name in PAGES}
    pages |= {f"project/{name}.md": (ROOT / name / "README.md").read_text(encoding="utf-8") for name in FOLDERS}
    links = ""
    for title, modules in REFERENCE.items():
        name = re.sub(r"\W+", "-", title.lower())
        pages[f"reference/{name}.md"] = f"# {title}\n\n" + "\n".join(f"::: {module}\n" for module in modules)
        links += f"- [{title}]({name}.md): {', '.join(f'`{module}`' for module in modules)}\n"
    pages["reference/index.md"] = f"# Reference\n\nMade from the docstrings.\n\n{links}"
    for uri, text in pages.items():
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(text: str, page: Any, config: Any, files: Any) -> str:
    """Links out of docs/ lead to the generated pages; what is only in the repository is named, without a link."""
    source = _source(page.file.src_uri)

    def link(match: re.Match[str]) -> str:
        words, target, anchor = match[1], match[2], match[3] or ""
        if re.match(r"https?:|mailto:|#", target):
            return match[0]
        path = (source.parent / target).resolve()
        uri = _page(path) if path.is_relative_to(ROOT) else None
        return words if uri is None else f"[{words}]({'../' * page.file.src_uri.count('/')}{uri}{anchor})"

    if page.file.src_uri.startswith("reference/"):
        return text
    return re.sub(r"(?<!!)\[([^\]]+)\]\(([^)#\s]+)(#[^)]*)?\)", link, text)


def _source(uri: str) -> Path:
    """The file that a page comes from."""
    if not uri.startswith("project/"):
        return ROOT / "docs" / uri
    name = uri.removeprefix("project/")
    return ROOT / name if name in PAGES else ROOT / name.removesuffix(".md") / "README.md"


def _page(path: Path) -> str | None:
    """The page of a file; None where the site has none."""
    if path.is_relative_to(ROOT / "docs") and path.is_file():
        return path.relative_to(ROOT / "docs").as_posix()
    if path.name in PAGES and path.parent == ROOT:
        return f"project/{path.name}"
    if path.parent.name in FOLDERS and path.name == "README.md":
        return f"project/{path.parent.name}.md"
    if path.name in FOLDERS:
        return f"project/{path.name}.md"
    return None
