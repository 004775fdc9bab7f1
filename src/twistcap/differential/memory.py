"""What the tracker remembers of each view: surface points, how bright they were, and whether they moved as the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twistcap._typing import AnyArray, Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.camera import ScaledView
from twistcap.render import RenderedView, SurfacePoints
from twistcap.terms import photometric
from twistcap.terms.photometric import Samples

_OPPONENT = np.array([[0.299, 0.587, 0.114], [0.707, -0.707, 0.0], [0.408, 0.408, -0.816]], dtype=np.float32)

_BEHIND = 0.02  # m that a point may lie behind the rendered surface and still count as seen


def channels(image: AnyArray, colour: bool = True) -> Float32:
    """(C, H, W) float32: grey in [0, 1], and for RGB images two opponent colours, red to green and yellow to blue.

    Args:
        image: (H, W) or (H, W, 3), uint8 or in [0, 1].
        colour: False leaves grey alone.
    """
    values = image.astype(np.float32) / np.float32(255.0 if image.dtype == np.uint8 else 1.0)
    if values.ndim == 2:
        return values[None]
    mixed = np.moveaxis(values, -1, 0)
    return np.einsum("ck,khw->chw", _OPPONENT if colour else _OPPONENT[:1], mixed).astype(np.float32)


def pyramid(image: Float32, levels: int, blur: float = 0.7) -> list[Float32]:
    """Images (C, H, W) by factors of 2 (pixel centres at integers), each blurred a little; finest first."""
    each = [_pyramid(channel, levels, blur) for channel in image]
    return [np.stack([channel[k] for channel in each]) for k in range(levels)]


def _pyramid(image: Float32, levels: int, blur: float) -> list[Float32]:
    out: list[Float32] = [_blurred(image, blur)]
    for _ in range(levels - 1):
        height, width = out[-1].shape
        even = out[-1][: height // 2 * 2, : width // 2 * 2]
        small = cv2.resize(_blurred(even, 0.8), (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        out.append(_blurred(np.asarray(small, np.float32), blur))
    return out


def _blurred(image: Float32, sigma: float) -> Float32:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32)


def sampled(image: Float32, pixels: Float) -> tuple[Float, Float]:
    """Values (N, C), NaN off the image (C, H, W), and their gradients (N, C, 2) at pixel positions (N, 2)."""
    found = [photometric.sampled(channel, pixels) for channel in image]
    return np.stack([f[0] for f in found], axis=1), np.stack([f[1] for f in found], axis=1)


@dataclass(frozen=True)
class Memory:
    """Surface points of one view after a frame.

    Attributes:
        points: N places on the surface.
        value: (N, L, C) each channel at each level of the pyramid, which follows the image slowly.
        gradient: (N, L, C, 2) image gradient there, 1/px of the level.
        trust: (N,) running support of each point.
        inside: (N,) px from the nearest rim when it was last seen.
        missed: (N,) frames since it was last seen.
        pixels: (N, 2) where the points were in that frame.
        pyramid: that frame's images, finest first.
        mask: (H, W) that frame's silhouette.
    """

    points: SurfacePoints
    value: Float
    gradient: Float
    trust: Float
    inside: Float
    missed: Int
    pixels: Float
    pyramid: Sequence[Float32]
    mask: Bool

    def at_level(self, level: int, which: Int) -> tuple[Samples, ...]:
        """Points `which` as each channel of a level of the pyramid shows them."""
        points = self.points[which]
        value, gradient = self.value[which, level], self.gradient[which, level]
        pick = np.ascontiguousarray
        return tuple(Samples(points, pick(value[:, c]), pick(gradient[:, c])) for c in range(value.shape[1]))

    def level_pixels(self, level: int, which: Int) -> Float:
        """(M, 2) where points were in the image of a level."""
        factor = 0.5**level
        return factor * np.take(self.pixels, which, axis=0) + 0.5 * (factor - 1.0)


@dataclass(frozen=True)
class Look:
    """One view of a frame whose state is settled.

    Attributes:
        posed, seen: the body there.
        view: the camera.
        pyramid: the images.
        exposure: (2,) how the exposure differs from that of what is remembered.
    """

    posed: Posed
    seen: RenderedView
    view: ScaledView
    pyramid: Sequence[Float32]
    exposure: Float

    def pixels(self, points: SurfacePoints) -> Float:
        return self.view.pixels(points.at(self.posed))

    def brightness(self, pixels: Float) -> tuple[Float, Float]:
        """(N, L, C) and (N, L, C, 2) values and gradients at every level."""
        found = [sampled(im, 0.5**k * pixels + 0.5 * (0.5**k - 1.0)) for k, im in enumerate(self.pyramid)]
        return np.stack([f[0] for f in found], axis=1), np.stack([f[1] for f in found], axis=1)


@dataclass(frozen=True)
class Retention:
    """How memory is kept.

    Attributes:
        spacing: px between points.
        update: share of the new brightness that an old point takes over; 1 remembers nothing of the frames before.
        hidden: frames that a point is remembered while something hides it.
    """

    spacing: int = 2
    update: float = 0.2
    hidden: int = 30


def remember(look: Look, old: Memory | None, trust: Float | None, how: Retention) -> Memory:
    """The memory of a view after a frame: old points, brightness of those seen updated, and new ones between them.

    Args:
        look: the frame.
        old: memory before; None in the first frame.
        trust: (N,) support of the old points, this frame's included.
        how: settings.
    """
    size, spacing = look.seen.mask.shape, how.spacing
    taken = np.zeros((size[0] // spacing + 1, size[1] // spacing + 1), dtype=bool)
    parts: list[Memory] = []
    if old is not None and trust is not None and how.update < 1.0:
        parts += _kept(look, old, trust, how, taken)
    rows, columns = np.nonzero(look.seen.mask[spacing // 2 :: spacing, spacing // 2 :: spacing])
    free = ~taken[rows, columns]
    rows, columns = (i[free].astype(np.int32) * spacing + spacing // 2 for i in (rows, columns))
    points = look.seen.surface_points(rows.astype(np.int32), columns.astype(np.int32))
    pixels = np.stack([columns, rows], axis=1).astype(float)
    none = np.zeros(len(points), np.int32)
    inside = look.seen.inside[rows, columns].astype(float)
    parts.append(
        Memory(
            points,
            *look.brightness(pixels),
            np.full(len(points), 0.5),
            inside,
            none,
            pixels,
            look.pyramid,
            look.seen.mask,
        )
    )
    return _joined(parts)


def _kept(look: Look, old: Memory, trust: Float, how: Retention, taken: Bool) -> list[Memory]:
    """Old points that are seen, the most trusted in each cell of the grid, which is filled in; and those now hidden."""
    visible, pixels = look.seen.visible(old.points, _BEHIND)
    c, r = np.rint(np.where(visible[:, None], pixels, 0.0)).astype(np.int32).T
    seen = np.flatnonzero(visible & (trust > 0.2))
    order = seen[np.argsort(-trust[seen], kind="stable")]
    cell = (r // how.spacing) * taken.shape[1] + c // how.spacing
    _, first = np.unique(cell[order], return_index=True)
    which = order[first].astype(np.int32)
    taken.ravel()[cell[which]] = True
    hidden = np.flatnonzero(~visible & (trust > 0.5) & (old.missed < how.hidden)).astype(np.int32)
    hidden = hidden[np.argsort(old.missed[hidden], kind="stable")][: max(len(which), 1)]
    now, slope = look.brightness(look.pixels(old.points[which]))
    was, gradient = _exposed(look, old.value[which]), old.gradient[which]
    fresh = was + how.update * (now - was), gradient + how.update * (slope - gradient)
    inside = look.seen.inside[r[which], c[which]].astype(float)
    shown = _memory(look, old, which, trust, fresh, inside, np.zeros(len(which), np.int32))
    still = _exposed(look, old.value[hidden]), old.gradient[hidden]
    return [shown, _memory(look, old, hidden, trust, still, old.inside[hidden], old.missed[hidden] + 1)]


def _exposed(look: Look, value: Float) -> Float:
    """What is remembered (N, L, C) under the frame's exposure, which only grey has."""
    out = value.copy()
    out[..., 0] = (1.0 + look.exposure[0]) * value[..., 0] + look.exposure[1]
    return out


def _memory(
    look: Look, old: Memory, which: Int, trust: Float, brightness: tuple[Float, Float], inside: Float, missed: Int
) -> Memory:
    points = old.points[which]
    return Memory(points, *brightness, trust[which], inside, missed, look.pixels(points), look.pyramid, look.seen.mask)


def _joined(parts: Sequence[Memory]) -> Memory:
    """All points of several memories of one frame that have a brightness."""
    points = parts[0].points
    for part in parts[1:]:
        points = points + part.points
    value, gradient, trust, inside, missed, pixels = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("value", "gradient", "trust", "inside", "missed", "pixels")
    )
    known = np.asarray(np.isfinite(value).all(axis=(1, 2)), np.bool_)
    last = parts[-1]
    return Memory(
        points[known], value[known], gradient[known], trust[known], inside[known], missed[known].astype(np.int32),
        pixels[known], last.pyramid, last.mask,
    )  # fmt: skip
