"""Video in and out: exact frames, dropped frames, rectified and resized views, and errors that name file and mend."""

from __future__ import annotations

import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.cameras import ring
from support.videos import COUNT, corrupted, picture, write
from twistcap.camera import Rectifier, Rig
from twistcap.errors import InputError
from twistcap.io.video import ImageSource, VideoSource, open_source, open_views, preparation
from twistcap.io.videowriter import VideoWriter


def number(image: np.ndarray) -> int:
    return sum(int(image[8:24, 32 * bit + 8 : 32 * bit + 24].mean() > 127) << bit for bit in range(8))


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("video") / "a.mp4")


@pytest.fixture
def rig() -> Rig:
    return Rig(ring().cameras[:2])


def test_video_source_counts_and_seeks_exactly(video: Path) -> None:
    source = VideoSource(video)
    assert (len(source), source.size, source.fps) == (COUNT, (384, 280), 60.0)
    assert [number(i) for i in source.read(range(COUNT))] == list(range(COUNT))
    for k in (0, 1, 17, 39, 5):
        assert number(next(source.read([k]))) == k
    assert [number(i) for i in source.read(range(3, 40, 7))] == list(range(3, 40, 7))


def test_colours_survive(video: Path) -> None:
    error = next(VideoSource(video).read([9]))[40:].astype(float) - picture(9)[40:]
    assert np.abs(error).mean() < 3.0


def test_writer_makes_browser_video(tmp_path: Path) -> None:
    import av

    with VideoWriter(tmp_path / "odd.mp4", fps=29.97) as writer:
        for k in range(3):
            writer.write(picture(k, (301, 203)).astype(np.float32) / 255)
    with av.open(str(tmp_path / "odd.mp4")) as container:
        context = container.streams.video[0].codec_context
        assert (context.name, context.pix_fmt, context.width, context.height) == ("h264", "yuv420p", 300, 202)
    head = (tmp_path / "odd.mp4").read_bytes()
    assert head.index(b"moov") < head.index(b"mdat")  # plays before it is loaded whole


@pytest.mark.parametrize("place", ["", "trial [1]"])
def test_images_in_order_and_dropped(tmp_path: Path, place: str) -> None:
    tmp_path /= place
    tmp_path.mkdir(exist_ok=True)
    for k in (8, 9, 11, 12):
        cv2.imwrite(str(tmp_path / f"im_{k}.png"), picture(k)[..., ::-1])
    numbered = ImageSource(tmp_path / "im_%d.png")
    assert [None if i is None else number(i) for i in numbered.read(range(len(numbered)))] == [8, 9, None, 11, 12]
    for pattern in (tmp_path / "*.png", tmp_path):
        source = open_source(pattern)
        assert [number(i) for i in source.read(range(len(source))) if i is not None] == [8, 9, 11, 12]


def test_views_are_those_of_the_image_rig(video: Path, rig: Rig) -> None:
    views = open_views(dict.fromkeys(rig.names, video), rig, first=4, last=10, step=2, scale=0.5, time_offset=1.0)
    frames = list(views)
    assert [f.index for f in frames] == [4, 6, 8, 10]
    assert [f.time for f in frames] == pytest.approx([1 + i / 60 for i in (4, 6, 8, 10)])
    assert frames[0].images[0].shape == (140, 192, 3) and views.image_rig[0].size == (192, 140)  # type: ignore[union-attr]
    raw = next(VideoSource(video).read([4]))
    np.testing.assert_array_equal(frames[0].images[0], preparation(rig[0], 0.5)(raw))
    full = Rectifier(rig[0])(raw)
    small = cv2.resize(full, (192, 140), interpolation=cv2.INTER_AREA)
    inner = np.abs(preparation(rig[0], 0.5)(raw).astype(float) - small)[30:-10, 10:-10]
    assert inner.mean() < 1.0  # resize then rectify = rectify then resize
    assert [f.index for f in views.starting_at(7)] == [8, 10]


def test_threads_end_with_the_loop(video: Path, rig: Rig) -> None:
    before = threading.active_count()
    for frame in open_views(dict.fromkeys(rig.names, video), rig):
        if frame.index == 2:
            break
    del frame
    import gc

    gc.collect()
    assert threading.active_count() == before


