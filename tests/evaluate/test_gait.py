"""Gait: the studio's walk, whose events and cycle are known, and a real walk on force plates."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from support.commands import document, refusal, run
from twistcap import se3
from twistcap.arrays import Float, even_clock, runs
from twistcap.body import Body, Pose
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.evaluate.filters import Filter, Motion, filtered
from twistcap.evaluate.gait import cycles, facing, gait_of, parameters, symmetry
from twistcap.evaluate.smoothing import butterworth
from twistcap.io.coordinates import coordinates_of
from twistcap.io.motion_files import MotionTable, poses_from_mot, read_mot
from twistcap.io.norms import PERCENT
from twistcap.io.result import ResultWriter
from twistcap.studio.motion import gait as walk

FPS, SPEED, PHASE = 60.0, 1.3, 0.2
PERIOD = 120.0 / np.sqrt(SPEED * 60.0 / 0.0064)  # s, one stride of the studio's walk at this speed


@pytest.fixture(scope="module")
def body() -> Body:
    return humanoid()


@pytest.fixture(scope="module")
def poses(body: Body) -> list[Pose]:
    return walk(body, fps=FPS, frames=400, speed=SPEED, heading=0.8, phase=PHASE)


TIMES = np.arange(400) / FPS
FILES = ["events.csv", "gait.csv", "strides.csv", "cycles.csv", "cycles.png"]


def off(found: Float, first: float, period: float) -> Float:
    """Seconds from events to those of a period."""
    return (found - first + period / 2) % period - period / 2


def test_events_of_the_studios_walk(body: Body, poses: list[Pose]) -> None:
    gait = gait_of(body, TIMES, poses)
    for side, half in (("r", 0.0), ("l", 0.5)):
        assert len(gait.strikes[side]) >= 5
        assert np.abs(off(gait.strikes[side], (half - PHASE) * PERIOD, PERIOD)).max() < 2 / FPS
        assert np.abs(off(gait.toe_offs[side], (half + 0.60 - PHASE) * PERIOD, PERIOD)).max() < 2 / FPS


def test_parameters_of_the_studios_walk(body: Body, poses: list[Pose]) -> None:
    found = parameters(gait_of(body, TIMES, poses, np.tile(np.eye(body.dof) * 1e-6, (400, 1, 1))))
    both = {name: measure.mean for name, measure in found["both"].items()}
    assert both["stride time"] == pytest.approx(PERIOD, abs=0.002)
    assert both["speed"] == pytest.approx(SPEED, rel=0.01)
    assert both["stride length"] == pytest.approx(SPEED * PERIOD, rel=0.01)
    assert both["step length"] == pytest.approx(SPEED * PERIOD / 2, rel=0.03)
    assert both["step time"] == pytest.approx(PERIOD / 2, abs=0.002)
    assert both["stance"] == pytest.approx(60, abs=2) and both["double support"] == pytest.approx(20, abs=4)
    assert all(abs(index) < 2 for index in symmetry(found).values())
    assert found["r"]["stride length"].sigma > 0


def test_a_longer_step_is_not_symmetric(body: Body) -> None:
    """A limp: the left step takes 20 % longer than the right one."""
    phases = np.concatenate([np.linspace(n, n + 0.5, 30, False) if right else np.linspace(n + 0.5, n + 1, 36, False)
                             for n in range(6) for right in (True, False)])  # fmt: skip
    fine = walk(body, fps=3000.0, frames=int(6 * PERIOD * 3000) + 2, speed=SPEED)
    limping = [fine[round(phase * PERIOD * 3000)] for phase in phases]
    times = np.arange(len(limping)) / FPS
    index = symmetry(parameters(gait_of(body, times, limping)))
    assert index["step time"] == pytest.approx(100 * (36 - 30) / 33, abs=6)  # right steps end at right strikes
    assert abs(index["stride time"]) < 1


def test_cycles_are_the_walks_own(body: Body, poses: list[Pose]) -> None:
    """Within 1° of one stride of the same walk, sampled finely from heel strike to heel strike."""
    gait = gait_of(body, TIMES, poses)
    table = coordinates_of(body, facing(gait, poses))
    curves = cycles(gait, TIMES, butterworth(table.in_degrees[0], FPS, 6.0), "r")
    start = float(off(gait.strikes["r"], -PHASE * PERIOD, PERIOD).mean()) / PERIOD  # in cycles; under 2 frames
    truth = walk(body, fps=100.0 / PERIOD, frames=101, speed=SPEED, phase=start)
    wanted = coordinates_of(body, truth).in_degrees[0]
    turning = [k for k, name in enumerate(table.names) if table.turning[k]]
    assert curves.shape == (len(gait.of("r")), len(PERCENT), len(table.names))
    assert np.abs(curves.mean(axis=0) - wanted)[:, turning].max() < 1.0
    assert np.ptp(wanted[:, table.names.index("knee_angle_r")]) > 50


@pytest.mark.parametrize("heading", [0.8, 3.0])
def test_a_pelvis_that_is_turned_makes_no_step_wider(body: Body, heading: float) -> None:
    """4° of 0.7 m are 5 cm: too wide on one side, too narrow on the other. The turn is the pelvis's own."""
    straight = walk(body, fps=FPS, frames=400, speed=SPEED, heading=heading, phase=PHASE)
    turn = se3.exp_rotation(np.array([0.0, 0.0, np.deg2rad(4.0)]))
    turned = [Pose(se3.transform(turn @ p.root[:3, :3], p.root[:3, 3]), p.q) for p in straight]
    gait, wanted = gait_of(body, TIMES, turned), parameters(gait_of(body, TIMES, straight))
    found = parameters(gait)
    for side in ("r", "l"):
        for name in ("step width", "step length", "stride length"):
            assert found[side][name].mean == pytest.approx(wanted[side][name].mean, abs=0.02)
    table = coordinates_of(body, facing(gait, turned))
    assert table.in_degrees[0][:, table.names.index("pelvis_rotation")].mean() == pytest.approx(4.0, abs=0.7)


