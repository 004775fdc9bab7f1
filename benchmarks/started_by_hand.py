"""How well `twistcap calibrate` does with cameras that were started by hand: a rendered board, the whole way.

    python -m benchmarks.started_by_hand --seeds 0-2
    python -m benchmarks.started_by_hand --seeds 0-0 --cases "in step" "75 later"

A board of 6 × 4 squares of 220 mm is turned and carried about for 12 s before pinholes of 960 × 700 px. Pictures are
made as they are asked for, twice as fine, with noise of two grey levels.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from reproduce.measures.cameras import aligned, errors
from twistcap import se3
from twistcap.arrays import Float, UInt8
from twistcap.calibrate.board import board_of
from twistcap.calibrate.calibrate import calibrated
from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError

SIZE, BOARD, LENGTH_S, FINE = (960, 700), board_of("charuco:6x4:220:165:4X4_50"), 12.0, 2
CASES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "in step": ((60,) * 4, (0,) * 4),
    "1 later": ((60,) * 4, (0, 1 / 60, 0, 0)),
    "3 later": ((60,) * 4, (0, 3 / 60, 0, 0)),
    "8 later": ((60,) * 4, (0, 8 / 60, 0, 0)),
    "75 later": ((60,) * 4, (0, 75 / 60, 0, 0)),
    "150 earlier": ((60,) * 4, (0, -150 / 60, 0, 0)),
    "by hand": ((60,) * 4, ()),
    "30 and 25 fps": ((30, 25, 30, 25), ()),
    "59.94 and 60 fps": ((59.94, 60, 59.94, 60), ()),
    "variable rate": ((30, 30, 30, 30), ()),
}
"""Frames per second, and s by which each camera shows later moments; random within ± 2.5 s where nothing is said."""


def path(rng: np.random.Generator) -> Any:
    """The board's place (4, 4) by time, s: once about, with three slow swings on each axis."""
    phases, speeds = rng.uniform(0, 2 * np.pi, (6, 3)), rng.uniform(0.1, 0.6, (6, 3))
    sizes = np.array([0.25, 0.3, 0.3, 0.3, 0.3, 0.15])[:, None] / np.array([1.0, 1.5, 2.0])
    start = rng.uniform(0, 2 * np.pi)
    upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
    middle = np.array([*(0.5 * np.array(BOARD.size)), 0.0])

    def at(time: float) -> Float:
        swing = np.sum(sizes * np.sin(phases + 2 * np.pi * speeds * time), axis=1)
        turn = se3.exp_rotation([0, 0, start + 2 * np.pi * time / LENGTH_S]) @ upright @ se3.exp_rotation(swing[:3])
        return se3.transform(turn, swing[3:] + np.array([0, 0, 1.0]) - turn @ middle)

    return at


@dataclass(frozen=True)
class Rendered:
    """A camera's recording, as `Source`; `moments` (F,) s are when its frames were truly taken."""

    camera: Camera
    board: Any
    moments: Float
    fps: float
    seed: int

    def __len__(self) -> int:
        return len(self.moments)

    @property
    def name(self) -> str:
        return self.camera.name

    @property
    def size(self) -> tuple[int, int]:
        return self.camera.size

    @property
    def times(self) -> Float:
        return self.moments - self.moments[0]

    @cached_property
    def _picture(self) -> UInt8:
        return np.pad(BOARD.image(60), 30, constant_values=255)

    def read(self, frames: Sequence[int]) -> Iterator[UInt8]:
        """(H, W, 3) RGB."""
        for k in frames:
            rng = np.random.default_rng([self.seed, k])
            T = self.camera.T_cam_world @ self.board(self.moments[k])
            image = np.full(SIZE[::-1], 90.0)
            middle = se3.apply(T, BOARD.points).mean(axis=0)
            if middle @ T[:3, 2] > 0.2 * np.linalg.norm(middle):
                to_board = np.diag([BOARD.square / 60, BOARD.square / 60, 1.0])
                to_board[:2, 2] = (
                    -29.5 * BOARD.square / 60
                )  # the middle of the first pixel is half a pixel from the rim
                finer = np.diag([FINE, FINE, 1.0])
                finer[:2, 2] = 0.5 * FINE - 0.5
                H = finer @ self.camera.K @ T[:3, [0, 1, 3]] @ to_board
                size = (FINE * SIZE[0], FINE * SIZE[1])
                large = cv2.warpPerspective(self._picture, H, size, flags=cv2.INTER_AREA, borderValue=90)
                image = cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA).astype(float)
            noisy = cv2.GaussianBlur(image, (0, 0), 0.6) + 2.0 * rng.normal(size=image.shape)
            yield np.repeat(np.clip(np.round(noisy), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def filmed(case: str, seed: int) -> tuple[dict[str, Rendered], Rig, Float]:
    """Recordings by camera, the true cameras, and (C,) s by which they were started later."""
    rng, cameras = np.random.default_rng(seed), list[Camera]()
    for c in range(4):
        angle = 2 * np.pi * c / 4 + 0.1 * rng.normal()
        eye = np.array([3.2 * np.cos(angle), 3.2 * np.sin(angle), 1.6 + 0.2 * rng.normal()])
        focal = 800.0 * np.exp(0.1 * rng.normal())
        K = np.array([[focal, 0, 479.5], [0, focal, 349.5], [0, 0, 1]])
        cameras.append(Camera(f"cam{c}", K, look_at(eye, [0, 0, 1.0]), SIZE))
    board, (rates, starts) = path(rng), CASES[case]
    late = np.array(starts) if starts else np.r_[0.0, rng.uniform(-2.5, 2.5, 3)]
    out = dict[str, Rendered]()
    for camera, fps, start in zip(cameras, rates, late, strict=True):
        moments = start + np.arange(round(LENGTH_S * fps)) / fps
        if case == "variable rate":
            moments = moments + rng.uniform(-0.3, 0.3, len(moments)) / fps
        out[camera.name] = Rendered(camera, board, moments, fps, int(rng.integers(1 << 30)))
    first = np.array([source.moments[0] for source in out.values()])
    return out, Rig(tuple(cameras)), first - first[0]


def main() -> None:
    """Print the measures of each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0-2")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    for case in given.cases:
        for seed in range(int(first), int(last or first) + 1):
            sources, true, late = filmed(case, seed)
            try:
                found: Any = calibrated(sources, BOARD)  # pyright: ignore[reportArgumentType]
            except InputError as error:
                print(f"{case}, seed {seed}: refused: {error}", flush=True)
                continue
            worst = errors(aligned(found.rig, true), true).max(axis=0)
            tick = found.timing.interval
            off = np.abs(found.late[0] - late / tick).max()
            print(
                f"{case}, seed {seed}: focal {worst[0]:.3f} %, rotation {worst[1]:.4f} deg, centre {worst[2]:.2f} mm,"
                f" clocks {off:.4f} frames of {1e3 * tick:.1f} ms, claimed {found.late[1].max():.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
