"""C-4 and C-5: a leg that no view shows, clutter over every image; and the pictures of a comparison."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from reproduce.arms import Comparison, Findings, Trace, run_seed
from reproduce.experiments.clutter import C5
from reproduce.experiments.hidden_leg import C4, LEG
from reproduce.pictures import seed_picture
from reproduce.scenes.disturbed import Board, boarded
from twistcap.studio import StudioConfig, capture

SMALL = StudioConfig(seed=3, views=2, size=(192, 140), frames=4)


def test_a_hidden_leg_comes_back_to_what_is_seen_of_it() -> None:
    """Behind boards in frames 2 to 4 the leg is carried by the prior alone; the frame after, the images have it."""
    scene = boarded(capture(StudioConfig(seed=7, views=3, frames=8)), (Board(LEG, 2, 4),))
    assert C4.arms[-1].prior == "another's walk"
    trace = run_seed(replace(C4, scene=lambda _: scene, arms=C4.arms[-1:], shown=(4, 0), span=(2, 4)), 7)[0]
    assert trace.errors[2:5].max() < 10.0 and trace.errors[-1] < 1.0
    assert not trace.lost


@pytest.mark.parametrize("experiment", [C4, C5])
def test_a_picture_per_seed(experiment: Comparison, tmp_path: Path) -> None:
    boards = (Board(LEG, 1, 2),) if experiment is C4 else ()
    scene = boarded(capture(replace(SMALL, rectangles=5)), boards)
    short = replace(experiment, scene=lambda _: scene, shown=(2, 1), span=(1, 2))
    traces = run_seed(short, 3)
    assert [t.arm for t in traces] == [arm.name for arm in experiment.arms]
    for trace in traces:
        assert trace.joints_mm.shape[0] == 4 and np.array_equal(trace.shot.truth, scene.masks(2)[1])
    findings = Findings([], short.quantity, traces, short.watched, short.span)
    picture = cv2.imread(str(seed_picture(tmp_path / "a.png", short, findings, 3)))
    bare = cv2.imread(str(seed_picture(tmp_path / "b.png", short, replace(findings, span=None), 3)))
    assert picture.shape == bare.shape and np.any(picture != bare)
    if experiment is C4:
        true = [np.degrees(p.q[scene.true_body.coordinate("knee_angle_r")]) for p in scene.true_poses]
        np.testing.assert_allclose(traces[0].true_course, true)


def test_the_bars_of_both_claims() -> None:
    """One line says whether a sequence was lost; what is asked of it depends on the arm."""
    for experiment, arm, holds in ((C4, 0, False), (C4, 2, True), (C5, 0, None), (C5, 1, True)):
        name = experiment.arms[arm].name
        kept = Trace(name, 0, np.ones(60), np.ones((60, 2)), [], None)  # type: ignore[arg-type]
        lost = replace(kept, joints_mm=np.full((60, 2), 30.0), errors=np.full(60, 9.0))
        good, bad = experiment.rows([kept])[0], experiment.rows([lost])[0]
        assert (good["value"], bad["value"]) == (0.0, 1.0)
        assert good["holds"] is holds and bad["holds"] is (None if holds is None else not holds)