def test_a_step_width_is_known_as_well_as_heels_are_across(body: Body, poses: list[Pose]) -> None:
    """Half of both heels of a side, and the other one: √1.5 of one heel's, whichever way the walk goes."""
    place = np.zeros((body.dof, body.dof))
    place[3:6, 3:6] = np.diag([0.02**2, 0.01**2, 0.0])
    gait = gait_of(body, TIMES, poses, np.tile(place, (400, 1, 1)))
    across = np.array([-np.sin(0.8), np.cos(0.8)])
    sigma = np.sqrt(1.5 * np.sum((across * [0.02, 0.01]) ** 2))
    known = [stride.step_width_sigma for stride in gait.strides if np.isfinite(stride.opposite_strike)]
    assert known == pytest.approx([sigma] * len(known), rel=0.01)


def test_strides_with_lost_frames_are_left_out(body: Body, poses: list[Pose]) -> None:
    whole = gait_of(body, TIMES, poses)
    known = np.ones(400, bool)
    known[200] = False
    less = gait_of(body, TIMES, poses, known=known)
    crossing = [s for s in whole.strides if s.start <= TIMES[200] <= s.end]
    assert len(crossing) == 2 and not [s for s in less.strides if s.start <= TIMES[200] <= s.end]
    assert 1 <= len(whole.strides) - len(less.strides) <= 4


@pytest.mark.parametrize("plate, side", [("ground_force_vy", "r"), ("1_ground_force_vy", "l")])
def test_events_of_a_real_walk_on_force_plates(shared_data: Path, body: Body, plate: str, side: str) -> None:
    folder = shared_data / "opensim_gait" / "Pipelines" / "Gait2354_Simbody"
    table = read_mot(folder / "subject01_walk1_ik.mot")
    gait = gait_of(body, table.times, poses_from_mot(table, body)[0])
    forces = read_mot(folder / "subject01_walk1_grf.mot")
    changes = np.diff((forces.get(plate) > 20.0).astype(int))
    for found, change in ((gait.strikes[side], 1), (gait.toe_offs[side], -1)):
        truth = forces.times[1:][changes == change]
        truth = truth[(truth > table.times[0]) & (truth < table.times[-1])]
        assert len(found) == len(truth) == 1
        assert abs(found[0] - truth[0]) < 0.010  # s; docs/how-to/gait.md says 9 ms or less


