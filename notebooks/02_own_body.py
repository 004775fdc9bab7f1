# %% [markdown]
# # A body of your own
# Any skinned GLB can be tracked. Here one is written first: a taller person with thinner legs.

# %%
import tempfile
from pathlib import Path

import numpy as np

import twistcap as tc
from twistcap.body import rescaled
from twistcap.body.gltf import save_glb
from twistcap.studio.motion import gait


def legs(factor):
    return {f"{bone}_{side}": factor for bone in ("femur", "tibia") for side in "rl"}


path = Path(tempfile.mkdtemp()) / "person.glb"
save_glb(rescaled(tc.humanoid(), lengths=legs(1.06), girths=legs(0.92), stature=1.04), path)

# %% [markdown]
# A foreign file needs axes, limits and names in `person.rig.toml` beside it; ours has them inside.

# %%
body = tc.load_glb(path)
print(
    f"{len(body.vertices)} vertices, {len(body.segment_names)} segments, {len(body.coordinate_names)} joint coordinates"
)
height = float(np.ptp(body.vertices[:, 2]))
print(f"{height:.3f} m tall; the built-in one has {np.ptp(tc.humanoid().vertices[:, 2]):.3f} m")

# %% [markdown]
# The studio films this body; the tracker follows it with the file alone.

# %%
scene = tc.StudioConfig(seed=3, views=2, size=(256, 188), frames=6)
walk = tc.capture(scene, body, gait(body, fps=scene.fps, frames=scene.frames))
estimates = list(tc.tracked(walk.frames(), tc.build.build(walk.body, walk.rig), walk.first_pose))
off = [
    1000 * np.linalg.norm(tc.Posed(walk.body, e.pose).landmarks - walk.landmarks[e.index], axis=1).mean()
    for e in estimates
]
print(f"joints: {np.mean(off):.1f} mm off")
assert np.mean(off) < 20.0
