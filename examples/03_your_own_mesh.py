"""Track a rigged mesh of your own: any skinned GLB becomes a body (here, one that we write ourselves first).

python examples/03_your_own_mesh.py
"""

import tempfile
from pathlib import Path

from twistcap.body.gltf import load_glb, save_glb
from twistcap.body.humanoid import humanoid
from twistcap.build import build
from twistcap.hindsight import tracked
from twistcap.studio import StudioConfig, capture
from twistcap.studio.motion import gait


def main(frames: int = 10) -> bool:
    """Track legs from a GLB file through three views; returns whether the track was held."""
    path = Path(tempfile.mkdtemp()) / "legs.glb"
    save_glb(humanoid("legs"), path)

    body = load_glb(path)  # a foreign file: put its axes, limits and names into legs.rig.toml beside it
    scene = StudioConfig(seed=3, views=3, frames=frames, variant="legs")
    walk = capture(scene, body, gait(body, fps=scene.fps, frames=frames))
    estimates = list(tracked(walk.frames(), build(walk.body, walk.rig), walk.first_pose))
    for estimate in estimates:
        print(f"frame {estimate.index:3d}  support {estimate.support:.2f}  {'LOST' if estimate.lost else 'held'}")
    return not any(estimate.lost for estimate in estimates)


if __name__ == "__main__":
    main()
