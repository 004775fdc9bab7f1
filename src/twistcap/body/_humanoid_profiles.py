"""Numbers of the built-in humanoid: proportions and cross-sections of a sex-neutral adult, own work.

Lengths are fractions of stature: Drillis and Contini (1966) as given by Winter, "Biomechanics and Motor Control of
Human Movement", 4th ed. 2009, fig. 4.1 (DOI 10.1002/9780470549148). Cross-sections are metres at a stature of 1.75 m,
our own, with girths near the mean of women and men in ANSUR II (Gordon et al. 2014, NATICK/TR-15/007), somewhat
slimmer since soldiers are heavy, and a volume that agrees with a body mass of 70 kg at about 1 kg/l.
All in the neutral rest pose: x forward, y left, z up, origin at mid-hip.
"""

from __future__ import annotations

from dataclasses import dataclass

REFERENCE_STATURE = 1.75
H = REFERENCE_STATURE

# Fractions of stature.
RATIOS = {
    "hip_height": 0.530,
    "thigh": 0.245,
    "shank": 0.246,
    "ankle_height": 0.039,
    "foot": 0.152,
    "upper_arm": 0.186,
    "forearm": 0.146,
    "chin_height": 0.870,
    "eye_height": 0.936,
}

FLOOR = -RATIOS["hip_height"] * H
TOP = H + FLOOR
HIP = (0.0, 0.048 * H, 0.0)
KNEE = (0.0, HIP[1], -RATIOS["thigh"] * H)
ANKLE = (0.0, HIP[1], KNEE[2] - RATIOS["shank"] * H)
SHOULDER = (-0.012, 0.101 * H, 0.805 * H + FLOOR)
ELBOW = (-0.012, SHOULDER[1], SHOULDER[2] - RATIOS["upper_arm"] * H)
WRIST = (-0.012, SHOULDER[1], ELBOW[2] - RATIOS["forearm"] * H)
LUMBAR = (-0.025, 0.0, 0.14)
THORAX = (-0.035, 0.0, 0.34)
NECK = (-0.035, 0.0, 0.855 * H + FLOOR)
CLAVICLE = (0.03, 0.025, 0.50)
HEEL_X = -0.056
TOE_X = HEEL_X + RATIOS["foot"] * H


@dataclass(frozen=True)
class Sweep:
    """A limb: superelliptic cross-sections (at, half_1, half_2, offset_1, offset_2) along a straight axis.

    `axis` names where `at` runs: "down" and "up" along ∓z (cross-section in x, y), "left" along y (in x, z), "forward"
    along x (in z, y); `origin` is the point at = 0. `caps` are the heights of the rounded ends, `exponent` squares the
    cross-section, a `sole` cuts it flat. `part` is the limb it belongs to.
    """

    part: str
    axis: str
    origin: tuple[float, float, float]
    stations: tuple[tuple[float, float, float, float, float], ...]
    caps: tuple[float, float]
    exponent: float = 2.0
    sole: bool = False


TRUNK = Sweep("trunk", "up", (0.0, 0.0, 0.0), (
    (-0.060, 0.085, 0.125, -0.015, 0.0),
    (0.000, 0.110, 0.162, -0.010, 0.0),
    (0.060, 0.114, 0.168, -0.006, 0.0),
    (0.120, 0.112, 0.161, 0.000, 0.0),
    (0.190, 0.108, 0.148, 0.004, 0.0),
    (0.260, 0.109, 0.149, 0.003, 0.0),
    (0.340, 0.117, 0.159, 0.000, 0.0),
    (0.410, 0.121, 0.168, -0.003, 0.0),
    (0.460, 0.110, 0.160, -0.010, 0.0),
    (0.505, 0.082, 0.130, -0.022, 0.0),
    (0.540, 0.058, 0.080, -0.030, 0.0),
), (0.040, 0.02), 2.3)  # fmt: skip

PELVIS_ONLY = Sweep("trunk", "up", (0.0, 0.0, 0.0), (*TRUNK.stations[:5],), (0.040, 0.03), 2.3)

CENTRAL = (
    Sweep("trunk", "up", (-0.032, 0.0, 0.52), (
        (0.00, 0.058, 0.066, 0.0, 0.0),
        (0.06, 0.053, 0.055, 0.012, 0.0),
        (0.13, 0.052, 0.053, 0.028, 0.0),
    ), (0.03, 0.03)),
    Sweep("trunk", "up", (0.000, 0.0, TOP - 0.0885), ((0.0, 0.097, 0.0755, 0.0, 0.0),), (0.100, 0.0885)),
    Sweep("trunk", "up", (0.0, 0.0, 0.602), (
        (0.000, 0.040, 0.038, 0.054, 0.0),
        (0.035, 0.054, 0.052, 0.043, 0.0),
        (0.080, 0.062, 0.060, 0.034, 0.0),
        (0.130, 0.070, 0.062, 0.023, 0.0),
    ), (0.012, 0.03), 2.3),
    Sweep("trunk", "up", (0.103, 0.0, 0.690), ((0.0, 0.012, 0.012, 0.0, 0.0),), (0.016, 0.035)),
)  # fmt: skip

