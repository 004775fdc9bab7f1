"""Events by expressions: their grammar, on signals that are known, on a studio walk, and by the command."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from support.commands import document, refusal
from twistcap.body import Pose
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.evaluate.cycles import cycles_between
from twistcap.evaluate.events import Event, event_times, parsed_event
from twistcap.evaluate.filters import Filter, Filtered, Motion, filtered
from twistcap.io.coordinates import Coordinates
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.studio.motion import gait as walk

FPS, N = 60.0, 240
BODY = humanoid()


def made(path: Path, poses: list[Pose], lost: int = -1) -> Result:
    with ResultWriter(path, BODY, ring(), {}) as writer:
        for n, pose in enumerate(poses):
            writer.append(Estimate(n, n / FPS, pose, np.eye(BODY.dof) * 1e-6, lost=n == lost))
    return read_result(path)


def angles_of(result: Result, cutoff: float = 12.0) -> object:
    motion = Motion(result.body, result.times, result.poses, result.covariances, result.known)
    return filtered(motion, Filter(cutoff=cutoff))


@pytest.fixture(scope="module")
def swinging(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """The right knee is at 40° − 30° cos(2π t), and the body rises and falls by 0.1 m with it."""
    poses = list[Pose]()
    for n in range(N):
        wave = np.cos(2 * np.pi * n / FPS)
        pose = Pose.rest(BODY)
        root, q = pose.root.copy(), pose.q.copy()
        root[2, 3] += 1.0 - 0.1 * wave
        q[BODY.coordinate("knee_angle_r")] = np.deg2rad(40 - 30 * wave)
        poses.append(Pose(root, q))
    return made(tmp_path_factory.mktemp("swing") / "r.h5", poses)


@pytest.mark.parametrize(
    ("text", "event"),
    [
        ("landing = heel_r.z falls below 0.05", Event("landing", "heel_r.z", False, "falls below", 0.05)),
        (" a=speed of toe_l rises  above -1e-1 ", Event("a", "toe_l", True, "rises above", -0.1)),
        ("top = knee_angle_r maximum", Event("top", "knee_angle_r", False, "maximum")),
        ("least = speed of pelvis_tilt minimum", Event("least", "pelvis_tilt", True, "minimum")),
    ],
)
def test_expressions_are_read(text: str, event: Event) -> None:
    assert parsed_event(text) == event


@pytest.mark.parametrize(
    "text",
    ["", "heel_r.z falls below 0.05", "a = heel_r.z falls 0.05", "a = heel_r.z falls below", "a = b maximum 3",
     "a = __import__('os').remove('x') maximum", "a b = heel_r.z maximum", "a = heel_r.z falls below nan",
     "a = heel_r.z falls below ten"],
)  # fmt: skip
def test_what_is_no_expression_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="event"):
        parsed_event(text)


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("a = knee_angle_r maximum", 0.5),
        ("a = knee_angle_r rises above 40", 0.25),
        ("a = knee_angle_r falls below 40", 0.75),
        ("a = knee_angle_r falls below 25", 5 / 6),
        ("a = speed of knee_angle_r maximum", 0.25),
        ("a = speed of knee_angle_r minimum", 0.75),
        ("a = mid_hip.z maximum", 0.5),
        ("a = speed of mid_hip.z falls below 0", 0.5),
        ("a = speed of mid_hip falls below 0.3141593", 0.5 - 1 / 12),  # and once more in the other half
    ],
)
def test_events_are_where_the_signal_says(swinging: Result, text: str, at: float) -> None:
    found = event_times(parsed_event(text), swinging, angles_of(swinging))
    whole = found[(found > 0.3) & (found < 3.7)]
    if "speed of mid_hip falls" in text:
        assert len(whole) >= 6
        assert np.abs((whole - at + 0.25) % 0.5 - 0.25).max() < 0.5 / FPS
    else:
        assert len(whole) in (3, 4)
        assert np.abs((whole - at + 0.5) % 1.0 - 0.5).max() < 0.5 / FPS


def test_nothing_happens_where_nothing_is_known(swinging: Result) -> None:
    lost = swinging.lost.copy()
    lost[90:92] = True  # the maximum at 1.5 s
    gap = replace(swinging, lost=lost)
    event = parsed_event("a = knee_angle_r maximum")
    whole, less = (event_times(event, result, angles_of(result)) for result in (swinging, gap))
    assert set(np.round(whole, 3)) - set(np.round(less, 3)) == {1.5}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a = heel_r falls below 1", "write heel_r.x, heel_r.y or heel_r.z, or speed of heel_r"),
        ("a = heel_r.w falls below 1", "heel_r.w is no number"),
        ("a = knee_angle falls below 1", "there is no 'knee_angle'; name a landmark"),
        ("a = pelvis_tx falls below 1", "there is no 'pelvis_tx'"),
    ],
)
def test_a_signal_that_there_is_not_is_refused(swinging: Result, text: str, sentence: str) -> None:
    with pytest.raises(InputError) as refused:
        event_times(parsed_event(text), swinging, angles_of(swinging))
    assert sentence in str(refused.value)


@pytest.mark.parametrize("seed", range(100, 104))
def test_events_of_noisy_walks_are_within_two_frames(seed: int, tmp_path: Path) -> None:
    """The walk's knee is most bent at the same per cent of each stride; its truth is the walk, sampled finely."""
    rng = np.random.default_rng(seed)
    speed, phase, sigma = rng.uniform(0.8, 1.6), rng.uniform(), np.deg2rad(1.0)
    poses = walk(BODY, fps=FPS, frames=N, speed=speed, phase=phase)
    noisy = [Pose(p.root, p.q + rng.normal(0.0, sigma, len(p.q))) for p in poses]
    result = made(tmp_path / "r.h5", noisy)
    found = event_times(parsed_event("a = knee_angle_r maximum"), result, angles_of(result, 6.0))
    fine = walk(BODY, fps=FPS * 20, frames=N * 20, speed=speed, phase=phase)
    knee = np.array([p.q[BODY.coordinate("knee_angle_r")] for p in fine])
    peaks = np.flatnonzero((knee[1:-1] > knee[:-2]) & (knee[1:-1] >= knee[2:]) & (knee[1:-1] > 0.8 * knee.max())) + 1
    truth = peaks / (FPS * 20)
    inner = truth[(truth > 0.1) & (truth < N / FPS - 0.1)]
    assert len(inner) >= 2
    assert max(np.abs(found - time).min() for time in inner) < 2 / FPS
    assert max(np.abs(truth - time).min() for time in found) < 2 / FPS


