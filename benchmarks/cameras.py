"""How well a bumped camera is found again: a person who walks about; one camera is turned by 2 degrees.

    python -m benchmarks.cameras --seeds 8-11              # bumped before the recording
    python -m benchmarks.cameras --seeds 8-11 --at 70      # in the middle of it

It prints when the tracker named the camera, from which frame the new calibration is said to hold, and how far the
camera is off before and after, in degrees and mm.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reproduce.faults.staged import bumped_picture
from reproduce.scenes.pace import walking_about
from twistcap import se3
from twistcap.adjust.cameras import holds_from, mended_cameras
from twistcap.arrays import Float
from twistcap.build import build
from twistcap.camera import Camera
from twistcap.camera.bump import bumped
from twistcap.commands.clocks import suspects, watched_by, watching
from twistcap.estimate import Estimate, Frame
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.scene import default_body
from twistcap.track import Tracker

FPS, FRAMES, TURN = 60.0, 480, np.deg2rad(2.0)
USED = 150  # frames from which the camera is found, as `twistcap refine --cameras` has it


@dataclass(frozen=True)
class Bumped:
    """A recording with one bumped camera, and where that camera truly is."""

    scene: Capture
    frames: list[Frame]
    camera: int
    truth: Camera


def film(seed: int, at: int = 0, condition: str = "exact") -> Bumped:
    """A recording in which one camera is turned about a random axis from a frame on."""
    config = StudioConfig(seed=seed, views=4, condition=condition, frames=FRAMES)  # pyright: ignore[reportArgumentType]
    body = default_body(config)
    walk, rng = walking_about(body, seed, FRAMES / FPS), stream(seed, "bump")
    scene = capture(config, body, [walk(k / FPS) for k in range(FRAMES)])
    axis, camera = rng.standard_normal(3), int(rng.integers(config.views))
    turn = TURN * axis / np.linalg.norm(axis)
    there = bumped(scene.true_rig[camera], turn)
    moved = replace(scene, true_rig=replace(scene.true_rig, cameras=_with(scene.true_rig.cameras, camera, there)))
    room = bumped_picture(scene.rooms[camera], scene.true_rig[camera], turn)
    moved.__dict__["rooms"] = _with(scene.rooms, camera, room)
    return Bumped(scene, [(moved if k >= at else scene).frame(k) for k in range(FRAMES)], camera, there)


def _with(items: Sequence, k: int, item: object) -> tuple:
    return (*items[:k], item, *items[k + 1 :])


def tracked(filmed: Bumped) -> tuple[list[Estimate], list[tuple[int, ...]]]:
    """By the cameras as they were calibrated; and which cameras are named in each frame."""
    tracker = Tracker(watching(build(filmed.scene.body, filmed.scene.rig)))
    tracker.start(filmed.scene.first_pose, 0.0)
    estimates, named = list[Estimate](), list[tuple[int, ...]]()
    for frame in filmed.frames:
        estimates.append(tracker.step(frame))
        named.append((*estimates[-1].left_out, *suspects(watched_by(tracker)), *estimates[-1].turned))
    return estimates, named


def off(T_cam_world: Float, truth: Camera) -> tuple[float, float]:
    """Degrees and mm by which a camera stands elsewhere: its turn, and its centre."""
    turn = se3.log_rotation(T_cam_world[:3, :3] @ truth.T_cam_world[:3, :3].T)
    centre = -T_cam_world[:3, :3].T @ T_cam_world[:3, 3]
    return float(np.rad2deg(np.linalg.norm(turn))), 1000.0 * float(np.linalg.norm(centre - truth.centre))


def mended(filmed: Bumped, estimates: Sequence[Estimate], named: Sequence[tuple[int, ...]], seed: int) -> None:
    """Find the camera again, and print how well."""
    c, rig = filmed.camera, filmed.scene.rig
    out = [e.index for e, names in zip(estimates, named, strict=True) if c in names]
    others = sorted({k for names in named for k in names} - {c})
    lost = sum(e.lost for e in estimates)
    print(f"seed {seed}: camera {c} named in {len(out)} frames from {out[:1]}, others {others}; {lost} frames flagged")
    if not out:
        return
    chosen = [e for e in estimates if e.index >= out[0]]
    chosen = chosen[:: max(1, -(-len(chosen) // USED))]
    found = mended_cameras(lambda: [filmed.frames[e.index] for e in chosen], filmed.scene.body, rig, chosen, [c])
    sigma = found.sigmas[c]
    print(f"  off before {off(rig[c].T_cam_world, filmed.truth)}, after {off(found.places[c], filmed.truth)} (deg, mm)")
    print(f"  sigma {np.rad2deg(np.linalg.norm(sigma[:3])):.3f} deg {1000 * np.linalg.norm(sigma[3:]):.1f} mm; agree"
          f" {np.nanmean(found.before[c]):.2f} -> {np.nanmean(found.after[c]):.2f}; {len(found.moved)} rounds;"
          f" holds from {chosen[0].index + holds_from(found.before[c], found.after[c])}", flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--seeds", default="8-11")
    parser.add_argument("--at", type=int, default=0)
    parser.add_argument("--condition", default="exact", choices=["exact", "mismatch"])
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    for seed in range(int(first), int(last or first) + 1):
        filmed = film(seed, given.at, given.condition)
        mended(filmed, *tracked(filmed), seed)


if __name__ == "__main__":
    main()
