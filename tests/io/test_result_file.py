"""The result file: round trip, readable after a kill, resumable, and readable without this package."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import twistcap
from support.cameras import ring
from support.results import estimate, two_links
from twistcap.body import Body, Posed
from twistcap.errors import InputError
from twistcap.io.lock import WriteLock
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.result_schema import COLUMNS


def write(path: Path, count: int = 5) -> Path:
    with ResultWriter(path, two_links(), ring(), {"tracker": {"method": "direct"}}) as writer:
        for k in range(count):
            writer.append(estimate(k))
    return path


def same_body(a: Body, b: Body) -> None:
    for field in fields(Body):
        if field.name == "landmarks":
            assert a.landmarks.names == b.landmarks.names
            np.testing.assert_array_equal(a.landmarks.points, b.landmarks.points)
        else:
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))


def test_round_trip(tmp_path: Path) -> None:
    result = read_result(write(tmp_path / "r.h5"))
    same_body(result.body, two_links())
    for read, made in zip(result.rig, ring(), strict=True):
        assert (read.name, read.size) == (made.name, made.size)
        np.testing.assert_array_equal(read.P, made.P)
        np.testing.assert_array_equal(read.dist, made.dist)
    assert result.config == {"tracker": {"method": "direct"}} and result.versions["twistcap"] == twistcap.__version__
    assert len(result) == 5 and list(result.lost) == [False, False, False, True, False]
    for read, made in zip(result.estimates, map(estimate, range(5)), strict=True):
        np.testing.assert_array_equal(read.pose.root, made.pose.root)
        np.testing.assert_array_equal(read.pose.q, made.pose.q)
        np.testing.assert_array_equal(read.covariance, made.covariance)
        assert read.energies == made.energies
        assert (read.index, read.time, read.status) == (made.index, made.time, made.status)
        assert (read.iterations, read.lost, read.support) == (made.iterations, made.lost, made.support)
        assert (read.probability, read.left_out, read.missing) == (made.probability, made.left_out, made.missing)
        np.testing.assert_array_equal(np.array(read.part_probability), np.array(made.part_probability))


KILLED = """
import sys, time
sys.path.insert(0, {tests!r})
from support.cameras import ring
from support.results import estimate, two_links
from twistcap.io.result import ResultWriter
writer = ResultWriter({path!r}, two_links(), ring(), {{}})
for k in range(10**6):
    writer.append(estimate(k))
    if k == 30: print("go", flush=True)
"""


def test_survives_kill_and_resumes(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    code = KILLED.format(tests=str(Path(__file__).parents[1]), path=str(path))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None and child.stdout.readline() == "go\n"
        child.send_signal(signal.SIGKILL)
    result = read_result(path)
    assert len(result) > 30  # calls
    np.testing.assert_array_equal(result.q[:31], [estimate(k).pose.q for k in range(31)])
    with ResultWriter.resume(path) as writer:
        start = len(writer)
        assert start == len(result)
        writer.append(estimate(start))
    after = read_result(path)
    assert list(after.indices) == list(range(start + 1))
    np.testing.assert_array_equal(after.roots[-1], estimate(start).pose.root)


def test_a_frame_without_its_index_is_left_out(tmp_path: Path) -> None:
    """The index is written last: what has none is neither read nor kept."""
    path = write(tmp_path / "r.h5")
    with h5py.File(path, "r+") as file:
        file["frames/index"][3:] = -1
    assert len(read_result(path)) == 3
    with ResultWriter.resume(path) as writer:
        writer.append(estimate(7))
    assert list(read_result(path).indices) == [0, 1, 2, 7]


FAULTS = """
import os, signal, sys
sys.path.insert(0, {tests!r})
import h5py
import numpy as np
from support.cameras import ring
from support.results import estimate, two_links
from twistcap.doors.hdf5 import trust
from twistcap.errors import InputError
from twistcap.io.result import ResultWriter
from twistcap.io.result import _result_and_state as both

path, kind = {path!r}, {kind!r}
os.fsync = lambda descriptor: None  # it takes its time, and a kill does not ask for it

def write(reported, resume):  # frames 0 to 5, a state before each third one
    if resume:
        trust(path)  # its bytes are what is asked for here, and reading them in a child takes a new interpreter
    with ResultWriter.resume(path) if resume else ResultWriter(path, two_links(), ring(), {{}}, room=4) as writer:
        for k in range(len(writer), 6):
            if k % 3 == 0:
                writer.save_state(np.full(40 * (k + 1), k, np.uint8))
            writer.append(estimate(k))
            reported.append(k)