def test_missing_video_and_cameras(tmp_path: Path, video: Path, rig: Rig) -> None:
    with pytest.raises(InputError, match=r"video .*none.mp4 does not exist; check its path in \[videos\]"):
        open_views({"cam0": video, "cam1": tmp_path / "none.mp4"}, rig)
    with pytest.raises(InputError, match="'cam1' is calibrated but has no entry"):
        open_views({"cam0": video}, rig)
    with pytest.raises(InputError, match="'kamera', which has no calibration"):
        open_views({"cam0": video, "cam1": video, "kamera": video}, rig)
    (tmp_path / "text.mp4").write_text("no video at all")
    with pytest.raises(InputError, match="cannot be opened"):
        open_source(tmp_path / "text.mp4")
    with pytest.raises(InputError, match="no image matches"):
        open_source(tmp_path / "im_%04d.png")


def test_lengths_sizes_and_ranges(tmp_path: Path, video: Path, rig: Rig) -> None:
    short = write(tmp_path / "short.mp4", 25)
    with pytest.raises(InputError, match=r"short.mp4 has 25 frames, .*a.mp4 has 40.*frames = \[0, 24\]"):
        open_views({"cam0": video, "cam1": short}, rig)
    assert len(open_views({"cam0": video, "cam1": short}, rig, last=24)) == 25
    with pytest.raises(InputError, match=r"asks for frame 30, but .*short.mp4 has only 25 frames"):
        open_views({"cam0": video, "cam1": short}, rig, last=30)
    with pytest.raises(InputError, match=r"has only 25 frames \(0 to 24\); set frames = \[0, 24\]"):
        open_views({"cam0": video, "cam1": short}, rig, first=500, last=600)
    with pytest.raises(InputError, match=r"frames = \[9, 3\] is no range"):
        open_views({"cam0": video, "cam1": short}, rig, first=9, last=3)
    small = write(tmp_path / "small.mp4", 3, (300, 200))
    with pytest.raises(
        InputError, match=r"small.mp4 is 300×200 pixels, but the calibration of camera 'cam1' is for 384×280"
    ):
        open_views({"cam0": video, "cam1": small}, rig, last=2)


def test_corrupt_video_frame_is_told_after_the_good_ones(tmp_path: Path, video: Path, rig: Rig) -> None:
    bad = corrupted(video, tmp_path / "bad.mp4")
    done: list[int] = []
    with pytest.raises(InputError, match=r"bad.mp4: frame \d+ is corrupt"):
        for frame in open_views({"cam0": video, "cam1": bad}, rig):
            done.append(frame.index)
    assert len(done) > 4 and all(b == a + 1 for a, b in pairwise(done))


def test_corrupt_image_is_told(tmp_path: Path) -> None:
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k:04d}.png"), picture(k))
    (tmp_path / "0002.png").write_bytes(b"no image")
    source = ImageSource(tmp_path / "%04d.png")
    with pytest.raises(InputError, match=r"0002.png is corrupt.*frame 2"):
        list(source.read(range(3)))


def test_real_recording_has_the_calibrated_size(shared_data: Path) -> None:
    source = VideoSource(shared_data / "balance_4view" / "videos" / "cam03.mp4")
    assert (len(source), source.size, source.fps) == (100, (1088, 1920), 60.0)


@pytest.mark.parametrize("room", [0, 20_000, 200_000])
def test_no_room_for_a_video(room: int, tmp_path: Path) -> None:
    """One sentence, an older file kept, no crash of FFmpeg's, wherever the room ends."""
    (tmp_path / "v.mp4").write_text("older")
    code = f"""
import resource
import numpy as np
from twistcap.errors import InputError
from twistcap.io.videowriter import VideoWriter
resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))
noise = np.random.default_rng(0)
for _ in range(3):
    try:
        with VideoWriter({str(tmp_path / "v.mp4")!r}, 30) as writer:
            for _ in range(60):
                writer.write(noise.integers(0, 255, (100, 100, 3), dtype=np.uint8))
    except InputError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("v.mp4 cannot be written: File too large; make room") == 3
    assert [p.name for p in tmp_path.iterdir()] == ["v.mp4"] and (tmp_path / "v.mp4").read_text() == "older"
