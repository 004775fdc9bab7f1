"""What the images say of poses and shape together: rows by the steps of one frame's pose, another's, and the shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Float, Int
from twistcap.body import Posed
from twistcap.body.shape import RestMotion
from twistcap.cues.brightness import Brightness, empty_grid, strongest_in_cells, visible_points
from twistcap.cues.evidence import ContourEvidence
from twistcap.cues.view import View
from twistcap.refine.system import Arrow
from twistcap.render import RenderedView, SurfacePoints
from twistcap.terms import PointTerm
from twistcap.terms.photometric import EXPOSURE, Samples
from twistcap.terms.robust import weighted_cauchy


@dataclass(frozen=True)
class Sight:
    """One camera's view of one frame, the body rendered into it, and points whose brightness is followed on."""

    view: View
    seen: RenderedView
    points: SurfacePoints


@dataclass(frozen=True)
class Instant:
    """A frame as the refinement looks at it: place in the sequence, posed body, and what each camera shows."""

    number: int
    posed: Posed
    sights: dict[int, Sight]


def followed_points(view: View, seen: RenderedView, count: int) -> SurfacePoints:
    """About so many points of the visible surface, the most textured of each cell of a grid, none at a rim."""
    return seen.surface_points(*strongest_in_cells(view.grey, seen.inverse_depth_image, *empty_grid(view, seen, count)))


def row_jacobian(posed: Posed, motion: RestMotion, points: SurfacePoints, gradient: Float) -> tuple[Float, Float]:
    """Derivatives of residuals by the pose step (N, 6 + J) and by the shape (N, K).

    Args:
        gradient: (N, 3) of each residual by its world point.
    """
    by_segment = segment_rows(posed.segment_transforms, points.segments, points.weights, points.local, gradient)
    by_shape = motion.rates(posed, points.segments, points.weights, points.local, gradient)
    return by_segment @ posed.projector, by_shape


@njit(cache=True, nogil=True)
def segment_rows(transforms: Float, segments: Int, weights: Float, local: Float, gradient: Float) -> Float:
    """(N, 6 S) derivative of residuals by the twist of every segment: ``w [x × g, g]``, x as the segment carries it."""
    out = np.zeros((len(local), 6 * len(transforms)))
    for n in range(len(local)):
        g0, g1, g2 = gradient[n, 0], gradient[n, 1], gradient[n, 2]
        for k in range(segments.shape[1]):
            w, T, at = weights[n, k], transforms[segments[n, k]], 6 * segments[n, k]
            if w == 0.0:
                continue
            x = T[0, 0] * local[n, 0] + T[0, 1] * local[n, 1] + T[0, 2] * local[n, 2] + T[0, 3]
            y = T[1, 0] * local[n, 0] + T[1, 1] * local[n, 1] + T[1, 2] * local[n, 2] + T[1, 3]
            z = T[2, 0] * local[n, 0] + T[2, 1] * local[n, 1] + T[2, 2] * local[n, 2] + T[2, 3]
            out[n, at] += w * (y * g2 - z * g1)
            out[n, at + 1] += w * (z * g0 - x * g2)
            out[n, at + 2] += w * (x * g1 - y * g0)
            out[n, at + 3] += w * g0
            out[n, at + 4] += w * g1
            out[n, at + 5] += w * g2
    return out


def segment_rows_reference(transforms: Float, segments: Int, weights: Float, local: Float, gradient: Float) -> Float:
    """Readable twin of `segment_rows`."""
    out = np.zeros((len(local), len(transforms), 6))
    for n in range(len(local)):
        for s, w in zip(segments[n], weights[n], strict=True):
            x = transforms[s, :3] @ np.append(local[n], 1.0)
            out[n, s] += w * np.concatenate([np.cross(x, gradient[n]), gradient[n]])
    return out.reshape(len(local), -1)


def add_contour(system: Arrow, instant: Instant, motion: RestMotion, found: ContourEvidence, share: float) -> float:
    """Add a view's contour to the equations; its energy."""
    assert isinstance(found.term, PointTerm)
    energy, points, rows = found.term.rows(instant.posed)
    used = np.flatnonzero(rows.weight[: len(points)] > 0.0).astype(np.int32)
    for start in range(0, len(rows.residual), len(points)):
        which = start + used
        J, S = row_jacobian(instant.posed, motion, points[used], rows.gradient[which])
        system.add_rows((instant.number,), (J,), S, share * rows.weight[which], rows.residual[which])
    return energy


def add_brightness(
    system: Arrow, earlier: Instant, later: Instant, motion: RestMotion, cue: Brightness, blur: float, share: float,
    sigma: float,
) -> float:  # fmt: skip
    """Add brightness constancy between two frames, ``I_b(π(x_b)) − I_a(π(x_a))``, both poses free; its energy.

    Bregler and Malik (DOI 10.1109/CVPR.1998.698581), eq. 17 ff., refine a sequence so; here in perspective.
    """
    energy, information = 0.0, share / sigma**2
    for camera in earlier.sights.keys() & later.sights.keys():
        a, b = earlier.sights[camera], later.sights[camera]
        depths = b.seen.inverse_depth_image
        seen = visible_points(b.view.camera.P, a.points.bound_to(later.posed), depths, cue.depth_tolerance)
        points = a.points[seen > 0.0]
        value_a, gradient_a = _sampled(a, earlier.posed, points, blur)
        value_b, gradient_b = _sampled(b, later.posed, points, blur)
        both = gradient_a.any(axis=1) & gradient_b.any(axis=1)
        residual = value_b - value_a
        cost, weight = weighted_cauchy(residual, np.where(both, information, 0.0), cue.scale * sigma)
        Ja, Sa = row_jacobian(earlier.posed, motion, points, -gradient_a)
        Jb, Sb = row_jacobian(later.posed, motion, points, gradient_b)
        system.add_rows((earlier.number, later.number), (Ja, Jb), Sa + Sb, weight, residual)
        energy += cost
    return energy


def _sampled(sight: Sight, posed: Posed, points: SurfacePoints, blur: float) -> tuple[Float, Float]:
    """Brightness (N,) where points are seen and its gradient (N, 3) by the world point; 0 off the image."""
    N = len(points)
    image = sight.view.blurred(blur * sight.seen.px_per_m)
    plain = Samples(points, np.zeros(N), np.zeros((N, 2)))
    rows = plain.rows(posed, sight.view.camera.P, image, np.zeros(EXPOSURE), np.ones(N))
    return rows.residual, 2.0 * rows.gradient  # it takes the mean of two images' gradients, of which one is 0 here
