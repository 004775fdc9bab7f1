"""Timings: the table's shape; no test looks at how long anything took."""

from __future__ import annotations

from dataclasses import replace

import pytest

from reproduce import bench
from twistcap.errors import InputError
from twistcap.studio import StudioConfig


def silent(note: str, done: int = 0, total: int | None = None) -> None:
    pass


def test_the_asked_limits_stand() -> None:
    limits = {b.id: b.at_most for b in bench.BENCHES}
    assert limits == {"stereo-direct": 8.0, "stereo-levelset": 25.0, "4-views-direct": None, "4-views-levelset": None}
    assert all((b.studio.size, b.studio.frames) == ((384, 280), 60) for b in bench.BENCHES)


def test_unknown_names_are_told() -> None:
    with pytest.raises(InputError, match="no timing 'walk'; choose one of stereo-direct"):
        bench.run("walk", (0,), True, silent)


def test_a_line_for_the_frame_then_one_for_each_stage() -> None:
    limited = replace(bench.BENCHES[0], at_most=8.0)
    seeds = [{"total": [7.0, 9.0, 7.0], "render": [3.0, 1.0, 2.0]}, {"total": [10.0], "render": [4.0], "solve": [1.0]}]
    rows = bench.rows_of(limited, seeds)
    assert [row["metric"] for row in rows] == ["total", "render", "solve"]
    assert rows[0]["value"] == 8.5 and rows[0]["holds"] is False and rows[0]["seeds"] == [7.0, 10.0]
    assert rows[1]["value"] == 3.0 and rows[1]["target"] is None and rows[1]["unit"] == "ms"


def test_every_frame_but_the_first_few_is_timed() -> None:
    small = replace(bench.BENCHES[0], studio=StudioConfig(views=2, size=(192, 140), frames=6))
    times = bench.timed(small, seed=1)
    assert len(times[bench.TOTAL]) == 6 - bench.WARM
    for stage, spent in times.items():
        assert all(0.0 <= ms <= total for ms, total in zip(spent, times[bench.TOTAL], strict=True)), stage
