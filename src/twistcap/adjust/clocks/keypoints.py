"""The clock of keypoints against that of the images, by a body that was tracked in the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Posed
from twistcap.camera import Camera, Rig
from twistcap.errors import check
from twistcap.estimate import Keypoints
from twistcap.solve.blocks import PoseTrack

_WIDEST = 10.0  # frames that are tried, to both sides
_FINE = 0.1  # frames from one tried offset to the next
_BLOCKS = 8  # spans of time, each left out once for the standard deviation
_SMOOTH = 2.0  # frames, standard deviation
_WEIGHT = 0.9  # of the smoothing that must fall on known frames
_SCALE = 3.0  # px from which a difference counts less
_ROUNDS = 3  # of offset and likeness
_LIKENESSES = np.arange(0.0, 1.01, 0.05)


@dataclass(frozen=True)
class KeypointClock:
    """`offset`: keypoints of number j belong to frame ``j + offset``, and its standard deviation (frames)."""

    offset: float
    sigma: float


def keypoint_clock(
    body: Body, rig: Rig, track: PoseTrack, keypoints: Sequence[Keypoints], lags: Float
) -> KeypointClock:
    """By how many frames keypoints differ from the images that they were found in, which are numbered alike.

    The mean difference of each landmark in each camera does not count: a detector's joints are not the body's. What
    else they differ by changes slowly, with the pose, and would pass for an offset where a movement does not come back
    to where it began. So the part of each difference that the frame before foretells does not count either: an
    autoregression of order 1, fitted with the offset (Cochrane and Orcutt 1949,
    https://doi.org/10.1080/01621459.1949.10483290). Offsets are tried, and the best is made finer by a parabola. The
    standard deviation is the jackknife's.

    Args:
        body, rig: of the track; the cameras as calibrated, in whose pixels the keypoints are.
        track: poses at frames 0, 1, … as times.
        keypoints: of the same numbers.
        lags: (C, F) frames by which the image of each camera and number was taken after the time of the track's frame.

    Raises InputError for fewer than 24 frames, or keypoints that no offset brings together with the track.
    """
    check("keypoint clock", len(track.poses) >= 24, f"{len(track.poses)} frames are tracked; give at least 24")
    names = [n for n in keypoints[0].names if n in body.landmarks.names]
    own, theirs = ([list(of).index(n) for n in names] for of in (body.landmarks.names, keypoints[0].names))
    seen = np.stack([k.pixels[:, theirs] for k in keypoints])  # (F, C, L, 2)
    times = (track.times + lags).T
    shown = np.stack([[_pixels(body, track, c, t)[own] for c, t in zip(rig, row, strict=True)] for row in times])
    seen, shown = _smooth(seen), _smooth(shown)
    offset, likeness, costs = 0.0, 0.0, np.zeros(0)
    for _ in range(_ROUNDS):
        costs = np.array([_costs(_off(shown, seen, shift), likeness) for shift in _tried()])  # (S, F)
        offset = _best(costs)
        off = _off(shown, seen, offset)  # the fraction of it that is found again in the next frame has the least cost
        likeness = float(_LIKENESSES[np.argmin([np.nanmean(_costs(off, share)) for share in _LIKENESSES])])
    blocks = np.arange(len(seen)) * _BLOCKS // len(seen)
    left_out = np.array([_best(costs[:, blocks != b]) for b in range(_BLOCKS)])
    sigma = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((left_out - left_out.mean()) ** 2)))
    return KeypointClock(offset, max(sigma, 0.5 * _FINE / _BLOCKS))


def _pixels(body: Body, track: PoseTrack, camera: Camera, time: float) -> Float:
    """(L, 2) where a camera sees the landmarks at a time of the track."""
    return camera.project(Posed(body, track.at(time).pose).landmarks)[0]


def _smooth(pixels: Float) -> Float:
    """Over some frames: else a track that trembles fits better halfway between two frames. NaN where it was,
    and beside."""
    known = np.isfinite(pixels)
    summed = (np.where(known, pixels, 0.0), known.astype(float))
    sums, counts = (gaussian_filter1d(a, _SMOOTH, axis=0, mode="nearest") for a in summed)
    return np.where(known & (counts > _WEIGHT), sums / np.maximum(counts, 1e-9), np.nan)


def _tried() -> Float:
    return np.arange(-_WIDEST, _WIDEST + 0.5 * _FINE, _FINE)


def _off(shown: Float, seen: Float, shift: float) -> Float:
    """(F, C, L, 2) px by which keypoints differ from the track at ``number + shift``, each less its median over time.

    NaN where that is not known, and near both ends, so that the same numbers count at all offsets.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    margin, numbers, known = int(_WIDEST), np.arange(len(seen)), np.isfinite(shown)
    at = np.clip(numbers + shift, 0, len(seen) - 1)
    there = CubicSpline(numbers, _filled(shown, known))(at)  # a chord would smooth as well
    whole = np.floor(at).astype(int)
    there[~(known[whole] & known[np.minimum(whole + 1, len(seen) - 1)])] = np.nan  # behind a camera
    off = seen - there
    off[:margin], off[len(off) - margin :] = np.nan, np.nan
    inner = off[margin : len(off) - margin]
    known = np.isfinite(inner).all(axis=-1).sum(axis=0) >= 0.5 * len(inner)
    off[:, ~known] = np.nan
    return off - np.nan_to_num(np.nanmedian(np.where(known[None, ..., None], inner, 0.0), axis=0))


def _filled(shown: Float, known: Bool) -> Float:
    """The same with what is not known as in the frame before, or in the first that is."""
    latest = np.maximum.accumulate(np.where(known, np.arange(len(shown)).reshape(-1, 1, 1, 1), -1), axis=0)
    filled = np.take_along_axis(shown, np.where(latest < 0, known.argmax(axis=0), latest), axis=0)
    return np.nan_to_num(filled)


def _costs(off: Float, likeness: float) -> Float:
    """(F,) mean robust cost of differences (F, C, L, 2), less what the frame before foretells; NaN without any."""
    news = off[1:] - likeness * off[:-1]
    squares = np.sum(news * news, axis=-1) / _SCALE**2
    cost, finite = np.log1p(squares), np.isfinite(squares)
    counted = finite.sum(axis=(1, 2))
    mean = np.where(counted > 0, np.where(finite, cost, 0.0).sum(axis=(1, 2)) / np.maximum(counted, 1), np.nan)
    return np.concatenate([[np.nan], mean])


def _best(costs: Float) -> float:
    """Offset of the least cost, between those tried."""
    total = np.nanmean(costs[:, np.isfinite(costs).any(axis=0)], axis=1)
    k = int(np.argmin(total))
    check("keypoint clock", 0 < k < len(total) - 1, f"no offset within {_WIDEST:g} frames brings them together")
    before, here, after = total[k - 1 : k + 2]
    return float(_tried()[k] + 0.5 * _FINE * (before - after) / (before - 2.0 * here + after))
