"""Captures of the studio with what only some claims need: boards, loose cloth, passers-by, photographic plates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from twistcap.arrays import Float, Float32
from twistcap.body import Body, Posed
from twistcap.errors import InputError
from twistcap.studio import Capture, StudioConfig
from twistcap.studio.background import muted_colour, smooth_noise
from twistcap.studio.config import stream
from twistcap.studio.picture import Layer, picture_of

_BORDER = 3.0  # px that a board is larger than the segments that it occludes
_WAVES = 6
_WAVE, _SWINGS = (0.10, 0.25), (0.8, 2.5)  # m, wavelength of the folds; 1/s, their frequency
_LOOSE = ("femur", "tibia", "thigh", "shank", "humerus", "torso", "thorax", "ulna")


@dataclass(frozen=True)
class Board:
    """A board that occludes some segments of the body in some views for a while, and no others.

    It is drawn between those segments and the rest of the body, large enough to cover them while it is there. It does
    not move, so that its edges give no evidence of them.

    Attributes:
        segments: that are occluded, ``("femur_r", "tibia_r", "foot_r")``.
        first, last: frames in which it is there, both included.
        cameras: numbers of the views with the board; by default all.
    """

    segments: tuple[str, ...]
    first: int
    last: int
    cameras: tuple[int, ...] | None = None

    def stands(self, frame: int, camera: int) -> bool:
        """Whether it is in a camera's frame."""
        return self.first <= frame <= self.last and (self.cameras is None or camera in self.cameras)


@dataclass(frozen=True)
class BoardedCapture(Capture):
    """A capture with boards for a while."""

    boards: tuple[Board, ...] = ()

    def scenery(self, index: int, camera: int, moments: Sequence[Posed]) -> Float32:
        """Each board is over the picture, and over it are the segments that it does not occlude."""
        picture, body = super().scenery(index, camera, moments), self.true_body
        for number, board in enumerate(self.boards):
            if board.stands(index, camera):
                Layer(0, 0, self._board(number, camera)).over(picture)
                hidden = np.isin(body.face_part, [body.segment(name) for name in board.segments])
                rest = replace(body, faces=np.ascontiguousarray(body.faces[~hidden]))
                picture = picture_of([Posed(rest, m.pose) for m in moments], self.true_rig[camera], self.look, picture)
        return picture

    def _board(self, number: int, camera: int) -> Float32:
        """(H, W, 4) colour times coverage, and coverage, of a board large enough for its segments in all its frames."""
        board, body = self.boards[number], self.true_body
        hidden = np.isin(body.vertex_part, [body.segment(name) for name in board.segments])
        poses = self.true_poses[max(0, board.first - 1) : board.last + 2]
        pixels = self.true_rig[camera].project(np.concatenate([Posed(body, p).vertices[hidden] for p in poses]))[0]
        rng = stream(self.config.seed, "boards", number, camera)
        width, height = self.config.size
        (x, y) = np.maximum(pixels.min(axis=0) - _BORDER, 0).astype(int)
        (right, bottom) = np.maximum(np.ceil(pixels.max(axis=0) + _BORDER), 0).astype(int)
        cells = smooth_noise(rng, (height, width), 9.0 * height / 280)
        layer = np.ones((height, width, 4))
        layer[..., :3] = np.clip(np.array(muted_colour(rng, 0.2)) / 255 * (1 + 0.15 * cells), 0, 1)
        inside = np.zeros((height, width, 1))
        inside[y : bottom + 1, x : right + 1] = 1.0
        return (layer * inside).astype(np.float32)


def boarded(take: Capture, boards: tuple[Board, ...]) -> BoardedCapture:
    """The capture with boards.

    Raises:
        InputError: for boards that are not within its frames.
    """
    if not all(0 <= board.first <= board.last < take.config.frames for board in boards):
        raise InputError(f"boards are {boards}; their first and last frame must lie in the sequence.")
    return BoardedCapture(**_fields(take), boards=boards)


