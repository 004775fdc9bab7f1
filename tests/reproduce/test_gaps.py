"""D-1 to D-5: the scenes are what they claim, and the tracker goes on through a gap by recorded motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reproduce.arms import run_seed
from reproduce.experiments import gaps
from reproduce.recorded import Recording, data_file
from twistcap.errors import InputError


@pytest.fixture
def recorded(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWISTCAP_DATA", str(shared_data))


def test_without_data_the_folder_is_asked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("TWISTCAP_DATA", raising=False)
    with pytest.raises(InputError, match="set TWISTCAP_DATA"):
        data_file("motions/cmu/08_02.amc")
    monkeypatch.setenv("TWISTCAP_DATA", str(tmp_path))
    with pytest.raises(InputError, match="not there"):
        data_file("motions/cmu/08_02.amc")


@pytest.mark.usefixtures("recorded")
def test_training_motion_is_never_the_tracked_stretch() -> None:
    studies = (gaps.D1, gaps.D1_SPEED, gaps.D1_OTHER, gaps.D2, gaps.D3, gaps.D3_OTHERS, gaps.D4, gaps.D5)
    for study in studies:
        scenes = study.scene.__self__  # type: ignore[attr-defined]
        for trained in scenes.trained:
            same = trained.file == scenes.tracked.file
            assert not same or (trained.last is not None and trained.last <= scenes.tracked.first + 1)


@pytest.mark.usefixtures("recorded")
def test_another_speed_of_the_clip_and_its_cycles() -> None:
    scene = gaps.D1.scene(0)
    whole = Recording(gaps.RUN).clip(scene.body, 60.0)
    np.testing.assert_array_equal(Recording(gaps.RUN, 280, every=2).clip(scene.body, 60.0).q, whole.q[280::2])
    once = Recording(f"{gaps.MIMIC}_run.txt").clip(scene.body, 60.0)
    assert len(Recording(f"{gaps.MIMIC}_run.txt", cycles=3).clip(scene.body, 60.0)) == 3 * (len(once) - 1) + 1


@pytest.mark.usefixtures("recorded")
def test_a_walk_goes_on_through_25_frames_without_images() -> None:
    undisturbed, followed, scaled = run_seed(gaps.D1, 0)
    assert undisturbed.errors.mean() < 1.0
    for trace in (followed, scaled):
        assert [e.status == "no_images" for e in trace.estimates] == [22 <= e.index <= 46 for e in trace.estimates]
        assert trace.errors[22:47].mean() < 5.0
        assert gaps.resumed(trace)
