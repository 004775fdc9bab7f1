"""The page of a calibration says what to do as the terminal does."""

from __future__ import annotations

from pathlib import Path

from support.boards import filmed
from twistcap.calibrate.advice import sentences
from twistcap.calibrate.calibrate import Options, of_sightings
from twistcap.report.calibration import write_calibration_page


def test_all_but_the_lines_of_the_cameras_is_to_be_done(tmp_path: Path) -> None:
    made = filmed(2)
    sizes = {c: camera.size for c, camera in enumerate(made.rig)}
    names = tuple(rf"{name} $\x$" for name in made.rig.names)  # which is no formula
    found = of_sightings(made.sightings, made.board, names, sizes, Options(kinds=("brown",)))
    page = write_calibration_page(found, tmp_path).read_text(encoding="utf-8")
    todo = page.partition("What to do")[2].partition("</ul>")[0]
    assert "--floor" in todo and "By 90 mm a square, the cameras are" not in todo.partition("<li>")[0]
    assert "--floor" in todo and todo.count("<li>") == len(sentences(found)) - len(made.rig)
