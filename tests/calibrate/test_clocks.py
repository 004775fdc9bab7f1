"""Cameras that were started by hand: clocks by the motion of the board, frames paired by time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.boards import BIG, SIZE, ring_rig, seen_by
from support.commands import document
from twistcap import se3
from twistcap.calibrate.advice import sentences
from twistcap.calibrate.board import board_of
from twistcap.calibrate.calibrate import Calibration, Options, of_sightings
from twistcap.calibrate.sightings import Sighting, moving
from twistcap.calibrate.timing import Timing
from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig
from twistcap.io.videowriter import VideoWriter

Board = Callable[[float], np.ndarray]
SMALL = Options(kinds=("brown",), moments=(40, 12))
LENGTH = 9.0  # s
ARC = 1.2  # rad over which the cameras stand


def path(seed: int) -> Board:
    """(4, 4) board to world by time, s: turned this way and that before the cameras, by three swings on each axis."""
    rng = np.random.default_rng(seed)
    phases, speeds = rng.uniform(0, 2 * np.pi, (6, 3)), rng.uniform(0.1, 0.7, (6, 3))
    sizes = np.array([0.3, 0.4, 0.3, 0.3, 0.3, 0.2])[:, None] / np.array([1.0, 1.5, 2.0])
    return lambda t: _place(np.sum(sizes * np.sin(phases + 2 * np.pi * speeds * t), axis=1))


def rhythm(t: float) -> np.ndarray:
    """The same again twice a second."""
    wave = 4 * np.pi * t
    return _place(np.array([0.4 * np.cos(wave), 0.5 * np.sin(wave), 0.2, 0.1, 0.3 * np.cos(wave), 0.1 * np.sin(wave)]))


def _place(swing: np.ndarray) -> np.ndarray:
    upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
    facing = se3.exp_rotation([0, 0, np.pi / 2 + 0.4 * ARC])
    return se3.transform(facing @ upright @ se3.exp_rotation(swing[:3]), swing[3:] + np.array([-0.3, -0.3, 1.3]))


def made(
    late: Sequence[float], rates: Sequence[float], board: Board, jitter: float = 0.0
) -> tuple[Rig, list[Sighting], Timing]:
    """Sightings of all frames; cameras show moments that are `late` s later."""
    rng = np.random.default_rng(1)
    rig, out, times = ring_rig(len(late), rng, arc=ARC), list[Sighting](), list[np.ndarray]()
    for c, (start, fps) in enumerate(zip(late, rates, strict=True)):
        own = np.arange(round(LENGTH * fps)) / fps
        times.append(own + np.r_[0.0, jitter * rng.uniform(-1, 1, len(own) - 1) / fps])
        for k, t in enumerate(times[-1]):
            ids, pixels = seen_by(rig[c], board(start + t), BIG)
            if len(ids):
                out.append(Sighting(c, k, ids, pixels + 0.02 * rng.normal(size=pixels.shape), 2.0))
    return rig, moving(out, times), Timing(tuple(times), (0,) * len(times))


def calibrated(rig: Rig, seen: list[Sighting], timing: Timing, options: Options = SMALL) -> Calibration:
    return of_sightings(seen, BIG, rig.names, dict.fromkeys(range(len(rig)), SIZE), options, timing=timing)


def check(found: Calibration, rig: Rig, late: Sequence[float]) -> None:
    """Cameras relative to the first to 0.1 %, 0.03° and 2 mm; clocks to 0.05 frames and 3σ."""
    for a, b in zip(found.rig, rig, strict=True):
        assert a.K[0, 0] == pytest.approx(b.K[0, 0], rel=1e-3)
        reached, true = (c.T_cam_world @ se3.inverse(r[0].T_cam_world) for c, r in ((a, found.rig), (b, rig)))
        turn = se3.log_rotation(reached[:3, :3] @ true[:3, :3].T)
        assert np.rad2deg(np.linalg.norm(turn)) < 0.03
        centres = [-T[:3, :3].T @ T[:3, 3] for T in (reached, true)]
        assert np.linalg.norm(centres[0] - centres[1]) < 0.002
    off, sigmas = found.late[0] - np.array(late) / found.timing.interval, found.late[1]
    assert np.all(np.abs(off) < 0.05) and np.all(np.abs(off) <= 3.0 * sigmas)


@pytest.mark.parametrize("frames", [-150])
def test_a_camera_that_was_started_frames_later_is_found(frames: int) -> None:
    late = (0.0, frames / 60)
    rig, seen, timing = made(late, (60, 60), path(3))
    found = calibrated(rig, seen, timing)
    check(found, rig, late)
    told = [line for line in sentences(found) if "shows moments" in line]
    assert [f"{abs(frames)}.0" in line and "frames" in line for line in told] == [True]


@pytest.mark.parametrize(
    ("rates", "jitter"), [((25,) * 4, 0.0), ((30, 25), 0.0), ((29.97, 30), 0.3)],
    ids=["four", "30 and 25", "29.97 and 30, which vary"],
)  # fmt: skip
def test_cameras_of_any_rates_that_were_started_by_hand(rates: tuple[float, ...], jitter: float) -> None:
    late = [0.0, *np.random.default_rng(4).uniform(-2.5, 2.5, len(rates) - 1)]
    rig, seen, timing = made(late, rates, path(3), jitter)
    found = calibrated(rig, seen, timing)
    check(found, rig, late)
    told = next(line for line in sentences(found) if "shows moments" in line)
    assert (" s later" in told or " s earlier" in told) == (len(set(rates)) > 1 or jitter > 0)


@pytest.mark.parametrize(("late", "board"), [(0.7, rhythm), (20.0, path(3))], ids=["rhythm", "never at once"])
def test_a_clock_that_the_motion_does_not_tell_is_named_with_the_mend(late: float, board: Board) -> None:
    rig, seen, timing = made((0.0, late), (12, 12), board)
    with pytest.raises(InputError, match=r"^camera cam1 shows the board elsewhere .*; film again, and turn the board"):
        calibrated(rig, seen, timing, Options(kinds=("brown",), moments=(15, 5)))


def test_videos_of_unlike_rates_that_were_started_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, size, at = "charuco:6x4:220:165:4X4_50", (480, 360), path(3)
    board, cameras = board_of(text), list[Camera]()
    for name, fps, start, angle in (("a", 20, 0.0, 0.0), ("b", 15, 0.8, 0.8)):
        eye = 3.2 * np.array([np.cos(angle), np.sin(angle), 0.5])
        K = np.array([[430.0, 0, 239.5], [0, 430.0, 179.5], [0, 0, 1]])
        cameras.append(Camera(name, K, look_at(eye, [0, 0, 1.0]), size))
        with VideoWriter(tmp_path / f"{name}.mp4", fps=fps) as writer:
            for k in range(3 * fps):
                writer.write(_picture(cameras[-1], at(start + k / fps), board.image(40), board.square / 40))
    videos = [word for c in "ab" for word in ("--videos", f"{c}={tmp_path / c}.mp4")]
    told = document(capsys, "calibrate", tmp_path / "rig", "--board", text, "--lens", "brown", *videos)
    assert told["cameras"][1]["late_s"] == pytest.approx(0.8, abs=0.004)
    found = read_rig(tmp_path / "rig" / "Calib.toml", floor=None)
    reached, true = (r[1].T_cam_world @ se3.inverse(r[0].T_cam_world) for r in (found, cameras))
    assert np.rad2deg(np.linalg.norm(se3.log_rotation(reached[:3, :3] @ true[:3, :3].T))) < 0.2
    assert "shows later moments by" in (tmp_path / "rig" / "calibration.html").read_text(encoding="utf-8")


def _picture(camera: Camera, T: np.ndarray, board: np.ndarray, pitch: float) -> np.ndarray:
    """(H, W, 3) uint8: the board on white paper before grey; its pixels are `pitch` m apart."""
    middle = se3.transform(np.eye(3), [0.5 * pitch * n for n in (*board.shape[::-1], 0)])
    T = camera.T_cam_world @ T @ np.linalg.inv(middle)
    paper = np.pad(board, 20, constant_values=255)
    on_board = np.array([[pitch, 0, -19.5 * pitch], [0, pitch, -19.5 * pitch], [0, 0, 1]])
    H = np.diag([2.0, 2.0, 1.0]) @ camera.K @ T[:3, [0, 1, 3]] @ on_board
    large = cv2.warpPerspective(paper, H, (2 * camera.size[0], 2 * camera.size[1]), borderValue=90)
    grey = cv2.resize(large, camera.size, interpolation=cv2.INTER_AREA)
    return np.repeat(grey[..., None], 3, axis=2)
