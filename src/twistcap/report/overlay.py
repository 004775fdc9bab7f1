"""The tracked body drawn over the images: shaded surface, outline and skeleton; and videos of all views."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from twistcap import se3
from twistcap.arrays import AnyArray, Bool, Float, Float32, Int
from twistcap.body import Body, Posed
from twistcap.body.kinematics import unit_vertex_normals
from twistcap.body.limbs import named_limbs
from twistcap.camera import Camera, Rig
from twistcap.camera.bump import bumped
from twistcap.estimate import Estimate, Frame
from twistcap.io.videowriter import VideoWriter, as_rgb
from twistcap.render.raster import barycentric, rasterise
from twistcap.report.words import camera_in_words, doubtful, state_in_words

Colour = tuple[int, int, int]

RIGHT: Colour = (255, 150, 50)
LEFT: Colour = (50, 170, 255)
MIDDLE: Colour = (225, 225, 215)
LOST: Colour = (235, 40, 50)
_LARGEST = (1600, 900)  # (width, height) px of all views together
_INK: Colour = (20, 24, 32)
_PAPER: Colour = (245, 246, 248)
_CREASE = 0.02  # a jump by this fraction of the depth between neighbouring pixels is drawn as a line


Bones = tuple[Int, Float]
"""The lines of a skeleton: segments (B,) that bones move with, and their rest-pose end points (B, 2, 3), m."""


def bones_of(body: Body) -> Bones:
    """A bone from every segment's joint to each joint below it, or to the segment's farthest landmark at the ends."""
    origins = body.joint_origins
    bones: list[tuple[int, Float, Float]] = []
    for s, above in enumerate(body.segment_parent):
        if above >= 0:
            bones.append((int(above), origins[above], origins[s]))
        if s not in body.segment_parent:
            own = body.landmarks.points[body.landmarks.segments == s]
            if len(own):
                bones.append((s, origins[s], own[np.argmax(np.linalg.norm(own - origins[s], axis=1))]))
    ends = np.array([[a, b] for _, a, b in bones]).reshape(-1, 2, 3)
    return np.array([s for s, _, _ in bones], dtype=np.int32), ends


def draw_overlay(
    image: AnyArray | None, camera: Camera, posed: Posed, lost: Bool | bool = False, opacity: float = 0.5,
    bones: Bones | None = None,
) -> AnyArray:  # fmt: skip
    """The body drawn over one image: (H, W, 3) uint8 RGB.

    Args:
        image: (H, W) or (H, W, 3), uint8 or float in [0, 1]; None for a dropped frame (drawn on a dark ground).
        camera: of the image: with distortion for images as recorded, `pinhole()` for rectified ones.
        posed: the body at its pose.
        lost: (S,) segments that are drawn in red; True for all.
        opacity: of the surface, 0 to 1.
        bones: `bones_of` the body, to save their computation when many images are drawn.
    """
    canvas, lost = _canvas(image, camera), np.broadcast_to(lost, len(posed.body.segment_names))
    pixels, inverse_depth = visible_projection(camera, posed.vertices)
    window = _window(pixels[inverse_depth > 0], camera.size)
    width = max(1.5, camera.size[1] / 400)
    if window:
        face_index, buffer = rasterise(pixels, inverse_depth, posed.body.faces, *window)
        colours = _shaded(posed, camera, pixels, inverse_depth, face_index, window[0], lost)
        part = _cut(canvas, *window)
        seen = face_index >= 0
        part[seen] = (part[seen] * (1 - opacity) + colours * opacity).astype(np.uint8)
        _draw_outline(canvas, seen, buffer, window, LOST if lost.all() else _PAPER, width)
    _draw_bones(canvas, camera, bones or bones_of(posed.body), posed, lost, width)
    return canvas


Window = tuple[tuple[int, int], tuple[int, int]]  # (x, y) of the first pixel, (width, height)


def _window(pixels: Float, size: tuple[int, int]) -> Window | None:
    """The part of the image that holds the pixels (N, 2) and a margin of 4 px; None where there is none."""
    if not len(pixels):
        return None
    x, y = np.clip(np.floor(pixels.min(axis=0)) - 4, 0, size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(pixels.max(axis=0)) + 5, 0, size).astype(int).tolist()
    return ((x, y), (right - x, bottom - y)) if right > x and bottom > y else None


def _cut(canvas: AnyArray, origin: tuple[int, int], size: tuple[int, int]) -> AnyArray:
    return canvas[origin[1] : origin[1] + size[1], origin[0] : origin[0] + size[0]]


def visible_projection(camera: Camera, points: Float) -> tuple[Float, Float]:
    """Pixels (N, 2), distortion included, and inverse depths (N,) 1/m; 0 for points that the camera cannot see.

    Far outside the image the distortion polynomial folds back into it: points that do not survive the round trip
    pixel → ray are taken as unseen.
    """
    pixels, depth = camera.project(points)
    good = (depth > 1e-3) & np.isfinite(pixels).all(axis=-1)
    if camera.distorts:
        straight, _ = camera.pinhole().project(points)
        back = camera.normalised(np.where(good[:, None], pixels, 0.0)) @ camera.K[:2, :2].T + camera.K[:2, 2]
        with np.errstate(invalid="ignore"):
            good &= np.abs(back - straight).max(axis=-1) < 1.0
    inverse_depth = np.where(good, 1.0 / np.where(good, depth, 1.0), 0.0)
    return np.where(good[:, None], pixels, 0.0), inverse_depth


def _canvas(image: AnyArray | None, camera: Camera) -> AnyArray:
    return np.full((*camera.size[::-1], 3), 40, np.uint8) if image is None else as_rgb(image).copy()


def part_colours(body: Body, lost: Bool | bool = False) -> Float:
    """(S, 3) RGB of every segment: right warm, left cool, the middle neutral, red those (S,) that are lost."""
    sides = {"_r": RIGHT, "_l": LEFT}
    own = np.array([sides.get(name[-2:].lower(), MIDDLE) for name in body.segment_names], dtype=float)
    return np.where(np.broadcast_to(lost, len(own))[:, None], np.array(LOST, dtype=float), own)


def _shaded(
    posed: Posed, camera: Camera, pixels: Float, inverse_depth: Float, face_index: Int, origin: tuple[int, int],
    lost: Bool,
) -> Float:  # fmt: skip
    """(n, 3) colours of the covered pixels, lit from the camera's upper left."""
    body, (y, x) = posed.body, np.nonzero(face_index >= 0)
    faces_seen = face_index[y, x]
    at = np.stack([x + origin[0], y + origin[1]], axis=1)
    weights = barycentric(faces_seen, body.faces, pixels, inverse_depth, at)
    light = np.array([-0.35, -0.55, -0.76]) @ camera.T_cam_world[:3, :3]
    normals = unit_vertex_normals(posed.vertices, body.faces)
    bright = 0.30 + 0.70 * np.clip(normals @ light, 0.0, 1.0)
    base = part_colours(body, lost)[body.face_part[faces_seen]]
    return np.einsum("nk,nk->n", weights, bright[body.faces[faces_seen]])[:, None] * base


