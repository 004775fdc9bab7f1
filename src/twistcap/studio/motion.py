"""Built-in motions: a walk from published key values of normal gait.

Key values as read from the text and tables of Perry and Burnfield, "Gait Analysis" (2nd ed. 2010, ch. 3-7) and Winter,
"The Biomechanics and Motor Control of Human Gait" (2nd ed. 1991); trunk and arms after Murray, Sepic and Barnard (1967,
Phys. Ther. 47:272, DOI 10.1093/ptj/47.4.272). They are joined by periodic splines and kept as Fourier series.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.errors import check

_PHASES = 120  # samples of one cycle for the root motion
_HARMONICS = 8
_WALK_RATIO = 0.0064  # m per (step/min): step length over cadence of adults (Sekiya et al. 1997, Gait Posture 5:201)

# Degrees at per cent of the right leg's cycle, from its heel strike; mirrored half a cycle later for the left. The
# published values were nudged by up to 4 degrees, within one deviation, so that a foot without toe joints rolls.
_LIMBS: dict[str, tuple[tuple[float, float], ...]] = {
    "hip_flexion": ((0, 29.5), (6, 28.5), (15, 21.5), (31, 3.5), (42, -7.5), (50, -10.5), (55, -8.5), (62, 1), (74, 23),
                    (85, 33.5), (94, 32)),
    "knee_angle": ((0, 3.5), (6, 11.5), (14, 15), (25, 10.5), (39, 4.5), (47, 9), (52, 15.5), (57, 28), (62, 42),
                   (72, 60.5), (81, 50.5), (90, 18.5), (97, 2.5)),
    "ankle_angle": ((0, -0.5), (7, -5.5), (18, 4.5), (32, 7), (46, 10), (52, 7), (57, 0), (63, -14), (68, -10), (76, 0),
                    (84, 4.5), (95, 1)),
    "hip_adduction": ((0, -2), (8, 1.5), (18, 3), (32, 1.5), (50, -1), (63, -7), (75, -5.5), (88, -3)),
    "hip_rotation": ((0, 0), (12, 3), (35, 1), (60, -3), (85, -1)),
    "subtalar_angle": ((0, 2), (12, -4), (35, -2), (55, 4), (75, 1)),
    "arm_flex": ((0, -18), (25, -4), (50, 15), (75, 0)),
    "elbow_flex": ((0, 14), (25, 20), (50, 36), (75, 24)),
    "arm_add": ((0, -7), (50, -6)),
    "arm_rot": ((0, 5), (50, 10)),
    "pro_sup": ((0, 10), (50, 15)),
}  # fmt: skip
_TRUNK: dict[str, tuple[tuple[float, float], ...]] = {
    "pelvis_tilt": ((0, 10.8), (12, 10), (25, 11.3), (50, 10.8), (62, 10), (75, 11.3)),
    "pelvis_obliquity": ((0, 1), (13, 3.5), (30, 0.8), (50, -1), (63, -3.5), (80, -0.8)),
    "pelvis_rotation": ((0, 5), (25, 0.5), (50, -5), (75, -0.5)),
    "lumbar_extension": ((0, 8), (50, 8)),
    "lumbar_bending": ((0, -0.5), (13, -3), (30, -1), (50, 0.5), (63, 3), (80, 1)),
    "lumbar_rotation": ((0, -8), (25, -0.5), (50, 8), (75, 0.5)),
    "neck_extension": ((0, 2), (50, 2)),
    "neck_rotation": ((0, 3), (25, 0), (50, -3), (75, 0)),
}


def gait(
    body: Body, *, fps: float = 60.0, frames: int = 60, speed: float = 1.3, cadence: float | None = None,
    heading: float = 0.0, start: tuple[float, float] = (0.0, 0.0), phase: float = 0.0,
) -> list[Pose]:  # fmt: skip
    """A natural walk on the floor z = 0, in a straight line; coordinates that the body lacks are left out.

    Args:
        body: with OpenSim's coordinate names, rest pose facing +x, z up.
        fps, frames: poses per second, and how many.
        speed: m/s, met exactly; the stride is widened or narrowed to it.
        cadence: steps per minute; by default that of adults at this speed.
        heading: direction of the walk, rad from +x towards +y.
        start: where mid-hip begins on the floor, m.
        phase: of the first frame, in cycles; 0 is the right heel strike.

    Raises InputError for a rate, speed or cadence that is not positive.
    """
    for name, value in (("fps", fps), ("speed", speed), ("cadence", 1.0 if cadence is None else cadence)):
        check("gait", value > 0, f"{name} is {value}; it must be positive")
    steps = cadence if cadence is not None else float(np.sqrt(speed * 60.0 / _WALK_RATIO))
    cycle = _cycle_of_stride(body, speed * 120.0 / steps)
    phases = phase + np.arange(frames) / fps * steps / 120.0
    angles = {name: fourier(values, phases) for name, values in cycle.angles.items()}
    offset = fourier(cycle.offset, phases)
    offset[:, 0] += (phases - phases[:1]) * cycle.stride
    offset[:, :2] -= offset[:1, :2].copy()
    to_world = se3.transform(se3.exp_rotation(np.array([0.0, 0.0, heading])), np.array([start[0], start[1], 0.0]))
    poses = [_pose(body, angles, n) for n in range(frames)]
    return [Pose(to_world @ se3.transform(p.root[:3, :3], at), p.q) for p, at in zip(poses, offset, strict=True)]


@dataclass(frozen=True)
class _Cycle:
    """One cycle, sampled: angles (_PHASES,) in rad, metres advanced, and mid-hip (_PHASES, 3) less an even advance."""

    angles: dict[str, Float]
    stride: float
    offset: Float


def fourier(samples: Float, at: Float) -> Float:
    """Values (M, ...) at phases (M,) of the truncated Fourier series through one cycle of samples (N, ...)."""
    c = np.fft.rfft(samples, axis=0)[: _HARMONICS + 1] / len(samples)
    c[1:] *= 2.0
    waves = np.exp(2j * np.pi * np.outer(at, np.arange(len(c))))
    return np.real(np.tensordot(waves, c, axes=1))


def curve(keys: tuple[tuple[float, float], ...], at: Float) -> Float:
    """Value at phases (M,), in the keys' unit: a shape-preserving periodic spline through them, as a Fourier series."""
    k = np.array([(p + 100.0 * n, v) for n in (-1, 0, 1) for p, v in keys])
    grid = np.arange(_PHASES) / _PHASES
    return fourier(np.asarray(PchipInterpolator(k[:, 0] / 100.0, k[:, 1])(grid)), at)


