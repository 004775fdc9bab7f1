"""A study of small trials: one table, whatever fails or dies on the way; and one sentence for every bad study file."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from support.cameras import ring
from support.commands import document, refusal, run
from twistcap.commands import study_engine, study_jobs
from twistcap.commands.study import run_study
from twistcap.commands.study_engine import Processes, WorkerDied
from twistcap.commands.study_jobs import Steps
from twistcap.doors.hdf5 import trust
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.evaluate.gait import gait_of
from twistcap.io.coordinates import coordinates_of
from twistcap.io.recording import body_of
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.session import Session, load_session
from twistcap.io.study import Trial, load_study
from twistcap.studio.motion import gait as walk

QUICK = 'refine = false\n[body]\nfit = false\n[output]\nexports = ["trc"]\nreport = false\n'
FRAMES = 4


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two subjects with two trials each."""
    folder = tmp_path_factory.mktemp("study") / "data"
    for subject in (1, 2):
        for trial, speed in (("slow", 0.8), ("fast", 1.2)):
            small = ["--size", "192x140", "--views", "2", "--frames", FRAMES, "--seed", subject, "--speed", speed]
            assert run("studio", folder / f"p{subject}" / trial, *small) == 0
    return folder


def study_file(folder: Path, data: Path, text: str = QUICK) -> Path:
    path = folder / "study.toml"
    path.write_text(f"trials = '{data}'\n{text}")
    return path


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


class Inline:
    """An engine that does each job at once, in this process: another takes seconds to start."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]:
        future = Future[Any]()
        future.set_result(fn(*args))
        return future


@contextmanager
def in_this_process() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study_engine, "here", lambda _: nullcontext(Inline()))
        yield


@pytest.fixture
def inline() -> Iterator[None]:
    with in_this_process():
        yield


@pytest.fixture(scope="module")
def whole(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An undisturbed study."""
    folder = tmp_path_factory.mktemp("whole")
    with in_this_process():
        assert run("study", study_file(folder, data), "--out", folder / "out", "--workers", 1) == 0
    return folder / "out"


def test_the_table_holds_every_angle_of_every_trial(whole: Path) -> None:
    table, result = rows(whole / "angles.csv"), read_result(whole / "p2" / "slow" / "result.h5")
    expected = coordinates_of(result.body, result.poses, result.covariances)
    own = [row for row in table if (row["subject"], row["trial"]) == ("p2", "slow")]
    assert len(own) == FRAMES * len(expected.names) and len(table) == 4 * len(own)
    values, sigmas = expected.in_degrees
    assert np.allclose([float(row["value"]) for row in own], values.ravel(), atol=1e-6)
    assert np.allclose([float(row["sigma"]) for row in own], sigmas.ravel(), atol=1e-6)
    assert {row["flag"] for row in own} == {"ok"} and own[0]["coordinate"] == "pelvis_tilt" and own[0]["unit"] == "deg"
    trials = rows(whole / "trials.csv")
    assert [(row["subject"], row["trial"], row["status"]) for row in trials] == [
        ("p1", "fast", "done"), ("p1", "slow", "done"), ("p2", "fast", "done"), ("p2", "slow", "done"),
    ]  # fmt: skip
    assert (whole / "p1" / "fast" / "joints.trc").is_file()