def faulty(nth, calls=[0]):
    def wrap(call):
        def called(*arguments, **named):
            calls[0] += 1
            if calls[0] < nth:
                return call(*arguments, **named)
            if call is pwrite:  # half of it
                call(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2], arguments[2])
            if kind == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            raise OSError(28, "No space left on device")
        return called
    pwrite = os.pwrite
    for name in ("pwrite", "fsync", "open", "rename", "replace", "unlink", "ftruncate"):
        if kind == "kill" or name in ("pwrite", "fsync"):
            setattr(os, name, wrap(getattr(os, name)))

def child(nth, resume, out):
    faulty(nth)
    reported = []
    try:
        write(reported, resume)
        answer = "whole"
    except InputError as error:
        answer = "refused" if "No space left on device; make room" in str(error) else "wrong"
    finally:
        pass
    os.write(out, (answer + " " + str(len(reported))).encode())
    os._exit(0)

def checked(least):
    if not os.path.exists(path):
        assert least == 0
        return 0
    with h5py.File(path) as file:
        index = file["frames/index"][:]
        count = int((index >= 0).sum())
        assert count >= least and list(index[:count]) == list(range(count)), (index, least)
        for k in range(count):
            assert file["frames/covariance"][k].tobytes() == estimate(k).covariance.tobytes()
            assert file["frames/energies/contour"][k] == estimate(k).energies["contour"]
    trust(path)
    result, state = both(path)
    assert len(result) == count and (count == 0 or state is not None)
    assert state is None or (state[1] == state[0]).all() and len(state[1]) == 40 * (state[0] + 1) and state[0] % 3 == 0
    return count

with ResultWriter(path, two_links(), ring(), {{}}) as writer:
    writer.save_state(np.full(40, 0, np.uint8))
    writer.append(estimate(0)), writer.append(estimate(1))
with open(path, "rb") as file:
    begun = file.read()
for resume in (False, True):
    nth, answer = 0, ""
    while answer != "whole":
        nth += 1 if nth < 10 else 9
        for name in os.listdir(os.path.dirname(path)):
            os.unlink(os.path.join(os.path.dirname(path), name))
        least = 0
        if resume:
            with open(path, "wb") as file:
                file.write(begun)
            least = 2
        reading, out = os.pipe()
        if (pid := os.fork()) == 0:
            child(nth, resume, out)
        os.close(out)
        status = os.waitpid(pid, 0)[1]
        answer, _, reported = os.read(reading, 99).decode().partition(" ")
        os.close(reading)
        assert answer in ("whole", "refused") if kind == "full" else answer in ("", "whole"), answer
        assert status == (9 if answer == "" else 0), status
        count = checked(max(least, least + int(reported or 0) if answer else 0))
        if count:
            write([], True)
            assert checked(6) == 6
            assert sorted(os.listdir(os.path.dirname(path))) == [os.path.basename(path)]
    print(nth)
