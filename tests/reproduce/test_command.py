"""``python -m reproduce``: its names, one JSON document, and one sentence where something is asked wrongly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from reproduce import catalogue, tables
from reproduce.__main__ import main, parsed_seeds
from reproduce.arms import Findings
from reproduce.experiments import EXPERIMENTS
from reproduce.experiments.fast_motion import FASTEST, fastest, waving
from twistcap.errors import InputError
from twistcap.evaluate.metrics import row

NAMES = [entry["id"] for entry in catalogue.listed()]


def run(*arguments: object) -> int:
    """Exit code of the command."""
    with pytest.raises(SystemExit) as done:
        main([str(a) for a in arguments])
    return int(done.value.code or 0)


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one sentence on stderr; exit code 2, nothing on stdout."""
    capsys.readouterr()
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    lines = err.strip().splitlines()
    assert out == "" and len(lines) == 1 and lines[0].startswith("reproduce: "), err
    return lines[0]


def test_every_name_is_its_own_and_has_a_line() -> None:
    assert len(set(NAMES)) == len(NAMES)
    assert {"studio", "prior", "harder", "bench", "C-1", "D-7", "T-EM", "B-2"} < set(NAMES)
    assert all(len(experiment.says) > 20 for experiment in EXPERIMENTS)


def test_the_readme_tells_of_every_experiment_and_table() -> None:
    readme = (Path(catalogue.__file__).parent / "README.md").read_text()
    names = [*(suite.id for suite in tables.SUITES), *(experiment.id for experiment in EXPERIMENTS)]
    assert [name for name in names if f"`{name}`" not in readme] == []


def test_the_list_is_one_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--list", "--json") == 0
    assert [case["id"] for case in json.loads(capsys.readouterr().out)["cases"]] == NAMES


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("X-9", "--seeds", "0"), "there is no case 'X-9'; choose one of studio, prior"),
        (("X-9", "--out", "somewhere"), "there is no case 'X-9'"),
        ((), "--list"),
        (("studio", "--out", "somewhere"), "studio draws no picture"),
        (("studio", "--seeds", "x"), "write FIRST-LAST"),
        (("C-3", "--seeds", "7-0"), "write FIRST-LAST"),
        (("C-3", "--seeds", ""), "write FIRST-LAST"),
        (("C-3", "--seeds", "²"), "write FIRST-LAST"),
    ],
)
def test_what_is_asked_wrongly_is_told(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert words in refusal(capsys, *arguments)
    assert not list(tmp_path.iterdir())


def test_seeds_are_read_once_each() -> None:
    assert parsed_seeds("40-43") == (40, 41, 42, 43) and parsed_seeds("3, 0,3") == (3, 0)
    with pytest.raises(InputError, match="--seeds"):
        parsed_seeds("5-4")


def test_a_table_is_one_document(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[Any] = []

    def fake(name: str, seeds: Any, quick: bool, progress: Any) -> dict[str, Any]:
        seen.append((name, tuple(seeds), quick))
        progress("half way")
        return {"id": "table", "rows": [row("c", "m", float("nan"), "deg", seeds=list(seeds), lost=0)]}

    monkeypatch.setattr(catalogue.tables, "run", fake)
    monkeypatch.setattr(catalogue.bench, "run", fake)
    for name, given, seeds in (("studio", "studio", (1, 2)), ("bench", None, (1, 2, 3))):
        capsys.readouterr()
        assert run(name, "--seeds", "1-3", "--quick", "--json") == 0
        found = json.loads(capsys.readouterr().out)
        assert seen.pop() == (given, seeds, True)
        assert found["rows"][0]["value"] is None and found["rows"][0]["seeds"] == list(seeds)
    assert run("stereo-direct") == 0
    assert seen.pop() == ("stereo-direct", (0,), False)
    assert "table" in capsys.readouterr().out


def test_an_experiment_is_given_its_seeds_and_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    seen: list[Any] = []

    class Drawing:
        id, says = "X-1", "an experiment that draws bars"

        def run(self, seeds: Any, progress: Any, out: Path | None = None) -> Findings:
            seen.append((tuple(seeds), out))
            return Findings([row(self.id, "m", 2.0, "mm", seeds=[2.0])], "error, mm", ())

    monkeypatch.setattr(catalogue, "EXPERIMENTS", (Drawing(),))
    assert run("X-1", "--seeds", "40-43", "--out", tmp_path / "new", "--json") == 0
    assert seen == [((40, 41, 42, 43), tmp_path / "new")]
    assert json.loads(capsys.readouterr().out)["rows"][0]["value"] == 2.0
    assert (tmp_path / "new" / "X-1.png").stat().st_size > 0


def test_the_waving_arm_is_as_fast_as_it_is_said_to_be() -> None:
    scene = waving(1)
    assert fastest(scene.true_body, scene.true_poses, scene.true_rig, "wrist_r") == pytest.approx(FASTEST, rel=0.03)
