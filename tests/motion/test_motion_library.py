"""Motion clips and libraries: what they keep, what they refuse, and the file round trip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twistcap import se3
from twistcap.body import Posed
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.io.motion_library import read_library, write_library
from twistcap.motion import MotionClip, MotionLibrary

NAMES = ("hip_flexion_r", "hip_flexion_l", "lumbar_bending")


def moving(count: int = 41, rate: float = 20.0, name: str = "clip", names: tuple[str, ...] = NAMES) -> MotionClip:
    """A screw motion of the root, and angles in proportion to time."""
    t = np.arange(count)[:, None] / rate
    roots = se3.exp(t * np.array([0.1, 0.2, 0.9, 1.0, 0.0, 0.3]))
    return MotionClip(name, names, rate, roots, t * np.arange(1, len(names) + 1))


def test_resampling_keeps_screws_and_lines() -> None:
    clip = moving()
    fast = clip.resampled(33.0)
    truth = moving(len(fast), 33.0)
    assert fast.rate == 33.0 and len(fast) == 67
    np.testing.assert_allclose(fast.q, truth.q, atol=1e-12)
    np.testing.assert_allclose(fast.roots, truth.roots, atol=1e-9)
    assert clip.resampled(20.0) is clip


def test_a_library_at_another_rate_is_the_same_motion() -> None:
    library = MotionLibrary.of([moving(), moving(21, name="short")], 20.0)
    fast = library.resampled(40.0)
    assert (fast.rate, fast.clip_names, list(fast.lengths)) == (40.0, ("clip", "short"), [81, 41])
    np.testing.assert_allclose(fast.clip(0).q[::2], library.clip(0).q, atol=1e-6)
    np.testing.assert_allclose(fast.clip(1).roots, moving(41, 40.0).roots, atol=1e-9)
    assert library.resampled(20.0) is library
    with pytest.raises(InputError):
        library.resampled(0.0)


def test_a_mirrored_motion_is_the_mirror_image_of_the_body() -> None:
    body, rng = humanoid("full"), np.random.default_rng(0)
    q = rng.uniform(-0.4, 0.4, (4, len(body.coordinate_names)))
    roots = se3.exp(rng.normal(0, 1, (4, 6)))
    clip = MotionClip("any", body.coordinate_names, 60.0, roots, q)
    mirror = clip.mirrored()
    marks = body.landmarks.names
    other = [marks.index(m[:-1] + {"r": "l", "l": "r"}[m[-1]] if m[-2:] in ("_r", "_l") else m) for m in marks]
    for k in range(4):
        seen, image = Posed(body, clip.at(k)).landmarks, Posed(body, mirror.at(k)).landmarks
        np.testing.assert_allclose(image, seen[other] * [1, -1, 1], atol=1e-9)
    np.testing.assert_allclose(mirror.mirrored().q, clip.q)


def test_a_library_has_one_rate_and_keeps_its_seams() -> None:
    library = MotionLibrary.of([moving(41, 20.0, "slow"), moving(121, 60.0, "fast")], 60.0, mirrored=True)
    assert library.clip_names == ("slow", "slow (mirrored)", "fast", "fast (mirrored)")
    assert list(library.lengths) == [121] * 4
    np.testing.assert_allclose(library.clip(0).q, library.clip(2).q, atol=1e-6)
    np.testing.assert_allclose(library.clip(1).q[:, 0], library.clip(0).q[:, 1])
    np.testing.assert_allclose(library.clip(1).q[:, 2], -library.clip(0).q[:, 2])
    half = library.angles(0, np.array([10.5, 500.0]))
    np.testing.assert_allclose(half[0], 10.5 / 60 * np.array([1, 2, 3]), atol=1e-6)
    np.testing.assert_allclose(half[1], library.q[120])  # the end of its own clip, not of the next one
    np.testing.assert_allclose(library.root_motions(0, np.array([500.0]))[0], library.roots[120], atol=1e-12)


def test_round_trip_of_the_file(tmp_path: Path) -> None:
    library = MotionLibrary.of([moving(), moving(31, name="other")], 60.0, NAMES[:2])
    again = read_library(write_library(tmp_path / "motions", library))
    assert (again.names, again.rate, again.clip_names) == (library.names, library.rate, library.clip_names)
    for key in ("q", "roots", "starts"):
        np.testing.assert_array_equal(getattr(again, key), getattr(library, key))


def test_bad_clips_are_refused() -> None:
    clip = moving()
    bad = clip.q.copy()
    bad[7, 1] = np.nan
    with pytest.raises(InputError, match="'clip': a coordinate of pose 7 is not finite; cut or fill it"):
        MotionClip("clip", NAMES, 20.0, clip.roots, bad)
    with pytest.raises(InputError, match="rate is 0"):
        MotionClip("clip", NAMES, 0.0, clip.roots, clip.q)
    with pytest.raises(InputError, match=r"roots must be \(41, 4, 4\)"):
        MotionClip("clip", NAMES, 20.0, clip.roots[:-1], clip.q)
    with pytest.raises(InputError, match="no rigid motion"):
        MotionClip("clip", NAMES, 20.0, 2.0 * clip.roots, clip.q)
    with pytest.raises(InputError, match="has no partner 'arm_l'"):
        moving(names=("arm_r", "lumbar_bending", "neck_extension")).mirrored()
    with pytest.raises(InputError, match="'bone_7' cannot be mirrored"):
        moving(names=("bone_7", "lumbar_bending", "neck_extension")).mirrored()


def test_bad_libraries_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no clips"):
        MotionLibrary.of([], 60.0)
    with pytest.raises(InputError, match="'clip' lacks the coordinate 'knee'"):
        MotionLibrary.of([moving()], 60.0, ["knee"])
    with pytest.raises(InputError, match="no joint coordinate in common"):
        MotionLibrary.of([moving(), moving(names=("a", "b", "c"))], 60.0)
    with pytest.raises(InputError, match="does not exist"):
        read_library(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("words")
    with pytest.raises(InputError, match="another kind of file"):
        read_library(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", x=1)
    with pytest.raises(InputError, match="twistcap motions build"):
        read_library(tmp_path / "other.npz")
    library = MotionLibrary.of([moving()], 60.0)
    starts = np.array([0, 5])
    np.savez(tmp_path / "cut.npz", format="twistcap-motions", names=library.names, rate=60.0, clip_names=["a"],
             starts=starts, q=library.q, roots=library.roots)  # fmt: skip
    with pytest.raises(InputError, match="do not fill its poses"):
        read_library(tmp_path / "cut.npz")
