"""What is remembered of a body's brightness in one view: surface points, their brightness, and whether it moves along.

The one memory of brightness: the brightness cue follows a few hundred textured points under a fine blur, the
differential tracker a point in every cell of a narrow grid, at all levels of a pyramid and with colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.camera.projection import projected
from twistcap.cues.view import Picture
from twistcap.render import RenderedView, SurfacePoints
from twistcap.terms.photometric import EXPOSURE, Samples, sampled

_OF_POINTS = ("normal", "value", "gradient", "trust", "inside", "missed", "pixels")
_RIM = 2  # px from the image's border, and from the body's rims, that the most textured points keep


@dataclass(frozen=True)
class Memory:
    """Brightness of N surface points in one view, as past frames showed it.

    Attributes:
        points: places on the surface.
        normal: (N, 3) unit outward normals there, in the rest pose of the points' parts.
        value: (N, L, C) brightness at L levels in C channels, which follows the image slowly.
        gradient: (N, L, C, 2) image gradient there, 1/px of the level.
        trust: (N,) running probability that the image moves with the body there.
        inside: (N,) px from the nearest rim when it was last seen; infinite where points keep off rims.
        missed: (N,) frames since it was last seen.
        pixels: (N, 2) where the points were in the last frame.
        picture: the last frame's, where other blurs are read when they are wanted.
        mask: (H, W) silhouette in that frame.
    """

    points: SurfacePoints
    normal: Float
    value: Float
    gradient: Float
    trust: Float
    inside: Float
    missed: Int
    pixels: Float
    picture: Picture
    mask: Bool

    def samples(self, level: int = 0, which: Int | None = None) -> tuple[Samples, ...]:
        """All points, or those of some numbers (M,), as each channel of a level shows them."""
        points, value, gradient = self.points, self.value[:, level], self.gradient[:, level]
        if which is not None:
            points, value, gradient = points[which], value[which], gradient[which]
        pick = np.ascontiguousarray
        return tuple(Samples(points, pick(value[:, c]), pick(gradient[:, c])) for c in range(value.shape[1]))

    def blurred(self, sigma: float) -> Samples:
        """The points as the last frame's grey has them under a Gaussian of `sigma` px."""
        return Samples(self.points, *sampled(self.picture.blurred(sigma), self.pixels))

    def lit(self, light: Float) -> Memory:
        """The points with their brightness times a factor (N,)."""
        by_point = light[:, None, None]
        return replace(self, value=self.value * by_point, gradient=self.gradient * by_point[..., None])

    def of(self, which: Int | Bool) -> Memory:
        """Some of the points."""
        return replace(self, points=self.points[which], **{name: getattr(self, name)[which] for name in _OF_POINTS})

    def __add__(self, other: Memory) -> Memory:
        """The points of both; all else as here."""
        both = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in _OF_POINTS}
        return replace(self, points=self.points + other.points, **both)


@dataclass(frozen=True)
class Retention:
    """How memory is kept.

    Attributes:
        cell: px, side of the cells of a grid, each of which holds one point that is seen.
        choice: of new points in cells without one: the "strongest", most textured, off all rims, or the "middle".
        update: fraction of the new brightness that a point takes over in each frame.
        tolerance: m that a point may lie behind the rendered surface and still count as seen.
        jump: difference of brightness beyond which a point is given up.
        trust: of new points.
        least_trust: up to which a point that is seen is given up.
        trusted_first: whether of several points in a cell the one of most trust stays; otherwise the oldest does.
        hidden: frames that points of more than half trust are remembered while something hides them.
    """

    cell: int
    choice: Literal["strongest", "middle"] = "strongest"
    update: float = 0.2
    tolerance: float = 0.012
    jump: float = np.inf
    trust: float = 1.0
    least_trust: float = -1.0
    trusted_first: bool = False
    hidden: int = 0

    @property
    def border(self) -> int:
        """Px about the image where no cell lies."""
        return _RIM if self.choice == "strongest" else 0