def test_cycles_with_a_frame_that_is_not_known_are_left_out() -> None:
    """Though it falls between two of the 101 samples."""
    times, values = np.arange(1200) / 100, np.sin(np.arange(1200) / 100)[:, None]
    values[[150, 451]] = np.nan
    table = Coordinates(("knee_angle_r",), np.array([True]), values, np.ones_like(values))
    walk = Filtered(table, values, np.ones_like(values), np.array([6.0]))
    for shift in (0.0, 0.005, 0.015):
        found = cycles_between(np.array([0.0, 3.0, 6.0, 9.0]) + shift, times, walk)
        assert found["knee_angle_r"].strides == 1


def test_the_command_writes_events_and_cycles_between_them(
    swinging: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "r.h5"
    made(path, list(swinging.poses))
    wish = ["gait", path, "--out", tmp_path / "out", "--event", "bent = knee_angle_r maximum", "--cycles", "bent"]
    found = document(capsys, *wish, "--cutoff", 12)
    np.testing.assert_allclose(found["events"]["bent"], [0.5, 1.5, 2.5, 3.5], atol=0.01)
    with (tmp_path / "out" / "events.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["event"] == "bent"]
    assert [int(row["frame"]) for row in rows] == [30, 90, 150, 210]
    with (tmp_path / "out" / "cycles.csv").open() as file:
        knee = [row for row in csv.DictReader(file) if row["coordinate"] == "knee_angle_r"]
    assert len(knee) == 101 and {row["strides"] for row in knee} == {"3"} and {row["side"] for row in knee} == {""}
    curve = [float(row["mean_deg"]) for row in knee]
    np.testing.assert_allclose(curve, 40 + 30 * np.cos(2 * np.pi * np.arange(101) / 100), atol=1.0)
    assert "there is no event 'up'" in refusal(capsys, "gait", path, "--cycles", "up")
    twice = ["--event", "a = knee_angle_r maximum", "--event", "a = knee_angle_r minimum"]
    assert "two events 'a'" in refusal(capsys, "gait", path, *twice)


@pytest.mark.usefixtures("drawn")
def test_bands_hold_for_both_legs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A norm is of a leg from its own heel strike, so that the walk's own knee is within it on both sides. Cycles from
    one foot's strikes hold the other leg half a cycle off: no band may stand behind them."""
    made(tmp_path / "r.h5", walk(BODY, fps=FPS, frames=N, speed=1.2))
    document(capsys, "gait", tmp_path / "r.h5", "--out", tmp_path)
    with (tmp_path / "cycles.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["coordinate"].startswith("knee_angle")]
    right, left = (np.array([float(row["mean_deg"]) for row in rows if row["side"] == side]) for side in "rl")
    assert np.abs(left - right).max() < 3 < 30 < np.abs(np.roll(left[:-1], 50) - right[:-1]).max()
    norm = [[percent, angle - 3, angle + 3] for percent, angle in enumerate(right.tolist())]
    (tmp_path / "n.json").write_text(json.dumps({"A": {"Free": {"KneeAngles": {"X": norm}}}}))
    plain = (tmp_path / "cycles.png").read_bytes()
    document(capsys, "gait", tmp_path / "r.h5", "--out", tmp_path, "--norms", tmp_path / "n.json")
    assert (tmp_path / "cycles.png").read_bytes() != plain
    for event in ("heel_strike_r", "toe_off_l"):
        sentence = refusal(capsys, "gait", tmp_path / "r.h5", "--cycles", event, "--norms", tmp_path / "n.json")
        assert f"each leg's own heel strike, and {event} would start the cycles of both legs" in sentence
