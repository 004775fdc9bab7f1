"""Frames paired by time, videos whose time stamps make no sense, and clocks written into a session."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from support.videos import picture
from twistcap.errors import InputError
from twistcap.io.clocks import Clock, Timeline
from twistcap.io.session import load_session
from twistcap.io.session_edit import write_clocks
from twistcap.io.sources import VideoSource
from twistcap.io.videowriter import VideoWriter


def number(image: np.ndarray) -> int:
    return sum(int(image[16, 32 * bit + 16].mean() > 128) << bit for bit in range(8))


def test_variable_frame_rate_is_read_from_the_time_stamps(tmp_path: Path) -> None:
    times = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.03, 20))
    with VideoWriter(tmp_path / "a.mp4", 60) as writer:
        for k, time in enumerate(times):
            writer.write(picture(k), float(time))
    found = VideoSource(tmp_path / "a.mp4").times
    assert found is not None
    np.testing.assert_allclose(found, times - times[0], atol=2e-5)


@pytest.mark.parametrize("codec", ["libx264", "mpeg4", "mpeg2video"])
def test_an_avi_with_b_frames_is_read_as_decoded(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "old.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(30))
        stream.width, stream.height, stream.pix_fmt = 384, 280, "yuv420p"
        stream.codec_context.max_b_frames = 3
        for k in range(30):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(k), format="rgb24")))
        container.mux(stream.encode(None))
    source = VideoSource(path)
    assert "time stamps make no sense" in source.note and source.times is None
    assert [number(image) for image in source.read(range(4, 30, 5))] == list(range(4, 30, 5))


def test_cameras_in_step_are_paired_by_number_and_others_by_time() -> None:
    even = np.arange(60) / 60
    assert Timeline((even, even + 1e-4)).in_step
    apart = Timeline((even, np.arange(60) / 59.94 - 0.2541))
    assert not apart.in_step and apart.reference == 0
    assert apart.together == range(0, 44)
    between = apart.images(1, [10])[0]
    assert between is not None
    shown = (1 - between.fraction) * apart.times[1][between.first] + between.fraction * apart.times[1][between.second]
    assert shown == pytest.approx(even[10], abs=1e-9)


def test_a_gap_shows_nothing_and_no_common_time_is_said() -> None:
    even = np.arange(60) / 60
    gap = np.delete(even, [20, 21, 22])
    assert Timeline((even, gap + 0.004)).images(1, [21]) == [None]
    with pytest.raises(InputError, match="no time in common"):
        _ = Timeline((even, even + 5.0)).together


def test_clocks_are_written_and_comments_stay(tmp_path: Path) -> None:
    path = tmp_path / "session.toml"
    path.write_text(
        'frames = [0, 9]\n[clocks.b]\noffset = 3.0\n[cameras]  # mine\ncalibration = "C.toml"\n'
        '[videos]\na = "a.mp4"\nb = "b.mp4"\n[first_pose.keypoints]\nfolders = {a = "k"}\n'
    )
    write_clocks(path, {"a": Clock(), "b": Clock(0.25, fps=30.0)}, (2, 9), 1.3)
    session = load_session(path)
    assert (session.clocks["b"].offset, session.clocks["b"].fps, session.frames) == (0.25, 30.0, (2, 9))
    assert session.first_pose.keypoints is not None and session.first_pose.keypoints.offset == 1.3
    assert "# mine" in path.read_text() and "3.0" not in path.read_text()


def test_frames_of_other_tables_and_comments_of_the_next_table_stay(tmp_path: Path) -> None:
    path, base = tmp_path / "session.toml", tmp_path / "base.toml"
    base.write_text('[cameras]\ncalibration = "C.toml"\n[videos]\na = "a.mp4"\nb = "b.mp4"\n')
    path.write_text(
        'base = "base.toml"\n[clocks.a]\noffset = 1.0\n\n# by Anna, see page 12\n'
        '[first_pose.keypoints]\nframes = [3, 4]\nfolders = {a = "k"}\n'
    )
    write_clocks(path, {"a": Clock(0.2)}, (5, 90))
    session = load_session(path)
    assert session.frames == (5, 90) and session.clocks["a"].offset == 0.2
    assert session.first_pose.keypoints is not None and session.first_pose.keypoints.frames == (3, 4)
    assert "# by Anna, see page 12\n[first_pose.keypoints]" in path.read_text()


def test_a_session_that_cannot_be_changed_stays(tmp_path: Path) -> None:
    path = tmp_path / "session.toml"
    text = 'clocks = { a = { offset = 1.0 } }\n[cameras]\ncalibration = "C.toml"\n[videos]\na = "a.mp4"\n'
    path.write_text(text)
    with pytest.raises(InputError, match="cannot be changed"):
        write_clocks(path, {"a": Clock(0.5)})
    assert path.read_text() == text