def _draw_outline(
    canvas: AnyArray, seen: Bool, inverse_depth: Float32, window: Window, colour: Colour, width: float
) -> None:
    """A light line along the silhouette, a dark rim outside it, dark creases where one limb passes before another."""
    part = _cut(canvas, *window)
    part[_creases(inverse_depth)] //= 2
    reach = 2 * round(width) + 3
    rim = cv2.dilate(seen.astype(np.uint8), np.ones((reach, reach), np.uint8)).astype(bool) & ~seen
    part[rim] //= 3
    contours, _ = cv2.findContours(seen.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(canvas, contours, -1, colour, max(1, round(0.8 * width)), cv2.LINE_AA, offset=window[0])


def _creases(inverse_depth: Float32) -> Bool:
    """(H, W) the farther pixels of every depth jump inside the silhouette."""
    others = (np.roll(inverse_depth, shift, axis=axis) for axis in (0, 1) for shift in (1, -1))
    jumps = np.any([other > inverse_depth * (1 + _CREASE) for other in others], axis=0)
    return (inverse_depth > 0) & jumps


def _draw_bones(canvas: AnyArray, camera: Camera, bones: Bones, posed: Posed, lost: Bool, width: float) -> None:
    segments, ends = bones
    ends = se3.apply(posed.segment_transforms[segments], ends)
    pixels, inverse_depth = visible_projection(camera, ends.reshape(-1, 3))
    pixels, inside = pixels.reshape(-1, 2, 2), np.all((inverse_depth > 0).reshape(-1, 2), axis=1)
    colours = part_colours(posed.body, lost)[segments].tolist()
    thick = max(1, round(width))
    for dark in (True, False):  # all dark borders first, so that no border cuts another bone
        for (a, b), own, visible in zip(pixels, colours, inside.tolist(), strict=True):
            if visible:
                ink = _INK if dark else own
                cv2.line(canvas, _fixed(a), _fixed(b), ink, thick + 2 * dark, cv2.LINE_AA, _SHIFT)
    for a, visible in zip(pixels.reshape(-1, 2), np.repeat(inside, 2).tolist(), strict=True):
        if visible:
            radius = round(1.4 * width * 2**_SHIFT)
            cv2.circle(canvas, _fixed(a), radius + 2**_SHIFT, _INK, -1, cv2.LINE_AA, _SHIFT)
            cv2.circle(canvas, _fixed(a), radius, _PAPER, -1, cv2.LINE_AA, _SHIFT)


_SHIFT = 4  # OpenCV draws at sixteenths of a pixel


def _fixed(pixel: Float) -> tuple[int, int]:
    clipped = np.clip(pixel, -1e4, 1e4) * 2**_SHIFT
    return round(float(clipped[0])), round(float(clipped[1]))


@dataclass(frozen=True)
class Mosaic:
    """A grid of views under a heading: (width, height) px of a cell, and each camera scaled to fit its cell."""

    cell: tuple[int, int]
    columns: int
    rows: int
    cameras: tuple[Camera, ...]
    heading: int = 40  # px

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the whole, both even as H.264 wants them."""
        width, height = self.columns * self.cell[0], self.rows * self.cell[1] + self.heading
        return width + width % 2, height + height % 2

    def place(self, canvas: AnyArray, k: int, view: AnyArray) -> tuple[int, int]:
        """Put view k into the middle of its cell; returns the (x, y) of its upper left corner."""
        x = (k % self.columns) * self.cell[0] + (self.cell[0] - view.shape[1]) // 2
        y = self.heading + (k // self.columns) * self.cell[1] + (self.cell[1] - view.shape[0]) // 2
        canvas[y : y + view.shape[0], x : x + view.shape[1]] = view
        return x, y


def mosaic_for(rig: Rig) -> Mosaic:
    """The grid that shows the views largest within 1600 × 900 pixels; images are enlarged at most threefold."""
    w, h = max(camera.size[0] for camera in rig), max(camera.size[1] for camera in rig)

    def scale(columns: int) -> float:
        return min(3.0, _LARGEST[0] / (columns * w), _LARGEST[1] / (math.ceil(len(rig) / columns) * h))

    columns = max(range(1, len(rig) + 1), key=scale)
    cameras = tuple(camera.scaled(scale(columns)) for camera in rig)
    cell = (max(camera.size[0] for camera in cameras) + 4, max(camera.size[1] for camera in cameras) + 4)
    return Mosaic(cell, columns, math.ceil(len(rig) / columns), cameras)


def draw_mosaic(
    frame: Frame, posed: Posed | None, mosaic: Mosaic, title: str = "", estimate: Estimate | None = None,
    bones: Bones | None = None,
) -> AnyArray:  # fmt: skip
    """All views of one frame (H, W, 3) uint8, with the body over them, camera names, frame number and time.

    Where its estimate is given, a lost frame has a red border and its most doubtful limbs in red, and a camera that was
    not believed, was bumped, or whose picture came under another name says so.
    """
    frame = frame if estimate is None else frame.sorted_by(estimate.sources)
    canvas = np.full((mosaic.size[1], mosaic.size[0], 3), _INK, np.uint8)
    limbs = {} if posed is None else named_limbs(posed.body)
    lost = estimate is not None and _red(estimate, limbs)
    for k, (image, camera) in enumerate(zip(frame.images, mosaic.cameras, strict=True)):
        camera = camera if estimate is None or estimate.bumps is None else bumped(camera, estimate.bumps[k])
        resized = None if image is None else _resized(image, camera)
        view = _canvas(resized, camera) if posed is None else draw_overlay(resized, camera, posed, lost, bones=bones)
        x, y = mosaic.place(canvas, k, view)
        note = camera_in_words(estimate, k, image is not None)
        left_out = estimate is not None and k in estimate.left_out
        if left_out:
            cv2.rectangle(canvas, (x, y), (x + view.shape[1] - 1, y + view.shape[0] - 1), LOST, 3)
        _label(canvas, f"{camera.name}: {note}" if note else camera.name, (x + 8, y + 24), LOST if left_out else _PAPER)
    _label(canvas, title, (12, 27))
    _label(canvas, f"frame {frame.index}   {frame.time:.3f} s", (canvas.shape[1] - 12, 27), right=True)
    state = "no pose" if posed is None else "" if estimate is None else state_in_words(estimate, limbs)
    _label(canvas, state, (canvas.shape[1] - 260, 27), LOST, right=True)
    if estimate is not None and estimate.lost:
        cv2.rectangle(canvas, (0, 0), (canvas.shape[1] - 1, canvas.shape[0] - 1), LOST, 7)
    return canvas


def _red(estimate: Estimate, limbs: Mapping[str, Bool]) -> Bool | bool:
    """The segments (S,) that are drawn in red: those of doubtful limbs, all where nothing is known of limbs."""
    parts = estimate.part_probability
    names = () if parts is None else doubtful(limbs, parts)
    return estimate.lost and (np.any([limbs[name] for name in names], axis=0) if names else True)


def _resized(image: AnyArray, camera: Camera) -> AnyArray:
    mode = cv2.INTER_AREA if camera.size[0] < image.shape[1] else cv2.INTER_CUBIC
    return cv2.resize(image, camera.size, interpolation=mode)


def _label(canvas: AnyArray, text: str, at: tuple[int, int], colour: Colour = _PAPER, right: bool = False) -> None:
    """Text on a darkened strip; `at` is the lower left (or lower right) corner of its letters."""
    if not text:
        return
    text = _in_ascii(text.replace("°", " deg"))
    (width, height), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 0.6, 1)
    x, y = at[0] - width * right, at[1]
    strip = canvas[max(0, y - height - 6) : y + base + 3, max(0, x - 6) : x + width + 6]
    np.minimum(strip, _INK, out=strip, casting="unsafe")
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, 0.6, colour, 1, cv2.LINE_AA)


def _in_ascii(text: str) -> str:
    """Letters without their accents, and ? for others: OpenCV's own letters know no more."""
    plain = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(plain).encode("ascii", "replace").decode()


def overlay_video(
    path: Path | str, frames: Iterable[Frame], rig: Rig, estimates: Iterable[Estimate], body: Body, fps: float,
    title: str = "",
) -> Path:  # fmt: skip
    """Write an H.264 video of all views with the tracked body over them.

    A camera that dropped a frame shows the body alone, a frame without an estimate is shown bare. `rig` are the cameras
    of these images (`Rig.pinhole` when they have been rectified), at full size.
    """
    mosaic, bones = mosaic_for(rig), bones_of(body)
    by_index = {int(e.index): e for e in estimates}
    with VideoWriter(path, fps) as writer:
        for frame in frames:
            estimate = by_index.get(frame.index)
            posed = None if estimate is None else Posed(body, estimate.pose)
            writer.write(draw_mosaic(frame, posed, mosaic, title, estimate, bones))
    return Path(path)