def between(times: Float, values: Float, start: float, end: float) -> Float:
    """Values (N, C) at 0, 1 … 100 % of a cycle, between frames on a straight line."""
    at = start + (end - start) * np.asarray(PERCENT) / 100
    return np.column_stack([np.interp(at, times, column) for column in values.T])


def test_the_cycle_of_a_real_walk_is_that_between_force_plates(shared_data: Path, body: Body) -> None:
    """The right stride that has two strikes on a plate. They are 5 ms off: at 370° per second that is 1.7° of knee."""
    folder = shared_data / "opensim_gait" / "Pipelines" / "Gait10dof18musc"
    table = read_mot(folder / "OutputReference" / "IK" / "subject01_walk_IK.mot")
    poses = poses_from_mot(table, body)[0]
    forces = read_mot(folder / "ExperimentalData" / "subject01_walk_grf.mot")
    strikes = forces.times[1:][np.diff((forces.get("ground_force_vy") > 20.0).astype(int)) == 1]
    gait = gait_of(body, table.times, poses)
    assert len(gait.strikes["r"]) == len(strikes) == 2
    assert np.abs(gait.strikes["r"] - strikes).max() < 0.005  # s, 0.3 frames
    angles = coordinates_of(body, facing(gait, poses))
    ours = cycles(gait, table.times, butterworth(angles.in_degrees[0], FPS, 6.0), "r").mean(axis=0)
    gaps = ours - between(table.times, angles.in_degrees[0], *strikes)
    kept = [name for name in table.columns if name in angles.names and not name.startswith("pelvis_t")]
    own = [angles.names.index(name) for name in kept]
    assert len(own) == 7 and np.sqrt((gaps[:, own] ** 2).mean(axis=0)).max() < 0.7  # °
    assert np.abs(gaps[:, own]).max() < 1.8  # ° at the worst point, of the knee; hips 0.8, ankles 1.3


def test_the_normal_cycle_of_opensim_comes_back(shared_data: Path, body: Body) -> None:
    """One cycle of a healthy walk, from strike to strike in 1 s, six times in a row."""
    path = shared_data / "opensim_gait" / "Tutorials" / "Intro_to_Musculoskeletal_Modeling" / "normal.mot"
    one = read_mot(path)
    times = np.concatenate([one.times[:-1] + k for k in range(6)])
    poses = poses_from_mot(MotionTable(one.columns, times, np.tile(one.values[:-1], (6, 1))), body)[0]
    gait = gait_of(body, times, poses)
    start = off(gait.strikes["r"], 0.0, 1.0)
    assert len(start) == 5 and np.abs(start).max() < 0.008  # s, 0.4 frames
    walked, given = (coordinates_of(body, some) for some in (facing(gait, poses), poses))
    ours = cycles(gait, times, walked.in_degrees[0], "r").mean(axis=0)
    wanted = between(times, given.in_degrees[0], 2 + float(start.mean()), 3 + float(start.mean()))
    assert np.abs(ours - wanted)[:, list(np.flatnonzero(walked.turning))].max() < 1.0


@pytest.mark.parametrize("rate, cutoff", [(100, 6.0), (60, 12.0), (30, 6.0), (30, 11.5), (25, 10.0)])
def test_the_cutoff_of_butterworth_is_at_3_db(rate: float, cutoff: float) -> None:
    wave = np.sin(2 * np.pi * cutoff * np.arange(2000) / rate)
    gain = np.std(butterworth(wave, rate, cutoff)[300:-300]) / np.std(wave[300:-300])
    assert gain == pytest.approx(np.sqrt(0.5), rel=0.005)


