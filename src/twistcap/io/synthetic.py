"""A synthetic capture as a session on disk, laid out as a laboratory's recording would be, with its truth beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from twistcap.arrays import AnyArray
from twistcap.body import Body, Pose
from twistcap.body.gltf_write import save_glb
from twistcap.errors import InputError, check_choice
from twistcap.io.calibration import write_rig
from twistcap.io.videowriter import VideoWriter
from twistcap.studio.config import StudioConfig
from twistcap.studio.scene import Capture

_CRF = 12  # hardly any compression: the studio's noise is its own
Images = Literal["video", "png"]


def write_session(
    capture: Capture, folder: Path | str, images: Images | None = None, masks: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Path:  # fmt: skip
    """Render a capture into a folder that `twistcap track` and `twistcap evaluate` can read.

    Written are ``session.toml``, ``Calib.toml``, ``body.glb``, ``first_pose.npz`` (what the tracker may know),
    ``videos/cam01.mp4`` … or ``videos/cam01/0000.png`` …, and of the truth ``truth.npz`` and
    ``masks/cam01/frame_0000.png`` ….

    Images are "video" (H.264) or "png" (lossless); by default videos, and PNG where frames are dropped, since a video
    has no way to say so. `progress` is called with the number of frames done and of all.

    Returns the path of ``session.toml``. Raises InputError where the folder cannot be written, for videos with dropped
    frames, or a first or last frame that is dropped.
    """
    folder, images = Path(folder), images or ("png" if capture.config.dropped else "video")
    check_choice("write_session: images", images, ("video", "png"))
    _check_drops(capture.config, images)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"folder {folder} cannot be made: {error.strerror}.") from error
    write_rig(capture.rig, folder / "Calib.toml")
    save_glb(capture.body, folder / "body.glb")
    _save(folder / "first_pose.npz", _pose_arrays(capture.body, [capture.first_pose]))
    write_truth(capture, folder / "truth.npz")
    (folder / "session.toml").write_text(session_text(capture, images), encoding="utf-8")
    _write_images(capture, folder, images, masks, progress)
    return folder / "session.toml"


def write_truth(capture: Capture, path: Path | str) -> None:
    """The true motion as npz.

    Holds root (N, 4, 4), q (N, J) rad, landmarks (N, L, 3) m, their names, coordinate_names, times (N,) s and fps.
    """
    arrays = _pose_arrays(capture.true_body, capture.true_poses)
    arrays["landmarks"], arrays["names"] = capture.landmarks, np.array(capture.true_body.landmarks.names)
    arrays["fps"] = np.array(capture.config.fps)
    arrays["times"] = np.arange(len(capture.true_poses)) / capture.config.fps
    _save(Path(path), arrays)


def _save(path: Path, arrays: Mapping[str, AnyArray]) -> None:
    np.savez(path, allow_pickle=False, **arrays)


def session_text(capture: Capture, images: Images) -> str:
    """The session file of a capture written by `write_session`."""
    ending = ".mp4" if images == "video" else "/%04d.png"
    videos = [f'{name} = "videos/{name}{ending}"' for name in capture.rig.names]
    lines = [
        f"# made by twistcap's studio, seed {capture.config.seed}, {capture.config.condition}",
        f"fps = {float(capture.config.fps)}",
        *("", "[cameras]", 'calibration = "Calib.toml"', 'unit = "m"'),
        *("", "[videos]", *videos),
        *("", "[body]", 'kind = "glb"', 'path = "body.glb"'),
        *("", "[first_pose]", 'file = "first_pose.npz"', "frame = 0", "refine = false", ""),
    ]
    return "\n".join(lines)


def _pose_arrays(body: Body, poses: Sequence[Pose]) -> dict[str, AnyArray]:
    return {
        "root": np.stack([p.root for p in poses]), "q": np.stack([p.q for p in poses]),
        "coordinate_names": np.array(body.coordinate_names),
    }  # fmt: skip


def _check_drops(config: StudioConfig, images: Images) -> None:
    if images == "video" and config.dropped:
        raise InputError("studio: a video cannot say which frames were dropped; write PNG images instead.")
    if any(config.is_dropped(k, c) for k in (0, config.frames - 1) for c in range(config.views)):
        raise InputError("studio: a written session needs its first and last frame; drop frames between them.")


def _write_images(
    capture: Capture, folder: Path, images: Images, masks: bool, progress: Callable[[int, int], None] | None
) -> None:
    names, config = capture.rig.names, capture.config
    made = [folder / "videos", *(folder / "videos" / name for name in names if images == "png")]
    for path in (*made, *(folder / "masks" / name for name in names if masks)):
        path.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        videos = {
            name: stack.enter_context(VideoWriter(folder / "videos" / f"{name}.mp4", config.fps, crf=_CRF))
            for name in names
            if images == "video"
        }
        for frame in capture.frames():
            for name, image in zip(names, frame.images, strict=True):
                if image is None:
                    continue  # its number is left out
                if name in videos:
                    videos[name].write(image)
                else:
                    _write_image(folder / "videos" / name / f"{frame.index:04d}.png", image)
            if masks:
                for name, mask in zip(names, capture.masks(frame.index), strict=True):
                    _write_image(folder / "masks" / name / f"frame_{frame.index:04d}.png", mask.astype(np.uint8) * 255)
            if progress is not None:
                progress(frame.index + 1, config.frames)


def _write_image(path: Path, image: AnyArray) -> None:
    """A PNG (by the path's ending) of an RGB or grey uint8 image."""
    cv2.imwrite(str(path), image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