UPPER_LEFT = (  # breast, collar, arm and hand
    Sweep("trunk", "up", (0.066, 0.080, 0.405), ((0.0, 0.040, 0.070, 0.0, 0.0),), (0.070, 0.070)),
    Sweep("trunk", "left", (-0.026, 0.02, 0.520), (
        (0.00, 0.050, 0.055, 0.0, 0.0),
        (0.05, 0.051, 0.050, 0.0, -0.008),
        (0.11, 0.052, 0.045, 0.008, -0.028),
    ), (0.03, 0.035)),
    Sweep("arm", "down", SHOULDER, (
        (-0.01, 0.054, 0.044, 0.0, 0.0),
        (0.04, 0.061, 0.053, 0.0, 0.002),
        (0.08, 0.059, 0.055, 0.0, 0.002),
        (0.13, 0.053, 0.050, 0.002, 0.0),
        (0.20, 0.050, 0.044, 0.004, 0.0),
        (0.28, 0.045, 0.041, 0.0, 0.0),
        (0.3255, 0.045, 0.041, 0.0, 0.0),
        (0.375, 0.047, 0.043, 0.0, 0.0),
        (0.430, 0.043, 0.039, 0.0, 0.0),
        (0.500, 0.035, 0.030, 0.0, 0.0),
        (0.545, 0.027, 0.021, 0.0, 0.0),
        (0.570, 0.025, 0.017, 0.0, 0.0),
    ), (0.040, 0.01)),
    Sweep("arm", "down", WRIST, (
        (-0.005, 0.025, 0.017, 0.0, 0.0),
        (0.030, 0.036, 0.019, 0.004, 0.0),
        (0.060, 0.044, 0.019, 0.005, 0.0),
        (0.090, 0.043, 0.017, 0.002, 0.0),
        (0.130, 0.037, 0.014, -0.002, 0.0),
        (0.165, 0.028, 0.011, -0.003, 0.0),
    ), (0.01, 0.024), 2.4),
)  # fmt: skip

LOWER_LEFT = (  # buttock, leg and foot
    Sweep("trunk", "up", (-0.060, 0.074, -0.030), ((0.0, 0.072, 0.078, 0.0, 0.0),), (0.095, 0.100)),
    Sweep("leg", "down", HIP, (
        (0.00, 0.094, 0.084, -0.006, 0.012),
        (0.06, 0.100, 0.090, -0.008, 0.011),
        (0.13, 0.096, 0.089, -0.001, 0.009),
        (0.22, 0.086, 0.081, 0.004, 0.004),
        (0.32, 0.072, 0.067, 0.003, 0.0),
        (0.39, 0.064, 0.060, 0.001, 0.0),
        (0.435, 0.063, 0.057, 0.000, 0.0),
        (0.490, 0.060, 0.056, -0.006, 0.0),
        (0.560, 0.064, 0.058, -0.015, 0.0),
        (0.640, 0.055, 0.050, -0.015, 0.0),
        (0.720, 0.042, 0.039, -0.010, 0.0),
        (0.800, 0.037, 0.034, -0.008, 0.0),
        (0.850, 0.041, 0.036, -0.006, 0.0),
        (0.880, 0.043, 0.035, -0.006, 0.0),
    ), (0.08, 0.03)),
    Sweep("leg", "forward", (0.0, ANKLE[1], FLOOR), (
        (-0.025, 0.030, 0.045, 0.0, 0.030),
        (0.000, 0.034, 0.050, 0.0, 0.035),
        (0.040, 0.037, 0.045, -0.002, 0.038),
        (0.080, 0.040, 0.036, -0.004, 0.030),
        (0.120, 0.045, 0.028, -0.004, 0.022),
        (0.146, 0.047, 0.023, -0.001, 0.018),
        (0.172, 0.043, 0.019, -0.006, 0.015),
        (0.189, 0.036, 0.017, -0.009, 0.013),
    ), (0.024, 0.022), 2.4, True),
)  # fmt: skip

# Rings of the surface: places of the lattice's layers.
TRUNK_LEVELS = (-0.075, -0.025, 0.02, 0.065, 0.11, 0.155, 0.20, 0.245, 0.29, 0.335, 0.38, 0.42, 0.46, 0.505, 0.545)
HEAD_LEVELS = (0.575, 0.60, 0.63, 0.66, 0.69, 0.72, 0.755, 0.79, 0.815)
LEG_LEVELS = (0.125, 0.165, 0.205, 0.245, 0.285, 0.325, 0.363, 0.398, 0.432, 0.466, 0.502, 0.54, 0.58, 0.622, 0.665,
              0.71, 0.755, 0.80, 0.842)  # fmt: skip
ARM_LEVELS = (0.06, 0.10, 0.14, 0.18, 0.22, 0.26, 0.295, 0.3255, 0.357, 0.395, 0.435, 0.475, 0.515, 0.552, 0.585, 0.615,
              0.645, 0.675, 0.705, 0.735, 0.765)  # fmt: skip
FOOT_XS = (-0.048, -0.028, 0.0, 0.025, 0.05, 0.078, 0.106, 0.132, 0.157, 0.181, 0.204)

# Clinical ranges of motion, degrees, from the neutral pose: AAOS, "Joint Motion: Method of Measuring and Recording"
# (1965), and Norkin and White, "Measurement of Joint Motion" (5th ed. 2016), a little wider for athletes.
LIMITS_DEG = {
    "lumbar_extension": (-60, 25), "lumbar_bending": (-35, 35), "lumbar_rotation": (-45, 45),
    "thorax_extension": (-40, 25), "thorax_bending": (-30, 30), "thorax_rotation": (-40, 40),
    "neck_extension": (-60, 75), "neck_bending": (-45, 45), "neck_rotation": (-80, 80),
    "clavicle_elevation": (-10, 45), "clavicle_protraction": (-25, 30),
    "arm_add": (-180, 45), "arm_flex": (-60, 180), "arm_rot": (-90, 90),
    "elbow_flex": (0, 150), "pro_sup": (-90, 90), "wrist_flex": (-70, 80),
    "hip_flexion": (-30, 125), "hip_adduction": (-50, 30), "hip_rotation": (-45, 45),
    "knee_angle": (-10, 145), "ankle_angle": (-50, 30), "subtalar_angle": (-25, 35),
}  # fmt: skip