@dataclass(frozen=True)
class Look:
    """One view of a frame that is settled.

    Attributes:
        picture: its image.
        levels: (C, H, W) of the image, each half the size of the one before.
        seen: the rendered body, which says what is visible.
        posed: the body settled since; it places the points.
        exposure: (2,) how grey's gain and offset differ from those of what is remembered.
    """

    picture: Picture
    levels: Sequence[Float32]
    seen: RenderedView
    posed: Posed
    exposure: Float = field(default_factory=lambda: np.zeros(EXPOSURE))

    def brightness(self, pixels: Float) -> tuple[Float, Float]:
        """(N, L, C) values, NaN off the image, and (N, L, C, 2) gradients at pixels (N, 2) of the finest level."""
        value = np.empty((len(pixels), len(self.levels), len(self.levels[0])))
        gradient = np.empty((*value.shape, 2))
        for k, level in enumerate(self.levels):
            value[:, k], gradient[:, k] = sampled_channels(level, level_pixels(pixels, k))
        return value, gradient

    def exposed(self, value: Float) -> Float:
        """What is remembered (N, L, C) under this frame's exposure."""
        out = value.copy()
        out[..., 0] = (1.0 + self.exposure[0]) * value[..., 0] + self.exposure[1]
        return out


def level_pixels(pixels: Float, level: int) -> Float:
    """Pixels (N, 2) of the finest level in the image of another."""
    factor = 0.5**level
    return factor * pixels + 0.5 * (factor - 1.0)


def sampled_channels(image: Float32, pixels: Float) -> tuple[Float, Float]:
    """Values (N, C), NaN off the image (C, H, W), and their gradients (N, C, 2) at pixels (N, 2)."""
    value, gradient = np.empty((len(pixels), len(image))), np.empty((len(pixels), len(image), 2))
    for c, channel in enumerate(image):
        value[:, c], gradient[:, c] = sampled(channel, pixels)
    return value, gradient


def remember(look: Look, memory: Memory | None, rule: Retention, fresh: bool = True) -> Memory:
    """Memory after a frame: points still seen, brought up to date, some of those hidden, and `fresh` ones between them.

    Brightness that follows the image slowly keeps the track from creeping along the surface.
    """
    occupied = empty_grid(look.seen.mask.shape, rule.cell)
    kept = None if memory is None else _kept(look, memory, rule, occupied)
    if kept is not None and not fresh:
        return kept
    new = _fresh(look, rule, occupied)
    return new if kept is None else kept + new


