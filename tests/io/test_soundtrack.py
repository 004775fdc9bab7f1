"""The sound of a video: read from the first picture on, and left where it cannot be a recording's."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from support.videos import with_sound, write
from twistcap.io.soundtrack import RATE, read_sound


@pytest.fixture
def heard(tmp_path: Path) -> Path:
    """A tone of 440 Hz and 1.5 s."""
    tone = 0.5 * np.sin(2 * np.pi * 440 * np.arange(72_000) / 48_000)
    return with_sound(write(tmp_path / "a.mp4", 8, (64, 48)), tone, 48_000)


def test_a_tone_is_read(heard: Path) -> None:
    samples = read_sound(heard, 10.0)
    assert samples is not None and abs(len(samples) - 1.5 * RATE) < 0.05 * RATE
    spectrum = np.abs(np.fft.rfft(samples))
    assert abs(np.fft.rfftfreq(len(samples), 1 / RATE)[spectrum.argmax()] - 440.0) < 2.0
    assert 0.4 < np.abs(samples).max() < 0.6


def test_what_has_no_sound_gives_none(heard: Path, tmp_path: Path) -> None:
    assert read_sound(write(tmp_path / "b.mp4", 4, (64, 48)), 10.0) is None
    assert read_sound(tmp_path / "none.mp4", 10.0) is None
    (tmp_path / "c.mp4").write_bytes(heard.read_bytes()[:200])
    assert read_sound(tmp_path / "c.mp4", 10.0) is None


def test_a_sound_that_begins_long_after_the_pictures_is_not_read(heard: Path) -> None:
    """Silence in between would be made up, of any length that a forged file asks for."""
    assert read_sound(later(heard, 2.0), 10.0) is not None
    assert read_sound(later(heard, 20.0), 10.0) is None


def later(path: Path, seconds: float) -> Path:
    """The video with its sound moved."""
    moved = path.with_name("late.mp4")
    with av.open(str(path)) as source, av.open(str(moved), "w") as goal:
        both = source.streams.video[0], source.streams.audio[0]
        streams = {stream.index: goal.add_stream_from_template(stream) for stream in both}
        for packet in source.demux():
            if packet.dts is None or packet.pts is None or packet.time_base is None:
                continue
            if packet.stream.type == "audio":
                shift = round(seconds / packet.time_base)
                packet.pts, packet.dts = packet.pts + shift, packet.dts + shift
            packet.stream = streams[packet.stream.index]
            goal.mux(packet)
    return moved
