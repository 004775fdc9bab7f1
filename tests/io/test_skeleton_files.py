"""BVH, ASF/AMC and DeepMimic's JSON in: against each other, against pybvh, against hand-made files; bad files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pybvh
import pytest
from scipy.spatial.transform import Rotation

from twistcap import se3
from twistcap.errors import InputError
from twistcap.io.asf import read_amc, read_asf
from twistcap.io.bvh import read_bvh
from twistcap.io.deepmimic import read_deepmimic
from twistcap.io.motions import read_skeleton, without_rest_frame
from twistcap.motion import SkeletonMotion, table_for

ASF = """:version 1.10
:units
  mass 1.0
  length 0.5
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name upper
    direction 0 -1 0
    length 2
    axis 10 20 30 ZYX
    dof rx rz
    limits (-90 90)
           (-90 90)
  end
  begin
    id 2
    name lower
    direction 0 -1 0
    length 3
    axis 0 0 0 XYZ
    dof ry
  end
:hierarchy
  begin
    root upper
    upper lower
  end
"""
AMC = """:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 10 20 30
upper 40 50
lower 60
2
root 0 0 0 0 0 0
upper 0 0
lower 0
"""
BVH = """HIERARCHY
ROOT hip
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT knee
  {
    OFFSET 0 -80 0
    CHANNELS 3 Xrotation Yrotation Zrotation
    End Site
    {
      OFFSET 0 -85 10
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.02
1 2 3 10 20 30 40 50 60
0 0 0 0 0 0 0 0 0
"""
SKELETON = {
    "Skeleton": {
        "Joints": [
            {"Name": "root", "Type": "none", "Parent": -1, "AttachX": 0, "AttachY": 0, "AttachZ": 0},
            {"Name": "hip", "Type": "spherical", "Parent": 0, "AttachX": 0, "AttachY": 0, "AttachZ": 0.1},
            {"Name": "knee", "Type": "revolute", "Parent": 1, "AttachX": 0, "AttachY": -0.4, "AttachZ": 0},
            {"Name": "sole", "Type": "fixed", "Parent": 2, "AttachX": 0, "AttachY": -0.4, "AttachZ": 0},
        ]
    }
}


@pytest.fixture
def cmu(shared_data: Path) -> Path:
    return shared_data / "motions" / "cmu"


def put(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def deepmimic_clip(folder: Path, durations: tuple[float, ...] = (0.1, 0.1, 0.0)) -> Path:
    put(folder, "humanoid3d.txt", json.dumps(SKELETON))
    turns = Rotation.from_rotvec(np.arange(len(durations))[:, None] * [0, 0.3, 0]).as_quat(scalar_first=True)
    frames = [[d, n, 1.0, 0, *turns[n], 1, 0, 0, 0, -0.5 * n] for n, d in enumerate(durations)]
    return put(folder, "clip.txt", json.dumps({"Loop": "none", "Frames": frames}))


def test_amc_and_bvh_of_one_clip_agree(cmu: Path) -> None:
    """01_01: the same rotations of all joints, and the same bones; the BVH leaves a few of them out (length 0)."""
    amc, bvh = read_skeleton(cmu / "01_01.amc"), read_skeleton(cmu / "01_01.bvh")
    assert len(bvh) == len(amc) + 1  # a T pose stands first
    bvh = without_rest_frame(bvh)
    assert (len(bvh), bvh.rate, bvh.up) == (len(amc), amc.rate, amc.up)
    table = table_for(amc)
    assert table_for(bvh) == table
    ours, theirs = table.found(amc), table.found(bvh)
    a = [ours[s] for s in table.segments]
    b = [theirs[s] for s in table.segments]
    turn = se3.log_rotation(np.swapaxes(amc.rotations[::7, a], 2, 3) @ bvh.rotations[::7, b])
    assert np.degrees(np.linalg.norm(turn, axis=-1)).max() < 1e-3
    legs = [n for n, s in enumerate(table.segments) if s.split("_")[0] in ("pelvis", "femur", "tibia", "foot")]
    there = amc.positions[:, [a[n] for n in legs]], bvh.positions[:, [b[n] for n in legs]]
    assert len(legs) == 7
    np.testing.assert_allclose(*there, atol=2e-5)  # m; the BVH is written with five digits
    for segment, below in (("humerus_r", "ulna_r"), ("ulna_l", "radius_l")):
        bones = [m.positions[:, f[below]] - m.positions[:, f[segment]] for m, f in ((amc, ours), (bvh, theirs))]
        np.testing.assert_allclose(*bones, atol=2e-5)


def test_amc_by_hand(tmp_path: Path) -> None:
    """Rotations of the format's definition: C M C⁻¹, with C in the order that the axis names, M in that of the dof."""
    put(tmp_path, "a.asf", ASF)
    motion = read_amc(put(tmp_path, "a.amc", AMC), rate=60)
    assert motion.joints == ("root", "upper", "lower", "lower_end")
    assert (motion.rate, motion.up) == (60, "y")
    unit = 0.0254 / 0.5
    root = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)  # about fixed axes x, then y, then z
    C = Rotation.from_euler("zyx", [10, 20, 30], degrees=True)
    upper = root * C * Rotation.from_euler("xz", [40, 50], degrees=True) * C.inv()
    lower = upper * Rotation.from_euler("y", 60, degrees=True)
    np.testing.assert_allclose(motion.rotations[0, 1], upper.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(motion.rotations[0, 2], lower.as_matrix(), atol=1e-12)
    knee = unit * np.array([1, 2, 3]) + upper.apply([0, -2 * unit, 0])
    np.testing.assert_allclose(motion.positions[0, :2], unit * np.array([[1, 2, 3]] * 2), atol=1e-12)
    np.testing.assert_allclose(motion.positions[0, 2], knee, atol=1e-12)
    np.testing.assert_allclose(motion.positions[0, 3], knee + lower.apply([0, -3 * unit, 0]), atol=1e-12)
    np.testing.assert_allclose(motion.rest_positions()[3], [0, -5 * unit, 0], atol=1e-12)


def test_bvh_by_hand_and_against_pybvh(tmp_path: Path, cmu: Path) -> None:
    motion = read_bvh(put(tmp_path, "a.bvh", BVH))
    assert motion.joints == ("hip", "knee", "knee_end")
    assert motion.rate == pytest.approx(50)
    root = Rotation.from_euler("ZYX", [10, 20, 30], degrees=True)
    knee = root * Rotation.from_euler("XYZ", [40, 50, 60], degrees=True)
    np.testing.assert_allclose(motion.rotations[0, 1], knee.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(motion.offsets[1], [0, -0.8, 0], atol=1e-12)  # taken as centimetres
    end = np.array([0.01, 0.02, 0.03]) + root.apply([0, -0.8, 0]) + knee.apply([0, -0.85, 0.1])
    np.testing.assert_allclose(motion.positions[0, 2], end, atol=1e-12)
    real = read_bvh(cmu / "131_01.bvh")
    nodes = pybvh.read_bvh_file(cmu / "131_01.bvh").node_positions()
    np.testing.assert_allclose(real.positions[::20], nodes[::20] * 0.0254 / 0.45, atol=1e-9)


@pytest.mark.parametrize(("name", "height"), [("01_01.bvh", 1.45), ("131_01.bvh", 1.37)])
def test_bvh_units_of_cmu(cmu: Path, name: str, height: float) -> None:
    """The unit is inches / 0.45, as the AMC of the same clip says; heights from toe joint to the end of the head."""
    rest = read_bvh(cmu / name).rest_positions()
    assert np.ptp(rest[:, 1]) == pytest.approx(height, abs=0.02)


def test_deepmimic_by_hand(tmp_path: Path) -> None:
    motion = read_deepmimic(deepmimic_clip(tmp_path))
    assert (motion.rate, motion.up, len(motion)) == (pytest.approx(10), "y", 3)
    turn = Rotation.from_euler("y", 0.6)
    knee = turn * Rotation.from_euler("z", -1.0)
    np.testing.assert_allclose(motion.rotations[2, 2], knee.as_matrix(), atol=1e-12)
    hip = np.array([2, 1, 0]) + turn.apply([0, 0, 0.1])
    np.testing.assert_allclose(motion.positions[2, 1], hip, atol=1e-12)
    np.testing.assert_allclose(motion.positions[2, 3], hip + turn.apply([0, -0.4, 0]) + knee.apply([0, -0.4, 0]))


def test_deepmimic_of_unequal_durations(tmp_path: Path) -> None:
    motion = read_deepmimic(deepmimic_clip(tmp_path, (0.1, 0.2, 0.1, 0.0)))
    assert len(motion) == 5
    np.testing.assert_allclose(motion.positions[:, 0, 0], [0, 1, 1.5, 2, 3], atol=1e-9)
    yaw = Rotation.from_matrix(motion.rotations[:, 0]).as_rotvec()[:, 1]
    np.testing.assert_allclose(yaw, [0, 0.3, 0.45, 0.6, 0.9], atol=1e-9)


def test_resampling_of_a_skeleton(tmp_path: Path) -> None:
    motion = read_deepmimic(deepmimic_clip(tmp_path))
    fine = motion.resampled(40)
    assert (len(fine), fine.rate) == (9, 40)
    np.testing.assert_allclose(fine.rotations[::4], motion.rotations, atol=1e-12)
    yaw = Rotation.from_matrix(fine.rotations[:, 0]).as_rotvec()[:, 1]
    np.testing.assert_allclose(yaw, 0.3 * np.arange(9) / 4, atol=1e-12)
    np.testing.assert_allclose(fine.positions[:, 0, 0], np.arange(9) / 4, atol=1e-12)
    with pytest.raises(InputError, match="rate"):
        motion.resampled(0)


def test_a_motion_keeps_its_first_frame_unless_it_is_a_rest_pose(tmp_path: Path) -> None:
    motion = read_deepmimic(deepmimic_clip(tmp_path, (0.1,) * 7 + (0.0,)))
    assert len(without_rest_frame(motion)) == 8
    turned = motion.rotations.copy()
    turned[0] = np.diag([-1.0, -1.0, 1.0])
    jumping = SkeletonMotion(**{**vars(motion), "rotations": turned})
    assert len(without_rest_frame(jumping)) == 7


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("upper 40 50", "upper 40", "line 5: 2 numbers"),
        ("upper 40 50", "upper 40 forty", "line 5: 'forty' is no number"),
        ("upper 40 50", "upper 40 nan", "line 5: 'nan' is not a finite"),
        ("upper 40 50", "tail 40 50", "line 5: the ASF skeleton has no bone 'tail'"),
        ("upper 40 50\n", "", "frame 1 has no line for 'upper'"),
        ("1\nroot", "root", "line 3: a frame must start with its number"),
        (AMC, "", "no frames"),
    ],
)
def test_broken_amc(tmp_path: Path, old: str, new: str, message: str) -> None:
    put(tmp_path, "a.asf", ASF)
    with pytest.raises(InputError, match=message):
        read_amc(put(tmp_path, "a.amc", AMC.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (":bonedata", ":bones", "no section :bonedata"),
        ("length 2", "length two", "line 16: 'two' is no number"),
        ("10 20 30 ZYX", "10 20 30 ZYZ", "order 'zyz'"),
        ("dof rx rz", "dof rx rw", "'rw' is no degree of freedom"),
        ("upper lower\n", "upper tail\n", "no bone is called 'tail'"),
    ],
)
def test_broken_asf(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_asf(put(tmp_path, "a.asf", ASF.replace(old, new, 1)))


def test_which_asf(tmp_path: Path) -> None:
    amc = put(tmp_path, "02_05.amc", AMC)
    with pytest.raises(InputError, match=r"needs its ASF skeleton, beside it there is none"):
        read_amc(amc)
    put(tmp_path, "other.asf", ASF)
    assert len(read_amc(amc)) == 2
    put(tmp_path, "another.asf", ASF)
    with pytest.raises(InputError, match=r"several \(another.asf, other.asf\)"):
        read_amc(amc)
    assert len(read_amc(amc, tmp_path / "other.asf")) == 2
    put(tmp_path, "02.asf", ASF)
    assert len(read_amc(amc)) == 2
    with pytest.raises(InputError, match="no such file"):
        read_amc(tmp_path / "none.amc")


@pytest.mark.parametrize(
    ("old", "new"),
    [("Frames: 2", "Frames: 3"), ("40 50 60", "40 50"), ("40 50 60", "40 50 x"), ("ROOT hip", "ROOF hip"), (BVH, "")],
)
def test_broken_bvh(tmp_path: Path, old: str, new: str) -> None:
    with pytest.raises(InputError, match=r"a\.bvh: not a BVH that can be read"):
        read_bvh(put(tmp_path, "a.bvh", BVH.replace(old, new, 1)))


def test_bvh_that_is_not_finite_or_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finite in frame 0"):
        read_bvh(put(tmp_path, "a.bvh", BVH.replace("40 50 60", "40 50 nan")))
    with pytest.raises(InputError, match="cannot be read"):
        read_bvh(tmp_path / "none.bvh")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.1, 1,", "[0.1,", "frame 1 must hold 13 numbers"),
        ("[0.1, 1,", "[0.1, NaN,", "'Frames.1.1' is nan"),
        ("[0.1, 1,", "[-0.1, 1,", "duration of a frame is not positive"),
        ('"Frames"', '"Pictures"', "no Frames"),
        ("{", "", "not a JSON file"),
    ],
)
def test_broken_deepmimic(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = deepmimic_clip(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_deepmimic(path)


def test_deepmimic_without_its_skeleton(tmp_path: Path) -> None:
    path = deepmimic_clip(tmp_path)
    (tmp_path / "humanoid3d.txt").rename(tmp_path / "other.txt")
    with pytest.raises(InputError, match="skeleton is not there"):
        read_deepmimic(path)
    assert len(read_deepmimic(path, tmp_path / "other.txt")) == 3
    with pytest.raises(InputError, match="the key 'Skeleton' is missing"):
        read_deepmimic(path, path)


def test_unknown_ending(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"unknown ending; give \.bvh"):
        read_skeleton(tmp_path / "a.fbx")
