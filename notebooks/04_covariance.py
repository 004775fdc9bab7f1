# %% [markdown]
# # Covariance
# Each estimate claims how sure it is. Here the claim is held against the truth, and against what a hidden limb does.

# %%
import matplotlib.pyplot as plt
import numpy as np

import twistcap as tc


def followed(views, dropped=()):
    walk = tc.capture(tc.StudioConfig(seed=2, views=views, size=(256, 188), frames=14, dropped=dropped))
    return walk, list(tc.tracked(walk.frames(), tc.build.build(walk.body, walk.rig), walk.first_pose))


walk, estimates = followed(3)

# %% [markdown]
# The step δ of a pose is ω (rad) and v (m) of the root, then the joints (rad). `minus` gives it.

# %%
errors = np.array([e.pose.minus(walk.true_poses[e.index])[6:] for e in estimates])
sigmas = np.sqrt([np.diagonal(e.covariance)[6:] for e in estimates])
inside = float(np.mean(np.abs(errors) < 2 * sigmas))
print(f"{100 * inside:.0f} % of the joint errors are within 2σ; of normal errors it is 95 %")
assert inside > 0.8

# %% [markdown]
# While no camera has an image, the claim grows with the time.

# %%
_, gap = followed(2, dropped=((5, 9),))
knee = walk.body.coordinate("knee_angle_r")
sigma = np.degrees([e.covariance[6 + knee, 6 + knee] ** 0.5 for e in gap])
plt.plot([e.time for e in gap], sigma, ".-")
plt.xlabel("s")
plt.ylabel("σ of the right knee, °")
print([e.status for e in gap])
assert gap[7].status == "no_images" and sigma[9] > sigma[6] > sigma[4]

# %% [markdown]
# The σ of anything that depends on the pose: J C Jᵀ. Here the distance of the hands.


# %%
def distance(pose):
    marks = walk.body.landmarks
    points = tc.Posed(walk.body, pose).landmarks
    return np.linalg.norm(points[marks.index("wrist_r")] - points[marks.index("wrist_l")])


last, h = estimates[-1], 1e-5
J = np.array(
    [(distance(last.pose.retract(d)) - distance(last.pose.retract(-d))) / (2 * h) for d in h * np.eye(walk.body.dof)]
)
off = abs(distance(last.pose) - distance(walk.true_poses[last.index]))
sd = float(np.sqrt(J @ last.covariance @ J))
print(f"hands: {1000 * distance(last.pose):.0f} ± {1000 * sd:.0f} mm apart, {1000 * off:.0f} mm off")
assert np.isfinite(sd) and off < 4 * sd
