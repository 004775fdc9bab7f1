"""The built-in walk: within the limits, on the floor, at the asked speed, and like published norms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twistcap import se3
from twistcap.body import Body, Posed
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.studio.motion import gait

BODY = humanoid()


def one_cycle(body: Body = BODY, samples: int = 100) -> np.ndarray:
    """(samples, J) degrees over one cycle at 1.3 m/s."""
    seconds = 120.0 / np.sqrt(1.3 * 60 / 0.0064)
    return np.degrees([p.q for p in gait(body, fps=samples / seconds, frames=samples)])


@pytest.mark.parametrize("body", [BODY, humanoid("legs"), humanoid(thorax=True, wrists=True, clavicles=True)])
def test_stays_within_limits(body: Body) -> None:
    q = np.array([p.q for p in gait(body, frames=70)])
    assert np.all(q >= body.limits[:, 0]) and np.all(q <= body.limits[:, 1])
    assert np.ptp(q[:, body.coordinate("knee_angle_r")]) > np.deg2rad(50)


def test_key_values_of_normal_gait() -> None:
    q = one_cycle()
    hip, knee, ankle = (q[:, BODY.coordinate(n)] for n in ("hip_flexion_r", "knee_angle_r", "ankle_angle_r"))
    assert hip[0] == pytest.approx(30, abs=3) and hip[50] == pytest.approx(-10, abs=3)
    assert knee[15] == pytest.approx(17, abs=4) and knee[72] == pytest.approx(60, abs=3) and knee[40] < 8
    assert 7 < ankle[46] < 13 and -20 < ankle.min() < -10 and 60 <= ankle.argmin() <= 68
    left = q[:, BODY.coordinate("knee_angle_l")]
    np.testing.assert_allclose(np.roll(left, -50), knee, atol=0.2)
    arm = q[:, BODY.coordinate("arm_flex_r")]
    assert np.corrcoef(arm, hip)[0, 1] < -0.8  # arms swing against their legs


@pytest.mark.parametrize("speed", [0.8, 1.3, 1.7])
def test_walks_on_the_floor_without_sliding(speed: float) -> None:
    fps = 100.0
    poses = gait(BODY, fps=fps, frames=110, speed=speed)
    surfaces = np.array([Posed(BODY, p).vertices for p in poses])
    assert np.abs(surfaces[:, :, 2].min(axis=1)).max() < 0.005
    still = (surfaces[:-1, :, 2] < 0.004) & (surfaces[1:, :, 2] < 0.004)
    slide = np.linalg.norm(np.diff(surfaces[:, :, :2], axis=0), axis=2)[still] * fps
    assert np.median(slide) < 0.12  # m/s
    heights = np.array([p.root[2, 3] for p in poses])
    assert 0.01 < np.ptp(heights) < 0.06
    assert np.abs(np.diff(heights, 2)).max() * fps**2 < 12.0  # m/s²: no jerk


def test_speed_heading_start_and_phase() -> None:
    stride_time = 120.0 / np.sqrt(1.3 * 60 / 0.0064)
    poses = gait(BODY, fps=1.0 / stride_time, frames=3, heading=0.7, start=(2.0, -1.0), phase=0.3)
    along = np.array([np.cos(0.7), np.sin(0.7)])
    np.testing.assert_allclose(poses[0].root[:2, 3], [2.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(poses[2].root[:2, 3] - poses[0].root[:2, 3], 2 * 1.3 * stride_time * along, atol=1e-6)
    np.testing.assert_allclose(poses[0].q, poses[1].q, atol=1e-9)
    straight = gait(BODY, fps=60, frames=1, phase=0.3)[0]
    np.testing.assert_allclose(poses[0].q, straight.q, atol=1e-9)
    turned = se3.exp_rotation([0, 0, 0.7]) @ straight.root[:3, :3]
    np.testing.assert_allclose(poses[0].root[:3, :3], turned, atol=1e-9)


def test_bad_wishes_are_named() -> None:
    for name in ("fps", "speed", "cadence"):
        with pytest.raises(InputError, match=name):
            gait(BODY, **{name: 0.0})


def test_agrees_with_measured_norms(shared_data: Path) -> None:
    file = shared_data / "gait_norms" / "Schwartz2008.json"
    if not file.is_file():
        pytest.skip(f"no gait norms at {file}")
    norms = json.loads(file.read_text())["Schwartz2008"]["Free"]
    q = one_cycle(samples=50)
    for joint, name in (("HipAngles", "hip_flexion_r"), ("KneeAngles", "knee_angle_r")):
        band = np.array(norms[joint]["X"])[:50, 1:].mean(axis=1)
        assert np.corrcoef(band, q[:, BODY.coordinate(name)])[0, 1] > 0.95