def test_a_gap_in_a_walk_along_minus_x_makes_no_whole_turn(body: Body) -> None:
    count, spread = 600, np.tile(np.eye(body.dof) * 1e-6, (600, 1, 1))
    poses = walk(body, fps=FPS, frames=count, speed=SPEED, heading=3.0, phase=PHASE)
    for first in range(240, 260, 5):
        known = np.ones(count, bool)
        known[first : first + 40] = False
        times = np.arange(count) / FPS
        found = gait_of(body, times, poses, known=known)
        motion = Motion(body, times, facing(found, poses), spread, known)
        table = filtered(motion, Filter(cutoff=6.0))
        rotation = table.values[:, table.table.names.index("pelvis_rotation")]
        assert np.nanmax(np.abs(rotation)) < 30


def test_the_rate_is_that_of_the_clock_though_it_counts_milliseconds() -> None:
    rate, ticks, off = even_clock(np.round(np.delete(np.arange(200), 77) / 60, 3))
    assert rate == pytest.approx(60.0, abs=0.01) and off < 0.1
    np.testing.assert_array_equal(ticks, np.delete(np.arange(200), 77))


def test_butterworth_has_no_lag() -> None:
    times = np.arange(2000) / 100
    low, high = (np.sin(2 * np.pi * hertz * times) for hertz in (1.0, 20.0))
    inner = slice(300, -300)
    np.testing.assert_allclose(butterworth(low, 100, 6.0)[inner], low[inner], atol=2e-3)
    assert np.abs(butterworth(high, 100, 6.0)[inner]).max() < 0.02
    with pytest.raises(InputError, match="above 0 and below 5 Hz"):
        butterworth(low, 10, 6.0)


def test_nothing_is_filtered_across_a_gap() -> None:
    known = np.ones(60, bool)
    known[[20, 27]] = False
    step = np.where(np.arange(60) < 20, 0.0, 5.0)
    out = butterworth(step, 60, 6.0, known)
    np.testing.assert_allclose(out[:20], 0.0, atol=1e-9)
    np.testing.assert_allclose(out[28:], 5.0, atol=1e-9)
    assert np.isnan(out[20:28]).all()  # the gaps, and a run too short
    assert runs(known) == [(0, 20), (21, 27), (28, 60)]


def test_what_has_no_gait_is_told(body: Body, poses: list[Pose]) -> None:
    with pytest.raises(InputError, match="12 frames"):
        gait_of(body, TIMES[:5], poses[:5])
    with pytest.raises(InputError, match="evenly"):
        gait_of(body, TIMES + 0.5 * (TIMES > 2), poses)
    still = gait_of(body, TIMES[:60], [poses[0]] * 60)
    assert still.strides == () and np.isnan(parameters(still)["both"]["speed"].mean)


