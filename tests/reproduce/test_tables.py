"""The accuracy tables: the table's shape, its sums, and that a tracker that does not follow is told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from reproduce import tables
from reproduce.cases import PRIOR, STUDIO, UNITS, Bar, Case, Suite
from reproduce.sequence import Outcome, Pictures, noisy_keypoints, run_case
from twistcap.errors import InputError
from twistcap.studio import StudioConfig, capture
from twistcap.track import Settings

SMALL = StudioConfig(views=2, size=(192, 140), frames=16)
CASE = {case.id: case for case in STUDIO.cases}


def silent(note: str, done: int = 0, total: int | None = None) -> None:
    pass


def outcome(khe: float, lost: bool = False, angle: float = 0.0) -> Outcome:
    values = dict.fromkeys(UNITS, 0.0) | {"KHE": khe, "lost sequences": float(lost)}
    return Outcome(values, np.full((3, 8), angle))  # pyright: ignore[reportArgumentType]


def test_the_table_holds_every_asked_case() -> None:
    asked = {
        (case.id, bar.measure): bar.at_most for case in STUDIO.cases for bar in case.bars if bar.at_most is not None
    }
    for condition, khe, joints in (("exact", 0.7, 3.0), ("mismatch", 1.2, 8.0)):
        for method in ("direct", "levelset"):
            name = f"4-views-{condition}-{method}"
            assert (asked[name, "KHE"], asked[name, "joints"], asked[name, "lost sequences"]) == (khe, joints, 0.0)
    assert asked["4-views-mismatch-30fps", "KHE"] == 1.2 and CASE["4-views-mismatch-30fps"].every == 2
    assert (asked["stereo-exact", "KHE"], asked["stereo-exact", "joints"]) == (1.2, 6.0)
    assert asked["first-pose", "joints"] == 15.0
    for case in STUDIO.cases:
        assert (case.studio.size, case.studio.frames, case.studio.fps) == ((384, 280), 60, 60.0)


def test_names_choose_lines_of_the_table() -> None:
    assert tables.selected("studio") is STUDIO
    assert [case.id for case in tables.selected("stereo-exact").cases] == ["stereo-exact"]
    both = tables.selected("direct-levelset-exact")
    assert {case.id for case in both.cases} == {"4-views-exact-direct", "4-views-exact-levelset"}
    with pytest.raises(InputError, match="no line 'walk'; choose one of studio, prior, harder"):
        tables.selected("walk")


def test_quick_is_a_shorter_table_of_the_same_cases() -> None:
    quick = tables.shortened(STUDIO)
    assert {case.id for case in quick.cases} < set(CASE) and len(quick.agreements) == 1
    assert all((case.frames or 99) <= tables.QUICK_FRAMES for case in quick.cases)
    one = tables.shortened(tables.selected("4-views-mismatch-30fps"))
    assert [case.id for case in one.cases] == ["4-views-mismatch-30fps"]
    assert [case.id for case in tables.shortened(PRIOR).cases] == [case.id for case in PRIOR.cases]


def test_rows_are_sums_over_the_seeds() -> None:
    bars = (Bar("KHE", 1.0), Bar("KHE", 1.0, "worst"), Bar("lost sequences", 0.0, "sum"))
    cases = tuple(Case(name, "", SMALL, Settings(), bars) for name in ("a", "b"))
    agreement = replace(STUDIO.agreements[0], first="a", second="b")
    outcomes = {"a": [outcome(0.5), outcome(1.1, lost=True, angle=2.0)], "b": [outcome(0.7), outcome(0.9)]}
    mean, worst, lost, *rest = tables.rows_of(Suite("s", "", cases, (agreement,)), outcomes)
    assert mean["value"] == pytest.approx(0.8) and mean["holds"] and mean["seeds"] == [0.5, 1.1] and mean["lost"] == 1
    assert worst["value"] == 1.1 and worst["holds"] is False
    assert lost["value"] == 1.0 and lost["holds"] is False
    errors, angles = rest[3:]
    assert errors["seeds"] == pytest.approx([0.2, 0.2]) and errors["holds"]
    assert angles["value"] == pytest.approx(1.0) and angles["target"] is None


def test_a_sequence_without_an_answer_never_holds() -> None:
    case = Case("a", "", SMALL, Settings(), (Bar("KHE", 1.0),))
    (row,) = tables.rows_of(Suite("s", "", (case,)), {"a": [outcome(0.5), outcome(np.inf)]})
    assert row["holds"] is False and row["value"] is None and row["seeds"] == [0.5, None]


def test_run_prints_a_table_and_tells_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    small = replace(CASE["stereo-exact"], id="small", studio=SMALL, frames=2)
    suite = Suite("tiny", "", (small, replace(small, id="again")))
    monkeypatch.setattr(tables, "SUITES", (suite,))
    told: list[tuple[int, int | None]] = []
    table = tables.run("tiny", (3,), False, lambda note, done=0, total=None: told.append((done, total)))
    assert table["id"] == "tiny" and told == [(1, 1)]
    rows = {(row["case"], row["metric"]): row for row in table["rows"]}
    assert set(rows) == {(case, bar.measure) for case in ("small", "again") for bar in small.bars}
    for measure in ("KHE", "joints", "lost sequences"):
        row = rows["small", measure]
        assert row["holds"] and row["seeds"] == rows["again", measure]["seeds"] and len(row["seeds"] or []) == 1
    assert 0.0 < (rows["small", "KHE"]["value"] or 0.0) < 1.2


def test_a_tracker_that_stands_still_does_not_hold() -> None:
    case = replace(CASE["stereo-exact"], studio=SMALL, tracker=Settings(predictor="hold", brightness=False), every=15)
    stands = StudioConfig(**{**vars(SMALL), "dropped": ((1, SMALL.frames - 1),)})
    found = run_case(case, Pictures(capture(stands)))
    rows = {row["metric"]: row for row in tables.rows_of(Suite("s", "", (case,)), {case.id: [found]})}
    assert [rows[m]["holds"] for m in ("KHE", "joints", "lost sequences")] == [False, False, False]
    assert rows["KHE"]["lost"] == 1


@pytest.mark.parametrize("start", ["keypoints", "keypoints, lengths unknown"])
def test_first_pose_from_keypoints_gets_better_on_the_images(start: str) -> None:
    case = replace(CASE["first-pose"], start=start)  # pyright: ignore[reportArgumentType]
    scene = capture(case.studio)
    noise = noisy_keypoints(scene, 3.0).pixels - noisy_keypoints(scene, 0.0).pixels
    assert noise.std() == pytest.approx(3.0, rel=0.15)
    values = run_case(case, Pictures(scene)).values
    assert values["joints"] < 0.5 * values["joints at the start"]
    assert values["joints at the start"] < 30