def empty_grid(shape: tuple[int, ...], cell: int) -> Bool:
    """Cells of an image (H, W), none of which is occupied."""
    return np.zeros((shape[0] // cell + 1, shape[1] // cell + 1), dtype=np.bool_)


def _kept(look: Look, memory: Memory, rule: Retention, occupied: Bool) -> Memory:
    """Points that are seen, one in each cell of the grid, which is filled in; and those now hidden."""
    visible, pixels = look.seen.visible(memory.points, rule.tolerance, look.posed)
    now, slope = look.brightness(pixels)
    was, trust = look.exposed(memory.value), memory.trust
    order = still_alike(was, now, visible & (trust > rule.least_trust), rule.jump)
    if rule.trusted_first:
        order = order[np.argsort(-trust[order], kind="stable")]
    which = first_in_cells(pixels, order, rule.cell, rule.border, occupied)
    if not rule.trusted_first:
        which = np.sort(which)
    at = np.rint(pixels[which]).astype(np.int32)
    shown = Memory(
        memory.points[which], memory.normal[which], followed(was, now, which, rule.update),
        followed(memory.gradient, slope, which, rule.update), trust[which], _inside(look, rule, at[:, 1], at[:, 0]),
        np.zeros(len(which), np.int32), pixels[which], look.picture, look.seen.mask,
    )  # fmt: skip
    if rule.hidden == 0:
        return shown
    hidden = np.flatnonzero(~visible & (trust > 0.5) & (memory.missed < rule.hidden)).astype(np.int32)
    hidden = hidden[np.argsort(memory.missed[hidden], kind="stable")][: max(len(which), 1)]
    aged = replace(memory, pixels=pixels, value=was, missed=memory.missed + np.int32(1))
    return shown + aged.of(hidden) if len(hidden) else shown


def _fresh(look: Look, rule: Retention, occupied: Bool) -> Memory:
    """New points in the cells that are not occupied, those of them that lie in the image."""
    seen = look.seen
    if rule.choice == "middle":
        rows, columns = middles_of_cells(seen.mask, rule.cell, occupied)
    else:
        rows, columns = strongest_in_cells(
            look.picture.grey, seen.nearness_image, seen.camera.inverse_depth, rule.cell, occupied
        )
    points, pixels = seen.surface_points(rows, columns), np.stack([columns, rows], axis=1).astype(float)
    if look.posed is not seen.posed:
        pixels, _ = projected(seen.camera, points.at(look.posed))
    N = len(points)
    turns = seen.posed.segment_transforms[points.part, :3, :3]
    normal = np.einsum("nji,nj->ni", turns, seen.surface_normals(rows, columns))
    new = Memory(
        points, normal, *look.brightness(pixels), np.full(N, rule.trust), _inside(look, rule, rows, columns),
        np.zeros(N, np.int32), pixels, look.picture, seen.mask,
    )  # fmt: skip
    known = np.asarray(np.isfinite(new.value).all(axis=(1, 2)), np.bool_)
    return new if known.all() else new.of(known)


def _inside(look: Look, rule: Retention, rows: Int, columns: Int) -> Float:
    if rule.choice == "strongest":
        return np.full(len(rows), np.inf)
    return look.seen.inside[rows, columns].astype(np.float64)


@njit(cache=True, nogil=True)
def still_alike(was: Float, now: Float, candidates: Bool, jump: float) -> Int:
    """(M,) numbers of the candidates (N,) that differ from before, (N, L, C), by less than `jump` in all values."""
    out, count = np.empty(len(was), dtype=np.int32), 0
    before, after = was.reshape(len(was), -1), now.reshape(len(was), -1)
    for n in range(len(was)):
        alike = candidates[n]
        for k in range(before.shape[1]):
            alike &= abs(after[n, k] - before[n, k]) < jump  # not so where it left the image
        out[count] = n
        count += alike
    return out[:count]


@njit(cache=True, nogil=True)
def followed(was: Float, now: Float, which: Int, update: float) -> Float:
    """(M, ...) values that some points (M,) of all (N, ...) take: from the old towards the new ones by a fraction."""
    out = np.empty((len(which), *was.shape[1:]))
    before, after, values = was.reshape(len(was), -1), now.reshape(len(was), -1), out.reshape(len(which), -1)
    for m in range(len(which)):
        for k in range(before.shape[1]):
            value = before[which[m], k]
            values[m, k] = value + update * (after[which[m], k] - value)
    return out


@njit(cache=True, nogil=True)
def first_in_cells(pixels: Float, order: Int, cell: int, border: int, occupied: Bool) -> Int:
    """Of points at `pixels` (N, 2), taken in an order (M,), the first in each cell of the grid, which is filled in.

    Returns:
        (K,) numbers of those points, cell by cell.
    """
    first = np.full(occupied.shape, -1, dtype=np.int32)
    for n in order:
        row, column = int(pixels[n, 1] + 0.5), int(pixels[n, 0] + 0.5)
        if row < border or column < border:
            continue
        r, c = (row - border) // cell, (column - border) // cell
        if not occupied[r, c]:
            occupied[r, c] = True
            first[r, c] = n
    out = first.reshape(-1)
    return out[out >= 0]


def middles_of_cells(mask: Bool, cell: int, occupied: Bool) -> tuple[Int, Int]:
    """Rows and columns of body pixels in the middles of the cells that are not occupied."""
    rows, columns = np.nonzero(mask[cell // 2 :: cell, cell // 2 :: cell])
    free = ~occupied[rows, columns]
    rows, columns = ((i[free] * cell + cell // 2).astype(np.int32) for i in (rows, columns))
    return rows, columns


@njit(cache=True, nogil=True)
def strongest_in_cells(grey: Float32, nearness: Float32, inverse: bool, cell: int, occupied: Bool) -> tuple[Int, Int]:
    """Rows and columns of body pixels, the most textured of each cell that is not occupied, none at a rim."""
    height, width = grey.shape
    best = np.zeros(occupied.shape, dtype=np.float32)
    best_row, best_column = np.empty(best.shape, dtype=np.int32), np.empty(best.shape, dtype=np.int32)
    cell_of = (np.arange(width) - _RIM) // cell  # divisions are slow
    for r in range(_RIM, height - _RIM):
        i = (r - _RIM) // cell
        for c in range(_RIM, width - _RIM):
            if nearness[r, c] == 0.0:
                continue
            j = cell_of[c]
            if occupied[i, j]:
                continue
            gx, gy = grey[r, c + 1] - grey[r, c - 1], grey[r + 1, c] - grey[r - 1, c]
            strength = np.float32(1e-9) + gx * gx + gy * gy
            if strength > best[i, j] and not _at_rim(nearness, inverse, r, c):
                best[i, j], best_row[i, j], best_column[i, j] = strength, r, c
    rows, columns = np.empty(best.size, dtype=np.int32), np.empty(best.size, dtype=np.int32)
    count = 0
    for i, j in np.ndindex(occupied.shape):
        if best[i, j] > 0.0:
            rows[count], columns[count] = best_row[i, j], best_column[i, j]
            count += 1
    return rows[:count], columns[:count]


@njit(cache=True, nogil=True, inline="always")
def _at_rim(nearness: Float32, inverse: bool, r: int, c: int) -> bool:
    """Whether the body ends, or its depth jumps by 4 cm, two pixels off."""
    w = nearness[r, c]
    for dr, dc in ((-_RIM, 0), (_RIM, 0), (0, -_RIM), (0, _RIM)):
        other = nearness[r + dr, c + dc]
        if other == 0.0 or abs(w - other) > (0.04 * w * other if inverse else 0.04):
            return True
    return False


def still_alike_reference(was: Float, now: Float, candidates: Bool, jump: float) -> Int:
    """Readable twin of `still_alike`."""
    return np.flatnonzero(candidates & (np.abs(now - was) < jump).all(axis=(1, 2))).astype(np.int32)


def followed_reference(was: Float, now: Float, which: Int, update: float) -> Float:
    """Readable twin of `followed`."""
    return was[which] + update * (now[which] - was[which])


def first_in_cells_reference(pixels: Float, order: Int, cell: int, border: int, occupied: Bool) -> Int:
    """Readable twin of `first_in_cells`."""
    places, found = np.floor(pixels + 0.5).astype(int) - border, dict[tuple[int, int], int]()
    for n in order:
        column, row = places[n]
        place = int(row) // cell, int(column) // cell
        if min(row, column) >= 0 and not occupied[place]:
            occupied[place], found[place] = True, int(n)
    return np.array([found[place] for place in sorted(found)], np.int32)


def strongest_in_cells_reference(
    grey: Float32, nearness: Float32, inverse: bool, cell: int, occupied: Bool
) -> tuple[Int, Int]:
    """Readable twin of `strongest_in_cells`."""
    strength = np.full_like(grey, 1e-9)
    strength[1:-1, 1:-1] += (grey[1:-1, 2:] - grey[1:-1, :-2]) ** 2 + (grey[2:, 1:-1] - grey[:-2, 1:-1]) ** 2
    for dr, dc in ((0, 0), (-_RIM, 0), (_RIM, 0), (0, -_RIM), (0, _RIM)):
        other = np.roll(nearness, (dr, dc), axis=(0, 1))
        jump = 0.04 * nearness * other if inverse else 0.04
        strength[(other == 0.0) | (np.abs(nearness - other) > jump)] = 0.0
    inner, found = strength[_RIM:-_RIM, _RIM:-_RIM], list[tuple[int, int]]()
    for i, j in np.argwhere(~occupied):
        patch = inner[i * cell : (i + 1) * cell, j * cell : (j + 1) * cell]
        if patch.size and patch.max() > 0.0:
            r, c = np.unravel_index(np.argmax(patch), patch.shape)
            found.append((int(i * cell + r + _RIM), int(j * cell + c + _RIM)))
    rows, columns = np.array(found, np.int32).reshape(-1, 2).T
    return rows, columns