@dataclass(frozen=True)
class LooseCapture(Capture):
    """A capture with motion that is neither the body's nor the room's.

    Attributes:
        cloth: motion (m) of the texture of shirt and trousers over the surface, as of loose cloth.
        passers: number of textured things that move behind the person.
    """

    cloth: float = 0.0
    passers: int = 0

    def scenery(self, index: int, camera: int, moments: Sequence[Posed]) -> Float32:
        room, slide = self.rooms[camera].copy(), flutter(self.true_body, self.config, self.cloth, index)
        for number in range(self.passers):
            passer(room, self.config, number, camera, index)
        return picture_of(moments, self.true_rig[camera], self.look, room, slide)


def loose(take: Capture, cloth: float, passers: int) -> LooseCapture:
    """The capture with loose clothes and passers-by."""
    return LooseCapture(**_fields(take), cloth=cloth, passers=passers)


class PlateCapture(Capture):
    """A capture as old photographs show it: low contrast, varying exposure, grain."""

    def exposed(self, index: int, camera: int, moments: Sequence[Posed]) -> Float32:
        picture = super().exposed(index, camera, moments)
        rng = stream(self.config.seed, "plate", camera, index)
        gain, offset = 1.0 + 0.08 * rng.standard_normal(), 0.03 * rng.standard_normal()
        picture *= np.float32(0.5 * gain)
        picture += np.float32(0.25 * gain + offset)
        picture += np.float32(0.03) * rng.standard_normal(picture.shape, dtype=np.float32)
        return picture


def plates(take: Capture) -> PlateCapture:
    """The capture on photographic plates."""
    return PlateCapture(**_fields(take))


def _fields(take: Capture) -> dict[str, Any]:
    return {f.name: getattr(take, f.name) for f in fields(take)}


def flutter(body: Body, config: StudioConfig, size: float, frame: int) -> Float:
    """(V, 3) m displacement of the texture of loose cloth over the rest pose in a frame.

    Travelling waves of several lengths and directions, with a root mean square of `size` (m).
    """
    rng, time = stream(config.seed, "cloth"), frame / config.fps
    out = np.zeros_like(body.vertices)
    for _ in range(_WAVES):
        along, slide = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        phase = 2 * np.pi * (body.vertices @ along / rng.uniform(*_WAVE) + time * rng.uniform(*_SWINGS) + rng.random())
        out += np.sin(phase)[:, None] * slide
    loose = np.array([any(name.startswith(part) for part in _LOOSE) for name in body.segment_names])
    fraction = np.sum(body.skin_weights * loose[body.skin_segments], axis=1)
    return size / np.sqrt(_WAVES / 2) * fraction[:, None] * out


def passer(room: Float32, config: StudioConfig, number: int, camera: int, frame: int) -> None:
    """Paint a textured thing that crosses the picture (H, W, 3), in place."""
    rng = stream(config.seed, "passers", number, camera)
    height, width = room.shape[:2]
    w, h = int(width * rng.uniform(0.08, 0.16)), int(height * rng.uniform(0.3, 0.75))
    speed = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.2) * height / 2.0  # px/s
    x = (rng.uniform(0, width) + speed * frame / config.fps) % (width + w) - w
    y = int(rng.uniform(0.15, 0.5) * height)
    cell = rng.uniform(0.15, 0.85) * (1.0 + 0.25 * smooth_noise(rng, (h, w + 1), 5.0 * height / 280))
    shift = x - np.floor(x)
    left, right = (np.pad(cell[:, :w], ((0, 0), pad, (0, 0))) for pad in ((0, 1), (1, 0)))
    strip = (1 - shift) * left + shift * right
    cover = np.ones(w + 1)
    cover[0], cover[-1] = 1 - shift, shift
    first = int(np.floor(x))
    for column in range(w + 1):
        at = first + column
        if 0 <= at < width:
            rows = room[y : y + h, at]
            room[y : y + h, at] = (1 - cover[column]) * rows + np.clip(strip[: len(rows), column], 0, 1)
