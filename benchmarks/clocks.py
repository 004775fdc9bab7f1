"""How well clocks are found, and what tracking loses by them: a person who walks about, filmed by unlike cameras.

    python -m benchmarks.clocks studio --seeds 8-15
    python -m benchmarks.clocks keypoints          # balance_4view, with TWISTCAP_DATA

Each camera begins up to 2.5 s after another; one has 60 frames per second, one 59.94, one a variable rate with dropped
frames. `twistcap sync` sees none of that. The joints that are tracked then are compared with those of cameras that were
triggered together.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import av
import numpy as np

from reproduce.scenes.pace import walking_about
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.gltf_write import save_glb
from twistcap.commands.sync import synchronise
from twistcap.io.calibration import write_rig
from twistcap.io.clocks import Clock
from twistcap.io.recording import open_recording
from twistcap.io.session import load_session
from twistcap.io.session_edit import write_clocks
from twistcap.io.videowriter import VideoWriter
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.picture import marred
from twistcap.studio.scene import default_body

LONGEST, LENGTH = 2.5, 9.5  # s by which cameras start apart, s that each of them films
FRAMES = 150  # frames by which joints are compared
DATA = Path(os.environ.get("TWISTCAP_DATA", "../shared/data"))


@dataclass(frozen=True)
class Filmed:
    """A session, what is true of it, and the session of the same frames by cameras that were triggered together."""

    session: Path
    together: Path
    offsets: Float  # (C,) s, of the clocks; the first is 0
    truth: list[Pose]  # at the frames of the first camera
    body: Body


def film(folder: Path, seed: int, condition: str = "exact", views: int = 4) -> Filmed:
    """Render and write both sessions."""
    config = StudioConfig(seed=seed, views=views, condition=condition, frames=30)  # pyright: ignore[reportArgumentType]
    body = default_body(config)
    at, rng = walking_about(body, seed, LENGTH + LONGEST + 1.0), stream(seed, "clocks")
    scene = capture(config, body, [at(t) for t in np.linspace(0, LENGTH + LONGEST, config.frames)])
    starts = rng.permutation([0.0, LONGEST, *rng.uniform(0, LONGEST, views - 2)])
    own = [frame_times(kind, rng) for kind in rng.permutation(["60", "59.94", "vfr", "60"])[np.arange(views) % 4]]
    first = int(np.ceil((max(starts) - starts[0] + 0.1) / (own[0][1] - own[0][0])))
    frames = (first, first + FRAMES - 1)
    truth = [at(starts[0] + t) for t in own[0]]
    for name in ("apart", "together"):
        (folder / name).mkdir(parents=True, exist_ok=True)
        save_glb(scene.body, folder / name / "body.glb")
        write_rig(scene.rig, folder / name / "Calib.toml")
        np.savez(folder / name / "first.npz", root=[p.root for p in truth], q=[p.q for p in truth],
                 coordinate_names=np.array(body.coordinate_names))  # fmt: skip
        (folder / name / "session.toml").write_text(session_text(scene, (first, len(own[0]) - 1)))
    claps = np.zeros(0)
    for c in range(views):
        write_video(scene, c, at, own[c], starts[c], folder / "apart" / f"{scene.rig.names[c]}.mp4")
        write_video(scene, c, at, own[0], starts[0], folder / "together" / f"{scene.rig.names[c]}.mp4", frames)
        claps = rng.uniform(LONGEST, LENGTH, 3) if c == 0 else claps
        add_sound(folder / "apart" / f"{scene.rig.names[c]}.mp4", claps - starts[c], 1000 * seed + c)
    return Filmed(
        folder / "apart" / "session.toml", folder / "together" / "session.toml", starts - starts[0], truth, body
    )  # fmt: skip


def frame_times(kind: str, rng: np.random.Generator) -> Float:
    """(N,) s, from 0 on."""
    if kind != "vfr":
        return np.arange(int(LENGTH * float(kind))) / float(kind)
    gaps = rng.uniform(0.8, 1.2, int(LENGTH * 60)) / 60
    gaps[rng.random(len(gaps)) < 0.02] *= 2.0  # dropped frames
    return np.concatenate([[0.0], np.cumsum(gaps)[:-1]])


def write_video(
    scene: Capture, camera: int, at: Callable[[float], Pose], own: Float, start: float, path: Path,
    frames: tuple[int, int] | None = None,
) -> None:  # fmt: skip
    """The images of a camera at times of its own clock; images outside `frames` are not needed and are grey."""
    with VideoWriter(path, 60, crf=12) as writer:
        for k, t in enumerate(own):
            if frames is not None and not frames[0] <= k <= frames[1]:
                image = np.full((*scene.config.size[::-1], 3), 128, np.uint8)
            else:
                picture = scene.exposed(k, camera, [Posed(scene.true_body, at(start + t))])
                image = marred(picture, scene.config, k, camera)
            writer.write(image, float(t))


def session_text(scene: Capture, frames: tuple[int, int]) -> str:
    videos = "\n".join(f'{name} = "{name}.mp4"' for name in scene.rig.names)
    pose = f'[first_pose]\nfile = "first.npz"\nframe = {frames[0]}\nrefine = false\n'
    cameras = f'[cameras]\ncalibration = "Calib.toml"\nunit = "m"\n\n[videos]\n{videos}\n'
    return f'frames = [{frames[0]}, {frames[1]}]\n\n{cameras}\n[body]\nkind = "glb"\npath = "body.glb"\n\n{pose}'


def joint_error(session: Path, filmed: Filmed) -> float:
    """Mean distance (mm) of the joints from the truth, over the first frames."""
    from twistcap.commands.track import session_tracker

    recording = open_recording(load_session(session))
    tracker = session_tracker(recording.session, recording.body, recording.views)
    tracker.start(recording.first_pose, recording.first_time)
    joints = [i for i, n in enumerate(filmed.body.landmarks.names)
              if n.rsplit("_", 1)[0] in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]  # fmt: skip
    off = list[float]()
    for frame in islice(recording.views, FRAMES):
        found = Posed(recording.body, tracker.step(frame).pose).landmarks
        true = Posed(filmed.body, filmed.truth[frame.index]).landmarks
        off.append(float(np.linalg.norm(found[joints] - true[joints], axis=1).mean()))
    return 1000.0 * float(np.mean(off))


def add_sound(path: Path, claps: Sequence[float], seed: int) -> None:
    """Put a sound track into a video: noise, and claps at times (s) of its own clock."""
    rate, rng = 48_000, np.random.default_rng(seed)
    samples = 0.01 * rng.standard_normal(int((LENGTH + 0.5) * rate))
    for clap in claps:
        k = round(clap * rate)
        if 0 <= k < len(samples):
            tail = np.exp(-np.arange(min(rate // 10, len(samples) - k)) / (0.01 * rate))
            samples[k : k + len(tail)] += 0.8 * tail * rng.standard_normal(len(tail))
    loud = np.clip(samples, -1, 1) * 32767
    part = path.with_name(f"{path.stem}-sound{path.suffix}")
    with av.open(str(path)) as source, av.open(str(part), "w") as goal:
        picture = goal.add_stream_from_template(source.streams.video[0])
        sound = goal.add_stream("alac", rate=rate, layout="mono")
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = picture
                goal.mux(packet)
        for start in range(0, len(loud), 4096):
            frame = av.AudioFrame.from_ndarray(loud[None, start : start + 4096].astype(np.int16), "s16p", "mono")
            frame.sample_rate, frame.pts = rate, start
            goal.mux(sound.encode(frame))
        goal.mux(sound.encode(None))
    part.replace(path)


def studio(seeds: Sequence[int], condition: str, frames: int, start: str) -> None:
    """One row for each seed: greatest error of a clock, and joints against those of triggered cameras."""
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            filmed = film(Path(folder), seed, condition)
            document = synchronise(filmed.session, start, frames)
            found = np.array([row["after_s"] for row in document["cameras"]])
            sigma = np.array([row["sigma_frames"] for row in document["cameras"]])
            off = 60.0 * np.abs(found - filmed.offsets)
            joints = [joint_error(session, filmed) for session in (filmed.session, filmed.together)]
            names = [row["camera"] for row in document["cameras"]]
            true = {name: Clock(float(t)) for name, t in zip(names, filmed.offsets, strict=True)}
            write_clocks(filmed.session, true, None)
            joints.append(joint_error(filmed.session, filmed))
            print(f"seed {seed} {condition}: began with {document['began_with']}; unsure {document['unsure']}")
            print(f"  clocks off by {np.round(off, 3)} frames, sigma {np.round(sigma, 3)}")
            of = "joints {:.2f} mm, of triggered cameras {:.2f} mm, by the true clocks {:.2f} mm"
            print("  " + of.format(*joints), flush=True)


def keypoints(frames: int) -> None:
    """The clock of the keypoints of balance_4view against its images, in a session that does not know it."""
    example = Path("examples/balance_4view.toml").read_text().replace("offset = 1.3\n", "offset = 0.0\n")
    text = example.replace("${TWISTCAP_DATA:-../../shared/data}", str(DATA.resolve()))
    with tempfile.TemporaryDirectory() as folder:
        session = Path(folder) / "session.toml"
        session.write_text(text)
        print(json.dumps(synchronise(session, "given", frames, write=False), default=str, indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("what", choices=["studio", "keypoints"])
    parser.add_argument("--seeds", default="8-15")
    parser.add_argument("--condition", default="exact", choices=["exact", "mismatch"])
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--start", default="auto")
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    if given.what == "keypoints":
        keypoints(min(given.frames, 100))
    else:
        studio(range(int(first), int(last or first) + 1), given.condition, given.frames, given.start)


if __name__ == "__main__":
    main()