def _angles(swing: float) -> dict[str, Float]:
    """Every curve of the cycle (_PHASES,) in rad; sagittal excursions about their mean times `swing`."""
    at = np.arange(_PHASES) / _PHASES
    out = {name: np.deg2rad(curve(keys, at)) for name, keys in _TRUNK.items()}
    for name, keys in _LIMBS.items():
        for side, shift in (("r", 0.0), ("l", 0.5)):
            values = np.deg2rad(curve(keys, at + shift))
            widened = values.mean() + swing * (values - values.mean())
            out[f"{name}_{side}"] = widened if name in ("hip_flexion", "arm_flex") else values
    return out


def _pose(body: Body, angles: dict[str, Float], n: int) -> Pose:
    """The pose of a sample, mid-hip at the origin; the pelvis by rotation, obliquity, tilt in turn (Baker 2001)."""
    turn = se3.exp_rotation(np.array([0, 0, angles["pelvis_rotation"][n]]))
    tip = se3.exp_rotation(np.array([-angles["pelvis_obliquity"][n], 0, 0]))
    pelvis = turn @ tip @ se3.exp_rotation(np.array([0, angles["pelvis_tilt"][n], 0]))
    q = np.array([angles[name][n] if name in angles else 0.0 for name in body.coordinate_names])
    return Pose(se3.transform(pelvis, np.zeros(3)), q)


def _cycle_of_stride(body: Body, stride: float) -> _Cycle:
    """The cycle with this stride length (m), by the secant method on the swing of the hips."""
    a, b = 1.0, 0.9
    first, second = _grounded(body, a), _grounded(body, b)
    for _ in range(4):
        slope = (second.stride - first.stride) / (b - a) if b != a else 0.0
        if abs(second.stride - stride) < 1e-4 or abs(slope) < 1e-3:
            break
        a, first = b, second
        b = float(np.clip(b + (stride - second.stride) / slope, 0.15, 1.6))
        second = _grounded(body, b)
    return replace(second, stride=stride)


def _grounded(body: Body, swing: float) -> _Cycle:
    """Stride length and mid-hip motion that keep the lowest points of the surface still on the floor."""
    angles, z = _angles(swing), body.vertices[:, 2]
    near = np.flatnonzero(z < z.min() + np.ptp(z) / 8).astype(np.int32)  # the feet: the lowest eighth
    bound = body.skin_segments[near], body.skin_weights[near], body.vertices[near]
    feet = np.array([Posed(body, _pose(body, angles, n)).points(*bound) for n in range(_PHASES)])
    low = feet[:, :, 2].min(axis=1)
    load = np.exp(-(feet[:, :, 2] - low[:, None]) / 0.006) * _stance(body, near)  # weights of the ground contact
    ahead = np.roll(feet, -1, axis=0) - feet
    both = load * np.roll(load, -1, axis=0)
    slip = (both[..., None] * ahead[..., :2]).sum(axis=1) / both.sum(axis=1)[:, None]
    moved = -slip.mean(axis=0) * _PHASES
    position = np.zeros((_PHASES, 3))
    position[1:, :2] = -np.cumsum(slip, axis=0)[:-1]
    position[:, :2] -= np.arange(_PHASES)[:, None] / _PHASES * moved
    position[:, :2] -= position[:, :2].mean(axis=0)
    position[:, 2] = -low
    return _Cycle(angles, float(moved[0]), position)


def _stance(body: Body, near: Int) -> Float:
    """(_PHASES, N) weight of each vertex as ground contact: those of a leg in its stance, 0 to 60 % of its cycle."""
    out = np.full((_PHASES, len(near)), 1e-6)
    for side, shift in (("r", 0.0), ("l", 0.5)):
        if f"hip_flexion_{side}" in body.coordinate_names:
            at = 100.0 * ((np.arange(_PHASES) / _PHASES + shift) % 1.0)
            leg = body.chain[body.vertex_part[near], body.coordinate(f"hip_flexion_{side}")]
            out += np.interp(at, [0, 6, 54, 60, 94, 100], [0.5, 1, 1, 0, 0, 0.5])[:, None] * leg
    return out