def test_parquet_holds_the_same(whole: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, of the extra study")
    table, text = parquet.read_table(whole / "angles.parquet").to_pydict(), rows(whole / "angles.csv")
    assert table["subject"] == [row["subject"] for row in text] and table["frame"] == [int(r["frame"]) for r in text]
    assert table["value"] == [float(row["value"]) for row in text]


def test_a_finished_study_does_nothing_again(data: Path, whole: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(whole, tmp_path / "out"))
    times = {path: path.stat().st_mtime_ns for path in out.rglob("*.h5")}
    found = run_study(load_study(study_file(tmp_path, data)), out)
    assert found["seconds"] == {} and times == {path: path.stat().st_mtime_ns for path in out.rglob("*.h5")}
    assert (out / "angles.csv").read_bytes() == (whole / "angles.csv").read_bytes()


@pytest.mark.usefixtures("inline")
def test_other_outputs_are_written_without_tracking_again(data: Path, whole: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(whole, tmp_path / "out"))
    times = {path: path.stat().st_mtime_ns for path in out.rglob("*.h5")}
    for path in times:
        trust(path)
    other = study_file(tmp_path, data, QUICK.replace('"trc"', '"csv"') + 'angles = "isb"\n')
    found = run_study(load_study(other), out)
    assert set(found["seconds"]) == {"files", "rows"}
    assert times == {path: path.stat().st_mtime_ns for path in out.rglob("*.h5")}
    assert "isb_knee_flexion_r_deg" in (out / "p1" / "slow" / "angles.csv").read_text()
    assert {row["coordinate"] for row in rows(out / "angles.csv")} >= {"isb_knee_flexion_r"}


def of_one_subject(table: Path) -> list[dict[str, str]]:
    return [row for row in rows(table) if row["subject"] == "p1"]


@pytest.fixture
def mine(data: Path, tmp_path: Path) -> Path:
    """The trials of one subject, which a test may spoil."""
    shutil.copytree(data / "p1", tmp_path / "data" / "p1")
    return tmp_path / "data"


@pytest.mark.usefixtures("inline")
def test_a_trial_that_fails_is_listed_and_mended(
    mine: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = mine / "p1" / "slow" / "videos" / "cam01.mp4"
    kept = video.read_bytes()
    video.write_bytes(b"no video")
    study, out = study_file(tmp_path, mine), tmp_path / "out"
    assert run("study", study, "--out", out, "--workers", 1) == 1
    assert "failed: p1/slow: " in capsys.readouterr().err
    listed = {row["trial"]: row for row in rows(out / "trials.csv")}
    assert listed["slow"]["status"] == "failed" and "cam01.mp4" in listed["slow"]["message"]
    undisturbed = of_one_subject(whole / "angles.csv")
    assert len(rows(out / "angles.csv")) * 2 == len(undisturbed)
    video.write_bytes(kept)
    assert run("study", study, "--out", out, "--workers", 1) == 0
    assert rows(out / "angles.csv") == undisturbed


@pytest.mark.usefixtures("inline")
def test_an_interrupt_is_no_failure(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes to the worker, which may be at any trial, and to the study: it lists what is done."""
    made, out = study_file(tmp_path, data), tmp_path / "out"

    def track(session: Session, folder: Path, _: object) -> None:
        try:
            if folder.name == "slow":
                raise KeyboardInterrupt
        except KeyboardInterrupt:
            raise typer.Exit(130) from None
        trial = next(trial for trial in load_study(made).trials if trial.folder(out) == folder)
        walked(folder, trial, 3, 1.0)

    def heard(name: str, *_: object) -> None:
        if name == "p1/slow":
            raise KeyboardInterrupt

    monkeypatch.setattr(study_jobs, "run_session", track)
    monkeypatch.setattr("twistcap.commands.study._tell", heard)
    assert run("study", made, "--out", out) == 130
    assert not list(out.rglob("error.txt"))
    listed = [(row["subject"], row["trial"], row["status"], row["frames"]) for row in rows(out / "trials.csv")]
    assert listed[:2] == [("p1", "fast", "done", "3"), ("p1", "slow", "open", "0")]
    assert [status for _, _, status, _ in listed[2:]] == ["open", "open"]


@pytest.mark.usefixtures("inline")
def test_body_refinement_and_a_table_of_trials(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "trials.csv").write_text(
        f'subject,trial,session,frames\np1,a,{data}/p1/fast/session.toml,\np1,b,{data}/p1/slow/session.toml,"[1, 3]"\n'
    )
    text = "[body]\nframes = 1\n[refine]\nrounds = 1\ncoarse_rounds = 1\n[session]\nscale = 0.9\n"
    text += "[output]\nreport = false\nexports = []\n"
    study = study_file(tmp_path, tmp_path / "trials.csv", text)
    found = document(capsys, "study", study, "--out", tmp_path / "out", "--workers", 1)
    assert found["done"] == 2 and set(found["seconds"]) == {"fit", "track", "refine", "files", "rows"}
    first, second = (read_result(tmp_path / "out" / "p1" / name / "refined" / "refined.h5") for name in "ab")
    doubts = [row["message"] for row in rows(tmp_path / "out" / "trials.csv")]
    assert doubts[0] == "" and "the first pose is of frame 0, and tracking begins at frame 1" in doubts[1]
    assert len(first) == FRAMES and len(second) == 3 and first.config["scale"] == 0.9
    bodies = [read_result(tmp_path / "out" / "p1" / name / "result.h5").body for name in "ab"]
    given = load_session(data / "p1" / "fast" / "session.toml")
    assert np.array_equal(bodies[0].vertices, bodies[1].vertices)
    assert not np.allclose(bodies[0].vertices, body_of(given).vertices, atol=1e-4)
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.h5")}
    study = study_file(tmp_path, tmp_path / "trials.csv", text.replace("[]", '["mot"]\noverlay = true'))
    again = document(capsys, "study", study, "--out", tmp_path / "out", "--workers", 1)
    assert again["done"] == 2 and set(again["seconds"]) == {"files", "rows"}
    assert times == {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.h5")}
    refined = tmp_path / "out" / "p1" / "a" / "refined"
    assert (refined / "angles.mot").is_file() and (refined / "overlay.mp4").is_file()


def walked(folder: Path, trial: Trial, frames: int, speed: float) -> None:
    """The result of a trial as if it had been tracked: a long walk, each pose with a covariance."""
    session = load_session(trial.session)
    body = body_of(session)
    known = np.diag(np.repeat([1e-4, 1e-6, 1e-4], (3, 3, body.dof - 6)))
    with ResultWriter(folder / "result.h5", body, ring(), session.model_dump(mode="json")) as writer:
        for n, pose in enumerate(walk(body, frames=frames, speed=speed)):
            writer.append(Estimate(n, n / 60, pose, known))


@pytest.mark.usefixtures("inline")
def test_a_study_over_cycles(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of each stride, side and angle, whose means are the cycles of `gait`; a trial without a stride fails."""
    study, out = load_study(study_file(tmp_path, data, QUICK + 'over = "cycle"\n')), tmp_path / "out"
    out.mkdir()
    walks = {"p1/fast": (150, 1.4), "p1/slow": (240, 1.0), "p2/fast": (20, 1.0), "p2/slow": (150, 1.2)}

    def track(session: Session, folder: Path, _: object) -> None:
        trial = next(trial for trial in study.trials if trial.folder(out) == folder)
        walked(folder, trial, *walks[trial.name])

    monkeypatch.setattr(study_jobs, "run_session", track)
    found = run_study(study, out)
    assert found["done"] == 3 and list(found["failed"]) == ["p2/fast"]
    assert 'no stride is whole and in sight; film longer, or write over = "frame"' in found["failed"]["p2/fast"]
    table = rows(out / "angles.csv")
    assert {(row["subject"], row["trial"]) for row in table} == {("p1", "fast"), ("p1", "slow"), ("p2", "slow")}
    assert {row["flag"] for row in table} == {"ok"} and {row["unit"] for row in table} == {"deg"}
    assert not {row["coordinate"] for row in table if row["side"] == "r"} & {"knee_angle_l", "hip_flexion_l"}
    for side in "rl":
        check_cycles(out, [row for row in table if (row["subject"], row["trial"]) == ("p1", "slow")], side)


def check_cycles(out: Path, table: list[dict[str, str]], side: str) -> None:
    result = read_result(out / "p1" / "slow" / "result.h5")
    strides = gait_of(result.body, result.times, result.poses, known=result.known).of(side)
    knee = [row for row in table if (row["side"], row["coordinate"]) == (side, f"knee_angle_{side}")]
    assert len(knee) == 101 * len(strides) >= 202
    assert [row["percent"] for row in knee[:101]] == [str(percent) for percent in range(101)]
    assert [int(row["stride"]) for row in knee[::101]] == list(range(len(strides)))
    means = [row for row in rows(out / "p1" / "slow" / "cycles.csv") if row["coordinate"] == f"knee_angle_{side}"]
    curves = np.array([float(row["value"]) for row in knee]).reshape(-1, 101)
    np.testing.assert_allclose(curves.mean(axis=0), [float(row["mean_deg"]) for row in means], atol=1e-3)
    np.testing.assert_allclose([float(row["sigma"]) for row in knee], np.degrees(0.01), atol=1e-3)


def killed_when(holds: Callable[[], bool], pids: Callable[[], list[int]]) -> threading.Thread:
    """A thread that kills one worker as soon as something holds."""

    def kill() -> None:
        end = time.monotonic() + 120
        while not holds() and time.monotonic() < end:
            time.sleep(0.005)
        os.kill(pids()[0], signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    return thread


def test_a_worker_that_is_killed_loses_and_doubles_nothing(mine: Path, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    begun = out / "p1" / "fast" / ".track.json"
    thread = killed_when(begun.exists, lambda: [child.pid for child in active_children() if child.pid])
    found = run_study(load_study(study_file(tmp_path, mine)), out, workers=1)
    thread.join()
    assert found["done"] == 2 and not found["failed"]
    for name in ("trials.csv", "angles.csv"):
        assert rows(out / name) == of_one_subject(whole / name)


def test_a_killed_worker_of_a_cluster_loses_and_doubles_nothing(mine: Path, whole: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs Dask, of the extra study")
    out = tmp_path / "out"
    out.mkdir()
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            pids = list(client.run(os.getpid).values())
        thread = killed_when((out / "p1" / "fast" / ".track.json").exists, pids.copy)
        found = run_study(load_study(study_file(tmp_path, mine)), out, cluster=cluster.scheduler_address)
        thread.join()
    assert found["done"] == 2 and not found["failed"]
    for name in ("trials.csv", "angles.csv"):
        assert rows(out / name) == of_one_subject(whole / name)


def test_a_cluster_is_refused_in_one_sentence(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed", reason="needs Dask, of the extra study")
    study = study_file(tmp_path, data)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as made:
        sentence = refusal(capsys, "study", study, "--out", tmp_path / "out", "--cluster", made.scheduler_address)
        assert "start workers with --nthreads 1" in sentence
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    sentence = refusal(capsys, "study", study, "--out", tmp_path / "out", "--cluster", "tcp://127.0.0.1:1")
    assert "pip install 'twistcap[study]'" in sentence


def test_a_cluster_without_a_worker_is_said_to_wait(capsys: pytest.CaptureFixture[str]) -> None:
    distributed = pytest.importorskip("distributed", reason="needs Dask, of the extra study")
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as made,
        study_engine.on_cluster(made.scheduler_address),
    ):
        pass
    assert "has no worker yet; trials wait for the first one" in capsys.readouterr().err


def test_a_job_that_always_kills_its_worker_is_given_up() -> None:
    engine = Processes(1)
    dead, well = engine.submit(signal.raise_signal, signal.SIGKILL), engine.submit(os.getpid)
    with pytest.raises(WorkerDied, match="died 3 times"):
        dead.result()
    assert well.result() != os.getpid()
    engine.close()


def test_a_step_is_done_once_and_again_only_if_it_is_made_from_something_else(tmp_path: Path) -> None:
    begun: list[bool] = []

    def work(before: bool) -> int:
        begun.append(before)
        if len(begun) == 1:
            raise InputError("stopped on the way")
        (tmp_path / "made").touch()
        return len(begun)

    def step(source: str) -> int:
        return Steps(tmp_path, source).once("track", tmp_path / "made", work)

    with pytest.raises(InputError):
        step("one")
    assert step("one") == 2 and step("one") == 2 and begun == [False, True]
    assert step("other") == 3 and begun[-1] is False
    (tmp_path / "made").unlink()
    assert step("other") == 4


@pytest.mark.parametrize(
    ("text", "table", "sentence"),
    [
        ("refin = true\n", None, "unknown key 'refin' at the top; did you mean 'refine'?"),
        ('[output]\nover = "stride"\n', None, "'output.over' is 'stride'"),
        ("", "subject,trial\na,b\n", "the column 'session' is missing"),
        ("", "subject,trial,session\na,b,c\na,b,d\n", "the trial a/b is there 2 times"),
        ("", "subject,trial,session\n../a,b,c\n", "cannot be the name of a folder"),
        ("", "subject,trial,session\na,body,c\n", "that folder is the body's"),
        ("", "subject,trial,session\na,b\n", "line 2 has not as many cells"),
        ("", "subject,trial,session\na,,c\n", "line 2 has no trial"),
        ("", "subject,trial,session\n", "names no trial"),
    ],
)
def test_a_bad_study_is_refused(
    text: str, table: str | None, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "trials.csv").write_text(table or "subject,trial,session\na,b,c\n")
    study = study_file(tmp_path, tmp_path / "trials.csv", text)
    assert sentence in refusal(capsys, "study", study, "--out", tmp_path / "out")


def test_a_cell_is_a_key_of_the_session(tmp_path: Path) -> None:
    (tmp_path / "trials.csv").write_text('subject,trial,session,scale,data\n01,2,a.toml,0.5,\n01,3,a.toml,,"x y"\n')
    trials = load_study(study_file(tmp_path, tmp_path / "trials.csv")).trials
    assert trials == (
        Trial("01", "2", tmp_path / "a.toml", {"scale": 0.5}),
        Trial("01", "3", tmp_path / "a.toml", {"data": "x y"}),
    )
