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
    capture: Capture,
    folder: Path | str,
    images: Images | None = None,
    masks: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render a capture into a folder that `twistcap track` and `twistcap evaluate` can read.

    Written are ``session.toml``, ``Calib.toml``, ``body.glb``, ``first_pose.npz`` (what the tracker may know),
    ``videos/cam01.mp4`` … or ``videos/cam01/0000.png`` …, and of the truth ``truth.npz`` and
    ``masks/cam01/frame_0000.png`` ….

    Args:
        capture: what to write.
        folder: made if it does not exist.
        images: "video" (H.264) or "png" (lossless); by default videos, and PNG where frames are dropped, since a video
            has no way to say so.
        masks: whether to write the true silhouettes.
        progress: called with the number of frames done and of all.

    Returns:
        The path of ``session.toml``.

    Raises InputError where the folder cannot be written, for videos with dropped frames, or a first or last frame that
    is dropped.
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
    (folder / "session.toml").write_text(session_text(capture, images))
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
        "root": np.stack([p.root for p in poses]),
        "q": np.stack([p.q for p in poses]),
        "coordinate_names": np.array(body.coordinate_names),
    }


def _check_drops(config: StudioConfig, images: Images) -> None:
    if images == "video" and config.dropped:
        raise InputError("studio: a video cannot say which frames were dropped; write PNG images instead.")
    ends = [config.is_dropped(k, c) for k in (0, config.frames - 1) for c in range(config.views)]
    if any(ends):
        raise InputError("studio: a written session needs its first and last frame; drop frames between them.")


def _write_images(
    capture: Capture, folder: Path, images: Images, masks: bool, progress: Callable[[int, int], None] | None
) -> None:
    names, total = capture.rig.names, capture.config.frames
    with ExitStack() as stack:
        writers = [stack.enter_context(_ImageWriter(folder / "videos", n, capture.config.fps, images)) for n in names]
        for frame in capture.frames():
            for writer, image in zip(writers, frame.images, strict=True):
                writer.write(image)
            if masks:
                _write_masks(capture, folder / "masks", frame.index)
            if progress is not None:
                progress(frame.index + 1, total)


def _write_masks(capture: Capture, folder: Path, index: int) -> None:
    for name, mask in zip(capture.rig.names, capture.masks(index), strict=True):
        (folder / name).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name / f"frame_{index:04d}.png"), mask.astype(np.uint8) * 255)


class _ImageWriter:
    """One camera's images, as a video or as numbered PNG files."""

    def __init__(self, folder: Path, name: str, fps: float, images: Images) -> None:
        self._folder, self._count = folder / name, 0
        (folder if images == "video" else self._folder).mkdir(parents=True, exist_ok=True)
        self._video = VideoWriter(folder / f"{name}.mp4", fps, crf=_CRF) if images == "video" else None

    def write(self, image: AnyArray | None) -> None:
        """Append one image; None leaves its number out."""
        if self._video is not None and image is not None:
            self._video.write(image)
        elif image is not None:
            stored = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(self._folder / f"{self._count:04d}.png"), stored)
        self._count += 1

    def __enter__(self) -> _ImageWriter:
        return self

    def __exit__(self, *_: object) -> None:
        if self._video is not None:
            self._video.close()
