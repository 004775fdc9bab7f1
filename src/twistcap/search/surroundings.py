"""What a camera sees beside the body, and by what turn that differs from what it has seen before.

Three numbers, found by Gauss-Newton steps on small images, from coarse to fine (Lucas and Kanade, IJCAI 1981; Baker and
Matthews, IJCV 2004, doi:10.1023/B:VISI.0000011205.11775.fd).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from twistcap.arrays import Bool, Float, Float32
from twistcap.body import Posed
from twistcap.camera import Camera
from twistcap.camera.bump import after_both, still_shown, warped
from twistcap.render import render
from twistcap.search import Problem
from twistcap.search.backdrop import Backdrop, about, small_camera, small_features

_WIDTHS = (40, 80, 160, 400)  # px, of the levels
_ROLLS = 4  # turns about the optical axis that are tried in the coarsest, and `_STEPS` about the others
_STEPS = 9
_CLIP = 9.0  # most that one pixel says against a turn, in its variances
_DISTRUST = 2.0  # standard deviations from which on a pixel counts for little
_PRIOR = 0.05  # rad; where nothing tells of a turn about an axis, there is none
_ROUNDS, _STILL = 20, 3e-5  # steps at most, and rad from which on they go on
_ROUGH, _FEW = 60, 2  # px and steps, for a rough turn
_FLOOR = np.float32(1e-4)  # least variance of a pixel


@dataclass(frozen=True)
class Surroundings:
    """What a camera sees beside the body, and what it has seen there before.

    Attributes:
        camera: of the small images.
        backdrop: as it was learnt.
        features: (h, w, C) of the small image.
        beside: (h, w) pixels that do not show the body.
    """

    camera: Camera
    backdrop: Backdrop
    features: Float32
    beside: Bool

    @staticmethod
    def of(camera_index: int, backdrop: Backdrop, posed: Posed | None, problem: Problem) -> Surroundings | None:
        """Of a body in a frame, if anybody knows where it is; None where the camera has no image."""
        image = problem.frame.images[camera_index]
        if image is None:
            return None
        place = (problem.start if posed is None else posed.pose).root[:3, 3]
        camera = small_camera(problem.rig[camera_index], backdrop, place)
        features, beside = (
            small_features(image, camera.size, problem.channels),
            still_shown(camera, problem.bumps[camera_index]),
        )
        if posed is not None:
            seen = render(posed, camera)
            beside &= ~about(seen.part >= 0, seen.px_per_m)
        return Surroundings(camera, backdrop, features, beside)

    def turn(self, farthest: float) -> Float:
        """The turn (3,) of the camera's own frame after which its background looks as in the image; it is looked for up
        to `farthest` rad about each axis.
        """
        coarse = self._level(_WIDTHS[0])
        rolls, turns = (np.linspace(-farthest, farthest, n) for n in (_ROLLS, _STEPS))
        starts = [np.zeros(3), *(np.array(w) for w in product(turns, turns, rolls))]
        turn = coarse.settled(min(starts, key=coarse.cost))
        for width in (w for w in _WIDTHS[1:] if w < 2 * self.features.shape[1]):
            turn = self._level(width).settled(turn)
        return turn

    def rough_turn(self) -> tuple[Float, float]:
        """The same of a turn by few pixels, roughly, and what `remaining` says of it there."""
        level = self._level(_ROUGH)
        turn = level.stepped(np.zeros(3), _FEW)
        return turn, level.remaining(turn)

    def small_turn(self) -> Float:
        """The same of a turn by few pixels."""
        turn = np.zeros(3)
        for width in _WIDTHS[1:3]:
            turn = self._level(width).settled(turn)
        return turn

    def remaining(self, turn: Float) -> float:
        """How badly the background agrees after a turn, over how badly it does without."""
        return self._level(_WIDTHS[2]).remaining(turn)

    def fitting(self, turn: Float) -> tuple[float, float]:
        """Fraction of the pixels beside the body that fit the background after a turn, and what fraction of the image
        they are.
        """
        mean, variance = self.backdrop.moments
        compared = self.backdrop.known & (warped(self.beside.astype(np.float32), self.camera.K, turn) > 0.99)
        back = warped(self.features, self.camera.K, turn).reshape(mean.shape)
        distance = ((back - mean) ** 2 / variance).sum(axis=2)[compared]
        fits = distance < 4.0 * mean.shape[2]
        return (float(fits.mean()) if fits.size else 0.0), float(compared.mean())

    def _level(self, width: int) -> _Level:
        """Brightness alone, in images of a width that is no more than their own."""
        w, h = self.camera.size
        width = min(width, w)
        height = max(1, round(h * width / w))

        def small(image: Float32) -> Float32:
            return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.float32)

        known = self.backdrop.known.astype(np.float32)
        share = small(known)
        mean, variance = (
            small(moment[..., 0] * known) / np.maximum(share, 1e-3).astype(np.float32)
            for moment in self.backdrop.moments
        )
        beside = np.asarray(small(self.beside.astype(np.float32)) > 0.9, np.float32)
        return _Level(
            self.camera.resized((width, height)).K,
            mean,
            np.maximum(variance, _FLOOR),
            share > 0.5,
            small(self.features[..., 0]),
            beside,
        )


@dataclass(frozen=True)
class _Level:
    """The background and the image, smaller: brightness alone, all (h, w) but the camera's matrix (3, 3)."""

    K: Float
    mean: Float32
    variance: Float32
    known: Bool
    image: Float32
    beside: Float32

    def compared(self, turn: Float) -> tuple[Float32, Bool]:
        """(h, w) by how much the image is brighter than the background after a turn, and where both are known."""
        shown = np.asarray(self.known & (warped(self.beside, self.K, turn) > 0.99), np.bool_)
        return np.asarray(warped(self.image, self.K, turn) - self.mean, np.float32), shown

    def cost(self, turn: Float) -> float:
        """How badly they agree on the mean, and how unlikely a turn is."""
        off, shown = self.compared(turn)
        if shown.mean() < 0.2:
            return np.inf
        squares = np.minimum(off[shown] ** 2 / self.variance[shown], _CLIP)
        return float(squares.mean()) + 0.01 * float(turn @ turn) / _PRIOR**2

    def remaining(self, turn: Float) -> float:
        """Cost after a turn over that without; 1 where nothing can be compared."""
        before, after = self.cost(np.zeros(3)), self.cost(turn)
        return after / before if np.isfinite(after) and before > 0.0 else 1.0

    def settled(self, turn: Float) -> Float:
        """The turn after Gauss-Newton steps from there; no farther than it agrees better."""
        return min((self.stepped(turn, _ROUNDS), turn), key=self.cost)

    def stepped(self, turn: Float, rounds: int) -> Float:
        """The turn after some Gauss-Newton steps, under any exposure; as it is where too little can be compared."""
        jacobian, start, prior = self._jacobian(), turn, np.diag([*np.full(3, 1.0 / _PRIOR**2), 1e-6, 1e-6])
        for _ in range(rounds):
            off, shown = self.compared(turn)
            if shown.mean() < 0.2:
                return start
            residual, variance, J = off[shown].astype(float), self.variance[shown].astype(float), jacobian[shown]
            rest = residual - np.median(residual)
            weight = 1.0 / variance / (1.0 + rest**2 / variance / _DISTRUST**2) ** 2
            pull = J.T @ (weight * residual) + prior @ [*turn, 0.0, 0.0]
            step = -np.linalg.solve((J * weight[:, None]).T @ J + prior, pull)[:3]
            turn = after_both(turn, step)
            if np.linalg.norm(step) < _STILL:
                break
        return turn

    def _jacobian(self) -> Float:
        """(h, w, 5) by how much the background's brightness in each pixel grows with a turn, an offset and a gain."""
        gy, gx = np.gradient(self.mean)
        (fx, fy), (cx, cy) = np.diag(self.K)[:2], self.K[:2, 2]
        y, x = np.mgrid[: self.mean.shape[0], : self.mean.shape[1]]
        u, v = (x - cx) / fx, (y - cy) / fy
        across, down = fx * gx, fy * gy
        by_turn = -across * u * v - down * (1.0 + v * v), across * (1.0 + u * u) + down * u * v, down * u - across * v
        return np.stack([*by_turn, np.ones_like(gx), self.mean], axis=-1).astype(float)