"""


@pytest.mark.parametrize("kind", ["kill", "full"])
def test_no_fault_at_any_write_loses_a_frame(kind: str, tmp_path: Path) -> None:
    """Killed at, or out of room from, each single call that changes the disk, half of its bytes written."""
    code = FAULTS.format(tests=str(Path(__file__).parents[1]), path=str(tmp_path / "r.h5"), kind=kind)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert min(map(int, done.stdout.split())) > 30  # calls


@pytest.mark.parametrize("size", [300_000, 700_000])
def test_a_file_that_may_not_grow(size: int, tmp_path: Path) -> None:
    """A real limit of the kernel's: one sentence, no signal, all frames readable."""
    code = f"""
import resource, sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from support.cameras import ring
from support.results import estimate, two_links
from twistcap.errors import InputError
from twistcap.io.result import ResultWriter
resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))
try:
    with ResultWriter({str(tmp_path / "r.h5")!r}, two_links(), ring(), {{}}) as writer:
        for k in range(10**6):
            writer.append(estimate(k))
except InputError as error:
    print(len(writer), error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    kept, _, sentence = done.stdout.partition(" ")
    assert "r.h5 cannot be written: File too large; make room" in sentence
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["frames/index"].shape == (int(kept),) and int(kept) >= 64
    assert [path.name for path in tmp_path.iterdir()] == ["r.h5"]


def test_a_second_writer_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    with ResultWriter(path, two_links(), ring(), {}) as writer:
        writer.append(estimate(0))
        with pytest.raises(InputError, match=r"is being written by another process \(\d+\)"):
            ResultWriter(path, two_links(), ring(), {})
        with pytest.raises(InputError, match="is being written"):
            ResultWriter.resume(path)
        writer.append(estimate(1))
    with ResultWriter.resume(path) as writer:
        writer.append(estimate(2))
    assert list(read_result(path).indices) == [0, 1, 2] and [p.name for p in tmp_path.iterdir()] == ["r.h5"]


def test_the_lock_of_the_dead_is_taken(tmp_path: Path) -> None:
    """A killed holder leaves its file, not its lock."""
    code = "import os, sys; from twistcap.io.lock import WriteLock; WriteLock(sys.argv[1]); os._exit(0)"
    subprocess.run([sys.executable, "-c", code, tmp_path / "r.h5"], check=True)
    assert [p.name for p in tmp_path.iterdir()] == [".r.h5.lock"]
    WriteLock(tmp_path / "r.h5").release()
    assert not list(tmp_path.iterdir())


def test_room_that_was_not_used_is_given_back(tmp_path: Path) -> None:
    """A running file has room for what is expected, a closed one has none; what came unforeseen has its place."""
    path = tmp_path / "r.h5"
    with ResultWriter(path, two_links(), ring(), {}, room=10) as writer:
        for k in range(4):
            writer.append(estimate(k))
        with h5py.File(path) as file:  # any program may look
            assert list(file["frames/index"][:]) == [0, 1, 2, 3] + [-1] * 6
            np.testing.assert_array_equal(file["frames/energies/late"][:4], [np.nan, np.nan, np.nan, 2.0])
    with h5py.File(path) as file:
        assert all(file["frames"][name].shape[0] == 4 for name in ("index", "q", "covariance", "energies/late"))


def test_some_of_the_frames(tmp_path: Path) -> None:
    """Every row of every dataset goes with its frame, the flags of parts and cameras too."""
    with ResultWriter(tmp_path / "r.h5", two_links(), ring(), {}) as writer:
        for k in range(6):
            parts = np.full(len(two_links().segment_names), 0.1 * k)
            writer.append(replace(estimate(k), part_probability=parts, left_out=(k % 2,), missing=(k % 3,)))
    whole = read_result(tmp_path / "r.h5")
    few = whole.within(2, 4)
    assert {len(getattr(few, column.of_result)) for column in COLUMNS.values()} == {3}
    for mine, theirs in zip(few.estimates, whole.estimates[2:5], strict=True):
        assert (mine.index, mine.left_out, mine.missing) == (theirs.index, theirs.left_out, theirs.missing)
        np.testing.assert_array_equal(mine.part_probability, theirs.part_probability)


def test_layout_is_as_documented(tmp_path: Path) -> None:
    """The example of docs/formats/result-file.md gives our landmarks when run; every dataset is in its table."""
    path = write(tmp_path / "result.h5")
    page = (Path(__file__).parents[2] / "docs" / "formats" / "result-file.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", page, flags=re.S)
    names: dict[str, object] = {}
    exec(blocks[0].replace('"result.h5"', repr(str(path))), names)
    result = read_result(path)
    np.testing.assert_allclose(names["world"], Posed(result.body, result.poses[0]).landmarks, atol=1e-12)
    np.testing.assert_allclose(names["knee_deg"], np.rad2deg(result.q[:, 0]))
    found: list[str] = []
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
    for name in found:
        stem, leaf = name.rsplit("/", 1)
        assert stem == "frames/energies" or leaf in page, name


def test_what_is_no_result_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_result(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("no")
    with pytest.raises(InputError, match="no HDF5 file"):
        read_result(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w"):
        pass
    with pytest.raises(InputError, match="no twistcap result"):
        ResultWriter.resume(tmp_path / "other.h5")
    with pytest.raises(InputError, match="its folder does not exist"):
        ResultWriter(tmp_path / "no" / "folder" / "r.h5", two_links(), ring(), {})
    path = write(tmp_path / "r.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 99
    with pytest.raises(InputError, match="newer twistcap"):
        read_result(path)
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 5
    with pytest.raises(InputError, match=r"older twistcap \(format 5\); track the recording again"):
        read_result(path)


@pytest.mark.parametrize("name", ["q", "part_probability", "left_out", "missing", "bumps", "sources", "brightness"])
def test_frames_must_fit_the_body_and_the_cameras(name: str, tmp_path: Path) -> None:
    path = write(tmp_path / "r.h5")
    with h5py.File(path, "r+") as file:
        rows, frames = file[f"frames/{name}"][:], file["frames"]
        del frames[name]
        frames[name] = np.hstack([rows, rows[:, :1]])
        columns = frames[name].shape[1]
        wide = {"covariance": np.zeros((len(rows), 9, 9)), "bumps": np.zeros((len(rows), columns, 3))}
        cameras = ("left_out", "missing", "bumps", "sources", "brightness")
        of_cameras = [other for other in cameras if other != name]
        wide["sources"] = np.tile(np.arange(columns, dtype=np.int16), (len(rows), 1))
        wide["brightness"] = np.zeros((len(rows), columns), np.float32)
        others = (dict.fromkeys(cameras, of_cameras) | {"q": ["covariance"]}).get(name, [])
        for other in others:  # else they would not fit each other
            del frames[other]
            frames[other] = wide.get(other, np.zeros((len(rows), columns), np.bool_))
    with pytest.raises(InputError, match=r"frames: \w+ has . columns, not"):
        read_result(path)
