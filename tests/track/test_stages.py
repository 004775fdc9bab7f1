"""The stopwatch: per frame, nested stages apart, nothing when off."""

from __future__ import annotations

from time import sleep

import pytest

from twistcap import stages


def test_stages_are_summed_by_frame_and_inner_ones_taken_out() -> None:
    with stages.record() as times:
        for pause in (0.002, 0.004, 0.0):
            stages.next_frame()
            with stages.stage("outer"):
                for _ in range(2):
                    with stages.stage("inner"):
                        sleep(pause)
        stages.next_frame()
    assert sorted(times) == ["inner", "outer"]
    assert [len(entries) for entries in times.values()] == [4, 4]
    assert times["inner"][0] >= 0.004 and times["inner"][1] >= 0.008  # a busy machine may sleep longer
    assert max(times["outer"]) < max(times["inner"]) and times["inner"][3] == 0.0


def test_nothing_is_recorded_outside() -> None:
    with stages.record() as times:
        pass
    with stages.stage("late"):
        pass
    stages.next_frame()
    assert times == {}


def test_a_broken_stage_still_counts_and_leaves_the_recorder_whole() -> None:
    with stages.record() as times:
        with pytest.raises(ValueError), stages.stage("broken"):
            raise ValueError
        with stages.stage("after"):
            pass
    assert len(times["broken"]) == len(times["after"]) == 1
