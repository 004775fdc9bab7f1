"""A recording that begins beside the body, with cameras that are bumped, moved, blank, swapped, flicker, and a gap: all
outputs say so.
"""

from __future__ import annotations

import csv
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.commands import document, run
from twistcap.camera.bump import turned_back
from twistcap.commands import refine, terminal
from twistcap.io.result import read_result
from twistcap.io.synthetic import write_session
from twistcap.studio import StudioConfig, capture

BUMPED, MOVED, BLANK, GAP, SWAPPED = range(9, 13), range(15, 25), (6, 7), range(30, 36), range(41, 45)
FLICKER, FRAMES = dict(zip(range(48, 54), (1.3, 0.7, 1.2, 0.8, 1.3, 0.7), strict=True)), 56
BUMP = np.deg2rad([0.8, 1.4, -0.5])


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session of a walk in three cameras: one is bumped, then zoomed; one shows grey; all show nothing; two
    give each other's pictures; the exposure of one wavers; and the first pose is 0.25 m beside the body."""
    folder = tmp_path_factory.mktemp("faulty")
    scene = capture(StudioConfig(seed=2, views=3, frames=FRAMES, fps=30.0, size=(320, 240)))
    write_session(scene, folder, "png", masks=False)

    def picture(camera: int, k: int) -> Path:
        return folder / "videos" / scene.rig.names[camera] / f"{k:04d}.png"

    larger = np.array([[1.15, 0.0, 14.0], [0.0, 1.15, 6.0]])
    for k in (*BUMPED, *MOVED):
        image = cv2.imread(str(picture(0, k)))
        assert image is not None
        bumped = turned_back(image, scene.rig[0], -BUMP)
        cv2.imwrite(str(picture(0, k)), cv2.warpAffine(image, larger, image.shape[1::-1]) if k in MOVED else bumped)
    for k in BLANK:
        cv2.imwrite(str(picture(2, k)), np.full((240, 320, 3), 40, np.uint8))
    for k in GAP:
        for camera in range(3):
            picture(camera, k).unlink()
    for k in SWAPPED:
        first, second, aside = picture(0, k), picture(1, k), folder / "aside.png"
        for old, new in ((first, aside), (second, first), (aside, second)):
            old.rename(new)
    for k, factor in FLICKER.items():
        image = cv2.imread(str(picture(1, k)))
        assert image is not None
        cv2.imwrite(str(picture(1, k)), np.clip(factor * image, 0, 255).astype(np.uint8))
    with np.load(folder / "first_pose.npz") as given:
        arrays = dict(given)
    arrays["root"][..., 0, 3] += 0.25
    np.savez(folder / "first_pose.npz", **arrays)
    return folder / "session.toml"


@pytest.fixture(scope="module")
def printed_run(faulty: Path) -> tuple[Path, str]:
    """The folder of a whole track, and what was printed."""
    with redirect_stderr(StringIO()) as printed:
        assert run("track", faulty, "--out", faulty.parent / "out", "--set", "output.overlay=false") == 0
    return faulty.parent / "out", printed.getvalue()


def test_the_result_holds_limbs_and_cameras(printed_run: tuple[Path, str]) -> None:
    result = read_result(printed_run[0] / "result.h5")
    first_out = np.flatnonzero(result.left_out[:, 0])
    assert set(range(MOVED[3], MOVED[-1])) <= set(first_out) and not result.left_out[: min(FLICKER), 1:].any()
    assert first_out[0] in MOVED and first_out[-1] < MOVED[-1] + 12  # it is taken back
    np.testing.assert_array_equal(np.flatnonzero(result.bumps.any(axis=(1, 2))), BUMPED)
    np.testing.assert_allclose(result.bumps[BUMPED, 0], np.tile(BUMP, (len(BUMPED), 1)), atol=np.deg2rad(0.1))
    shown = np.zeros((len(result), 3), bool)
    shown[list(GAP)], shown[list(BLANK), 2] = True, True
    np.testing.assert_array_equal(result.missing, shown)
    unjudged = np.isnan(result.part_probability).any(axis=1)[: min(FLICKER)]
    np.testing.assert_array_equal(unjudged, shown.all(axis=1)[: min(FLICKER)])
    swapped = np.zeros(len(result), bool)
    swapped[list(SWAPPED)] = True
    np.testing.assert_array_equal(result.sources, np.where(swapped[:, None], (1, 0, 2), (0, 1, 2)))
    assert not result.lost[SWAPPED[0] :].any()
    assert result.lost[GAP[-1]] and not result.lost[: GAP[0]].any()


