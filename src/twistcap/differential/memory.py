"""What the tracker remembers of each view: surface points, how bright they were, and whether they moved as the body."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Body
from twistcap.differential.render import OrthographicView
from twistcap.differential.system import Samples
from twistcap.differential.view import ScaledView, State
from twistcap.render import SurfacePoints
from twistcap.terms.photometric import sample


def pyramid(image: Float32, levels: int, blur: float = 0.7) -> list[Float32]:
    """The image and smaller ones by factors of 2 (pixel centres at integers), each blurred a little; finest first."""
    out = [cv2.GaussianBlur(image, (0, 0), blur)]
    for _ in range(levels - 1):
        height, width = out[-1].shape
        even = out[-1][: height // 2 * 2, : width // 2 * 2]
        small = cv2.resize(cv2.GaussianBlur(even, (0, 0), 0.8), (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        out.append(cv2.GaussianBlur(small, (0, 0), blur))
    return out


def sampled(image: Float32, pixels: Float) -> tuple[Float, Float]:
    """Brightness (N,), NaN off the image, and its gradient (N, 2) at pixel positions (N, 2)."""
    x, y = pixels.astype(np.float32).T
    height, width = image.shape
    inside = (x >= 1) & (y >= 1) & (x < width - 2) & (y < height - 2)

    def at(dx: float, dy: float) -> Float:
        found = cv2.remap(image, (x + dx)[None], (y + dy)[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return found[0].astype(np.float64)

    gradient = 0.5 * np.stack([at(1, 0) - at(-1, 0), at(0, 1) - at(0, -1)], axis=1)
    return np.where(inside, at(0, 0), np.nan), gradient


@dataclass(frozen=True)
class Memory:
    """Surface points of one view after a frame.

    Attributes:
        samples: the points and their brightness, which follows the image slowly.
        trust: (N,) running support of each point.
        inside: (N,) px from the nearest rim in that frame.
        pixels: (N, 2) where they were in that frame.
        view: of that frame.
        pyramid: that frame's images, finest first.
        mask: (H, W) that frame's silhouette.
    """

    samples: Samples
    trust: Float
    inside: Float
    pixels: Float
    view: ScaledView
    pyramid: list[Float32]
    mask: Bool

    def at_level(self, level: int, which: Int) -> Samples:
        """Points `which` as a level of the pyramid saw them; the finest level gives what is remembered."""
        points = self.samples.points[which]
        if level == 0:
            return Samples(points, self.samples.value[which], self.samples.gradient[which])
        factor = 0.5**level
        return Samples(points, *sampled(self.pyramid[level], factor * self.pixels[which] + 0.5 * (factor - 1.0)))


def remember(
    body: Body, state: State, v: int, images: list[Float32], seen: OrthographicView, old: Memory | None,
    trust: Float | None, exposure: Float, spacing: int, update: float,
) -> Memory:  # fmt: skip
    """The memory of view `v` after a frame: old points still seen, brightness updated, and new ones between them.

    Args:
        images: the frame's pyramid.
        seen: the body there.
        old: memory before; None in the first frame.
        trust: (N,) support of the old points in this frame.
        exposure: (2,) how the frame's exposure differs from the memory's; what is remembered takes the frame's.
        spacing: px between points.
        update: share of the new brightness that an old point takes over.
    """
    taken = np.zeros((images[0].shape[0] // spacing + 1, images[0].shape[1] // spacing + 1), dtype=bool)
    rows, columns = np.nonzero(seen.mask[spacing // 2 :: spacing, spacing // 2 :: spacing])
    rows, columns = rows * spacing + spacing // 2, columns * spacing + spacing // 2
    kept: list[tuple[SurfacePoints, Float, Float, Float]] = []
    if old is not None and trust is not None and update < 1.0:
        kept.append(_carried(state, body, v, images[0], seen, old, trust, exposure, update, spacing, taken))
    free = ~taken[rows // spacing, columns // spacing]
    rows, columns = rows[free].astype(np.int32), columns[free].astype(np.int32)
    points = seen.surface_points(rows, columns)
    fresh = sampled(images[0], np.stack([columns, rows], axis=1).astype(float))
    kept.append((points, *fresh, np.full(len(points), 0.5)))
    joined = kept[0][0] if len(kept) == 1 else kept[0][0] + kept[1][0]
    value, gradient, trusted = (np.concatenate([part[i] for part in kept]) for i in (1, 2, 3))
    pixels = state.views[v].pixels(joined.at(state.posed(body)))
    known = np.isfinite(value)
    r, c = _clipped(pixels, seen.mask.shape)
    return Memory(
        Samples(joined[known], value[known], gradient[known]), trusted[known], seen.inside[r, c][known].astype(float),
        pixels[known], state.views[v], images, seen.mask,
    )  # fmt: skip


def _carried(
    state: State, body: Body, v: int, image: Float32, seen: OrthographicView, old: Memory, trust: Float,
    exposure: Float, update: float, spacing: int, taken: Bool,
) -> tuple[SurfacePoints, Float, Float, Float]:  # fmt: skip
    """Old points that are still seen, the most trusted in each cell."""
    visible, r, c = seen.visible(old.samples.points)
    visible &= trust > 0.2
    order = np.flatnonzero(visible)[np.argsort(-trust[visible], kind="stable")]
    cell = (r // spacing) * taken.shape[1] + c // spacing
    _, first = np.unique(cell[order], return_index=True)
    which = order[first].astype(np.int32)
    taken.ravel()[cell[which]] = True
    points = old.samples.points[which]
    now, slope = sampled(image, state.views[v].pixels(points.at(state.posed(body))))
    was, gradient = (1.0 + exposure[0]) * old.samples.value[which] + exposure[1], old.samples.gradient[which]
    return points, was + update * (now - was), gradient + update * (slope - gradient), trust[which]


def _clipped(pixels: Float, size: tuple[int, ...]) -> tuple[Int, Int]:
    x, y = np.rint(pixels).astype(np.int32).T
    return np.clip(y, 0, size[0] - 1), np.clip(x, 0, size[1] - 1)
