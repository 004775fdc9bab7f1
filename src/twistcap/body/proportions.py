"""Proportions and joint limits of the built-in humanoid: a sex-neutral adult, own work.

Lengths are fractions of stature: Drillis and Contini (1966) as given by Winter, "Biomechanics and Motor Control of
Human Movement", 4th ed. 2009, fig. 4.1 (DOI 10.1002/9780470549148). Places are of the left side in the neutral rest
pose at `H`, m: x forward, y left, z up, origin at mid-hip.
"""

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