@pytest.mark.usefixtures("drawn")
def test_command(body: Body, poses: list[Pose], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n, pose in enumerate(poses[:200]):
            writer.append(Estimate(n, n / FPS, pose, np.eye(body.dof) * 1e-6))
    found = document(capsys, "gait", tmp_path / "r.h5", "--out", tmp_path / "out")
    assert found["parameters"]["both"]["speed"]["mean"] == pytest.approx(SPEED, rel=0.02)
    assert [Path(file).name for file in found["files"]] == FILES
    with (tmp_path / "out" / "cycles.csv").open() as file:
        rows = list(csv.DictReader(file))
    tilt = [float(row["mean_deg"]) for row in rows if row["coordinate"] == "pelvis_tilt" and row["side"] == "r"]
    assert len(tilt) == 101 and -14 < min(tilt) < max(tilt) < -8  # forward tilt of the walk, at any heading
    with (tmp_path / "out" / "gait.csv").open() as file:
        uneven = {row["parameter"]: float(row["mean"]) for row in csv.DictReader(file) if row["side"] == "symmetry"}
    assert uneven == pytest.approx(found["symmetry_percent"], abs=1e-5) and len(uneven) == 9
    assert run("gait", tmp_path / "r.h5", "--out", tmp_path / "out", "--angles", "isb") == 0
    assert "isb_knee_flexion_r" in (tmp_path / "out" / "cycles.csv").read_text()
    out = capsys.readouterr().out
    assert "Fixed by the body's joints, not measured: isb knee" in out
    for kind in ("butterworth", "smoother"):
        found = document(
            capsys, "gait", tmp_path / "r.h5", "--out", tmp_path / "out", "--angles", "isb", "--filter", kind
        )
        assert found["reliable"]["isb_knee_adduction_r"] == "fixed" and found["reliable"]["isb_knee_flexion_r"] == "yes"
        assert found["cutoff_hz"]["isb_knee_flexion_r"] > 1.0 and not found["cutoff_hz"]["isb_knee_adduction_r"]
    assert all(len(line) <= 80 for line in out.splitlines() if "│" in line)
    assert "angles is" in refusal(capsys, "gait", tmp_path / "r.h5", "--angles", "euler")


def test_no_stride_is_said_without_a_table(
    body: Body, poses: list[Pose], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n in range(20):
            writer.append(Estimate(n, n / FPS, poses[0], np.eye(body.dof) * 1e-6))
    assert run("gait", tmp_path / "r.h5") == 0
    out = capsys.readouterr().out
    assert "No stride was found in 20 frames (" in out and "film two steps of each foot" in out and "nan" not in out
    assert "lost or unseen" not in out and not (tmp_path / "cycles.png").exists()
    heads = [(tmp_path / name).read_text().splitlines() for name in ("strides.csv", "cycles.csv")]
    assert [len(lines) for lines in heads] == [1, 1] and heads[0][0].startswith("side,start,end,toe_off")


@pytest.mark.usefixtures("drawn")
def test_one_stride_has_no_deviation(
    body: Body, poses: list[Pose], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is not known is an empty cell: not 0, and no word that other programs cannot read."""
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n, pose in enumerate(poses[:100]):
            writer.append(Estimate(n, n / FPS, pose, np.eye(body.dof) * 1e-6))
    assert run("gait", tmp_path / "r.h5") == 0
    out = capsys.readouterr().out
    assert "nan" not in out and "lumbar bending (" in out and "knee angle left (" in out  # the trunk is of no side
    tables = {name: (tmp_path / name).read_text() for name in FILES if name.endswith(".csv")}
    assert not any("nan" in table for table in tables.values())
    cells = list(csv.DictReader(tables["cycles.csv"].splitlines()))
    assert {row["strides"] for row in cells} == {"1"} and {row["sd_deg"] for row in cells} == {""}
    assert all(float(row["mean_deg"]) is not None for row in cells)


def test_strides_that_are_left_out_because_of_lost_frames_are_said(
    body: Body, poses: list[Pose], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n, pose in enumerate(poses[:200]):
            writer.append(Estimate(n, n / FPS, pose, np.eye(body.dof) * 1e-6, lost=n % 30 < 2))
    assert run("gait", tmp_path / "r.h5") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "No stride was found in 200 frames (" in out and "14 of them are lost or unseen: 0–1, 30–31, 60–61" in out
    assert f"the longest part without them has {27 / FPS:.1f} s" in out and "film two steps" not in out


def test_cycles_say_which_angles_are_reliable(
    body: Body, poses: list[Pose], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the σ that the covariance claims, which does not fall with the number of strides."""
    sigma = np.full(body.dof, np.radians(1.0))
    for name, degrees in (("hip_rotation_r", 8.0), ("knee_angle_l", 3.0)):
        sigma[6 + body.coordinate(name)] = np.radians(degrees)
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n, pose in enumerate(poses[:200]):
            writer.append(Estimate(n, n / FPS, pose, np.diag(sigma**2)))
    found = document(capsys, "gait", tmp_path / "r.h5", "--out", tmp_path / "out")
    odd = {name: grade for name, grade in found["reliable"].items() if grade != "yes"}
    assert odd == {"hip_rotation_r": "no", "knee_angle_l": "care"}
    assert found["sigma_deg"]["hip_rotation_r"] == pytest.approx(8.0)
    with (tmp_path / "out" / "cycles.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["coordinate"] == "hip_rotation_r"]
    assert {(row["side"], row["sigma_deg"], row["reliable"]) for row in rows} == {("r", "8.0000", "no")}
    assert run("gait", tmp_path / "r.h5", "--out", tmp_path / "out") == 0
    assert "Not reliable, σ above 5°: hip rotation right (8.0°)." in capsys.readouterr().out
