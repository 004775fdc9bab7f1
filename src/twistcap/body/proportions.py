"""Proportions, joints and their limits of the built-in humanoid: a sex-neutral adult, own work.

Lengths are fractions of stature: Drillis and Contini (1966) as given by Winter, "Biomechanics and Motor Control of
Human Movement", 4th ed. 2009, fig. 4.1 (DOI 10.1002/9780470549148). Places are of the left side in the neutral rest
pose at `H`, m: x forward, y left, z up, origin at mid-hip.
"""

from __future__ import annotations

from collections.abc import Mapping

Vector = tuple[float, float, float]

H = 1.75  # m, stature of the reference

RATIOS = {
    "hip_height": 0.530, "thigh": 0.245, "shank": 0.246, "ankle_height": 0.039, "foot": 0.152, "upper_arm": 0.186,
    "forearm": 0.146, "eye_height": 0.936,
}  # fmt: skip

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

FLEX, SIDE, TURN = (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
JOINTS: Mapping[str, Mapping[str, tuple[Vector, tuple[float, float]]]] = {
    "torso": {"lumbar_extension": (FLEX, (-60, 25)), "lumbar_bending": (SIDE, (-35, 35)),
              "lumbar_rotation": (TURN, (-45, 45))},
    "thorax": {"thorax_extension": (FLEX, (-40, 25)), "thorax_bending": (SIDE, (-30, 30)),
               "thorax_rotation": (TURN, (-40, 40))},
    "head": {"neck_extension": (FLEX, (-60, 75)), "neck_bending": (SIDE, (-45, 45)),
             "neck_rotation": (TURN, (-80, 80))},
    "clavicle": {"clavicle_elevation": ((-1, 0, 0), (-10, 45)), "clavicle_protraction": (TURN, (-25, 30))},
    "humerus": {"arm_add": (SIDE, (-180, 45)), "arm_flex": (FLEX, (-60, 180)), "arm_rot": (TURN, (-90, 90))},
    "ulna": {"elbow_flex": (FLEX, (0, 150))},
    "radius": {"pro_sup": (TURN, (-90, 90))},
    "hand": {"wrist_flex": (SIDE, (-70, 80))},
    "femur": {"hip_flexion": (FLEX, (-30, 125)), "hip_adduction": (SIDE, (-50, 30)), "hip_rotation": (TURN, (-45, 45))},
    "tibia": {"knee_angle": ((0.0, 1.0, 0.0), (-10, 145))},
    "foot": {"ankle_angle": ((-0.105, -0.979, -0.174), (-50, 30)),
             "subtalar_angle": ((0.787, 0.121, 0.605), (-25, 35))},
}  # fmt: skip
"""The joint that moves each segment: its coordinates, outermost first, with axis and limits (degrees).

Axes are those of the right side. Talocrural and subtalar ones after Inman, "The Joints of the Ankle" (1976), as gait
models use them. Limits are clinical ranges of motion from the neutral pose, a little wider for athletes: AAOS, "Joint
Motion: Method of Measuring and Recording" (1965), and Norkin and White, "Measurement of Joint Motion" (5th ed. 2016).
"""


def sided(name: str, side: str) -> str:
    """The name of a segment, coordinate or landmark of a side, "r" or "l"; of the middle where it is ""."""
    return f"{name}_{side}" if side else name


def of_side(axis: Vector, side: str) -> Vector:
    """A joint's axis on a side: mirrored on the left, so that equal signs mean equal movements."""
    x, y, z = axis
    return (-x, y, -z) if side == "l" else axis
