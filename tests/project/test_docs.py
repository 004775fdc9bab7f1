"""The pages that people read: links work, lines and sentences are short, words are plain."""

from __future__ import annotations

import importlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from support.commands import run
from twistcap.cli import app

ROOT = Path(__file__).parents[2]
PROSE = [ROOT / name for name in ("README.md", "CONVENTIONS.md", "CONTRIBUTING.md")]
PROSE += sorted((ROOT / "docs").rglob("*.md"))
LINKED = [*PROSE, *sorted(ROOT.glob("[!.]*/README.md")), ROOT / "ARCHITECTURE.md"]

MOST_WORDS = 25
MOST_CHARACTERS = 120
ABBREVIATIONS = r"(?<!\be\.g)(?<!\bi\.e)(?<!\bvs)(?<!\b[A-Z])"
SENTENCE_END = re.compile(ABBREVIATIONS + r"[.!?][)\"']?\s+(?=[^a-z\s])")
FORBIDDEN = re.compile(
    r"\b(seek|sought|told|strayed|leeway|borne|bears? out|lets? alone|wherein|thereof|whereof|therein|lest|anew|rivals?"
    r"|of late|lies? off|hav(?:e|ing) a say|has a say|los(?:e|es|ing) (?:its|their) say"
    r"|(?:is|are|was|were|be|been) (?:gone|back)|share of)\b",
    re.IGNORECASE,
)


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def without_code(text: str) -> str:
    """The page without fenced and indented code, and each piece of `code` as one word."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"(?<=\n\n) {4,}\S.*(\n {4,}.*)*", "", text)
    return re.sub(r"`[^`]+`", "CODE", text)


def paragraphs(text: str) -> Iterator[str]:
    """Running text: each paragraph and each item of a list by itself; no headings, tables, pictures or addresses."""
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", without_code(text))
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    lines = ["" if line.lstrip().startswith(("|", "#")) else line for line in text.splitlines()]
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*] |\d+\. ))", "\n".join(lines)):
        words = " ".join(block.split())
        if words:
            yield re.sub(r"^(?:[-*] |\d+\. )", "", words).replace("**", "").replace("*", "")


def sentences(text: str) -> Iterator[str]:
    for paragraph in paragraphs(text):
        yield from SENTENCE_END.split(paragraph)


def anchors(path: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(path: Path) -> list[str]:
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    broken: list[str] = []
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        target, _, anchor = link.partition("#")
        file = (path.parent / target).resolve() if target else path
        if re.match(r"https?:|mailto:", link):
            continue
        if not file.exists() or (anchor and anchor not in anchors(file)):
            broken.append(link)
    return broken


def test_the_splitter_sees_sentences_and_skips_the_rest() -> None:
    page = "# A heading. Of two\nOne here. Two (`x. Y`) there!\n- three: e.g. A B\n\n"
    page += "| a. B |\n```\nC. D\n```\n[End](f.md). Six"
    found = list(sentences(page))
    assert found == ["One here", "Two (CODE) there!", "three: e.g. A B", "End", "Six"]


@pytest.mark.parametrize("path", LINKED, ids=named)
def test_links_lead_to_files_and_headings(path: Path) -> None:
    assert not broken_links(path)


@pytest.mark.parametrize("path", PROSE, ids=named)
def test_lines_are_short(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    assert not [f"{n}: {len(line)}" for n, line in enumerate(lines, 1) if len(line) > MOST_CHARACTERS]


@pytest.mark.parametrize("path", PROSE, ids=named)
def test_sentences_are_short(path: Path) -> None:
    found = sentences(path.read_text(encoding="utf-8"))
    assert not [f"{n}: {s}" for s in found if (n := len(re.findall(r"\w[\w'’.,/×–-]*", s))) > MOST_WORDS]


@pytest.mark.parametrize("path", PROSE, ids=named)
def test_words_are_plain(path: Path) -> None:
    assert not FORBIDDEN.findall(without_code(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("path", sorted((ROOT / "docs").rglob("*.md")), ids=named)
def test_every_page_is_reached_from_the_index(path: Path) -> None:
    index = ROOT / "docs" / "README.md"
    reached = re.findall(r"\]\(([^)#\s]+)", index.read_text(encoding="utf-8"))
    assert path == index or path in {(index.parent / link).resolve() for link in reached}


def test_pages_that_the_code_names_exist() -> None:
    endings = {".py", ".toml", ".js", ".html"}
    files = [path for folder in ("src", "tests", "examples") for path in (ROOT / folder).rglob("*.*")]
    texts = {path: path.read_text(encoding="utf-8") for path in files if path.suffix in endings}
    found = {(named(path), page) for path, text in texts.items() for page in re.findall(r"docs/[\w/-]+\.md", text)}
    assert found and not [pair for pair in found if not (ROOT / pair[1]).exists()]


@pytest.mark.parametrize("path", sorted((ROOT / "docs").rglob("*.md")), ids=named)
def test_the_first_sentence_says_for_whom_the_page_is(path: Path) -> None:
    assert next(sentences(path.read_text(encoding="utf-8"))).startswith("This page is for ")


def shown_commands(path: Path) -> Iterator[list[str]]:
    """The words of each ``twistcap …`` line in the page's shell blocks."""
    blocks = re.findall(r"^```sh\n(.*?)^```", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for line in "".join(blocks).splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["twistcap"]:
            yield words


@pytest.mark.parametrize("path", PROSE, ids=named)
def test_the_command_line_takes_every_command(path: Path) -> None:
    """Each is parsed as if it were run: its options exist, its values are of their kinds, no argument is missing."""
    for words in shown_commands(path):
        command, rest = typer.main.get_command(app), words[1:]
        while hasattr(command, "commands") and rest and not rest[0].startswith("-"):
            assert rest[0] in command.commands, words
            command, rest = command.commands[rest[0]], rest[1:]
        if not {"--help", "--version"} & set(rest):
            command.make_context(" ".join(words), list(rest))  # raises an error of usage


@pytest.mark.parametrize("path", LINKED, ids=named)
def test_what_is_given_to_make_is_there(path: Path) -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    blocks = re.findall(r"^```sh\n(.*?)^```", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert set(re.findall(r"(?:^|&& )make ([\w-]+)", "".join(blocks), flags=re.MULTILINE)) <= set(targets)


@pytest.mark.parametrize("path", PROSE, ids=named)
def test_names_that_examples_import_exist(path: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for module, names in re.findall(r"^from (twistcap[\w.]*) import (.+)$", "".join(blocks), flags=re.MULTILINE):
        for name in names.split(","):
            assert hasattr(importlib.import_module(module), name.strip()), f"{module} lacks {name}"


@pytest.mark.parametrize("page", ["README.md", "docs/getting-started.md"])
def test_the_python_that_a_newcomer_copies_runs(page: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = tmp_path / "walk"
    run("studio", session, "--frames", 3, "--views", 2)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    (code,) = [block for block in blocks if "open_recording" in block]
    capsys.readouterr()
    exec(re.sub(r'"[^"]*session\.toml"', repr(str(session / "session.toml")), code), {})
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_the_options_of_the_reference_are_those_of_mkdocstrings() -> None:
    """An unknown one stops `make docs`."""
    handler = pytest.importorskip("mkdocstrings_handlers.python", reason="mkdocs is not installed (make docs)")
    import yaml

    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    [plugin] = [one["mkdocstrings"] for one in config["plugins"] if "mkdocstrings" in one]
    options = plugin["handlers"]["python"]["options"]
    handler.PythonOptions.from_data(**options)