def test_resumed_frames_hold_the_same_and_the_command_tells_it(
    printed_run: tuple[Path, str], faulty: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, quiet = (
        read_result(printed_run[0] / "result.h5"),
        ("--set", "output.overlay=false", "--set", "output.report=false"),
    )
    assert run("track", faulty, "--out", tmp_path, "--frames", "0:25", *quiet) == 0
    output = document(capsys, "track", faulty, "--out", tmp_path, "--resume", *quiet)
    resumed = read_result(tmp_path / "result.h5")
    same = ("q", "probability", "part_probability", "left_out", "missing", "bumps", "sources", "brightness", "lost")
    for name in same:
        np.testing.assert_array_equal(getattr(resumed, name), getattr(whole, name))
    assert output["left_out"]["cam01"] and output["left_out"]["cam03"] == []
    lost, left_out, *others = output["statements"]
    bumped, first, second, flicker, nothing, blank = (said for said in others if "left out" not in said)
    assert output["swapped"] == {"cam01": [*SWAPPED], "cam02": [*SWAPPED], "cam03": []}
    assert first == "camera cam01 gave the pictures of cam02 in 4 frames: 41–44 (they count as those)"
    assert second == "camera cam02 gave the pictures of cam01 in 4 frames: 41–44 (they count as those)"
    assert lost.startswith(f"{len(output['lost'])} of {FRAMES} frames lost: ")
    assert lost.endswith(f"–{GAP[-1]} (no images)")
    assert left_out.startswith(f"camera cam01 was left out in {len(output['left_out']['cam01'])} frames: ")
    assert left_out.endswith("; it contradicts the others (bumped, frozen, late or swapped?)")
    assert bumped.startswith(f"camera cam01 was out of its place in 4 frames: {BUMPED[0]}–{BUMPED[-1]} (turned by 1.7°")
    said = (
        f"the pictures of camera cam02 got brighter and darker in 8 frames: {min(FLICKER) - 1}–{max(FLICKER) + 1} (by "
    )
    assert flicker.startswith(said)
    assert nothing.startswith(f"no camera showed anything new in 6 frames: {GAP[0]}–{GAP[-1]} (")
    assert blank.startswith("camera cam03 showed nothing new in 2 frames: 6–7 (")


def test_what_is_printed_and_written_tells_it(printed_run: tuple[Path, str]) -> None:
    (out, printed), page = printed_run, (printed_run[0] / "report.html").read_text()
    for text in (printed, page):
        assert "camera cam01 was left out in" in text and "camera cam01 was out of its place in" in text
        assert "(no images)" in text and "camera cam02 got brighter and darker in 8 frames" in text
        assert "frame 0 shows the body 0.25 m from the first pose; it is tracked there" in text
    assert f"frame {BUMPED[0]}: camera cam01 was bumped, or sways; its pictures are turned back" in printed
    assert f"frame {BUMPED[-1] + 1}: camera cam01 stands again as it was calibrated" in printed
    for said in ("gives the pictures of another one; they count as those", "gives its own pictures again"):
        assert printed.count(f"camera cam01 {said}") == printed.count(f"camera cam02 {said}") == 1
    assert "Cameras that gave the pictures of others: cam01 those of cam02 in 41–44" in page
    assert printed.count("camera cam01 is left out") == 1 and printed.count("camera cam01 is believed again") == 1
    with (out / "angles.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows[GAP[0]]["probability_lost_arm_l"] == "" and float(rows[0]["probability_lost_arm_l"]) < 0.5


@pytest.mark.parametrize(("done", "total"), [(0, None), (147, 315)])
def test_a_bar_of_a_finished_run_is_full(done: int, total: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    bar = terminal._bar()
    monkeypatch.setattr(terminal, "_bar", lambda: bar)
    with terminal.status("refining") as report:
        report("round 3", done, total)
    assert bar.finished and bar.tasks[0].total == (total or 1)


def test_lengths_that_were_held_are_not_listed(capsys: pytest.CaptureFixture[str]) -> None:
    bones = [("femur_r", 402.0, 402.1), ("tibia_r", 402.0, 398.0)]
    rows = [{"segment": name, "before_mm": before, "after_mm": after} for name, before, after in bones]
    about = {"lengths": [], "girths": [], "bones": rows, "moved_mm": [1.0], "frames": 9, "joints_held": False}
    refine.show(about | {"helped": True, "statements": [], "files": []})
    told = capsys.readouterr()
    assert "tibia_r: 402 mm before, 398 mm after" in told.err + told.out and "femur_r" not in told.err + told.out
