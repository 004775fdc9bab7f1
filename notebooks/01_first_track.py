# %% [markdown]
# # First track
# A synthetic walk is rendered in two views, tracked, and compared with its truth. Nothing has to be downloaded.

# %%
import matplotlib.pyplot as plt
import numpy as np

import twistcap as tc

walk = tc.capture(tc.StudioConfig(seed=0, views=2, size=(256, 188), frames=12))
frames = list(walk.frames())
plt.imshow(frames[0].images[0])
plt.axis("off")
# %% [markdown]
# A *model* is the body, the cameras, and what is known without pixels. The tracker starts from a first pose.

# %%
model = tc.build.build(walk.body, walk.rig)
estimates = list(tc.tracked(frames, model, walk.first_pose))
estimates[-1].status, estimates[-1].lost

# %%
knee = walk.body.coordinate("knee_angle_r")
ours = np.degrees([e.pose.q[knee] for e in estimates])
truth = np.degrees([pose.q[knee] for pose in walk.true_poses])
sigma = np.degrees([e.covariance[6 + knee, 6 + knee] ** 0.5 for e in estimates])
time = [e.time for e in estimates]
plt.fill_between(time, ours - 2 * sigma, ours + 2 * sigma, alpha=0.3, label="± 2σ")
plt.plot(time, ours, label="tracked")
plt.plot(time, truth, "k--", label="truth")
plt.xlabel("s")
plt.ylabel("right knee, °")
plt.legend()
# %%
error = float(np.abs(ours - truth).mean())
assert error < 2.0 and not any(e.lost for e in estimates)
print(f"mean error of the right knee: {error:.2f}°")
