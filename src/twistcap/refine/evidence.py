"""What the images say of poses and shape together: rows by the steps of one frame's pose, another's, and the shape."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twistcap._typing import Float
from twistcap.body import Posed
from twistcap.body.shape import RestMotion
from twistcap.cues.brightness import Brightness, strongest_in_cells, visible_points
from twistcap.cues.evidence import ContourEvidence
from twistcap.cues.view import View
from twistcap.refine.system import Arrow
from twistcap.render import RenderedView, SurfacePoints
from twistcap.terms import PointTerm
from twistcap.terms.photometric import brightness_rows
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
    cell = max(1, round(math.sqrt(max(np.count_nonzero(seen.mask), 1) / max(count, 1))))
    free = np.zeros((view.grey.shape[0] // cell + 1, view.grey.shape[1] // cell + 1), dtype=np.bool_)
    return seen.surface_points(*strongest_in_cells(view.grey, seen.inverse_depth_image, cell, free))


def row_jacobian(posed: Posed, motion: RestMotion, points: SurfacePoints, gradient: Float) -> tuple[Float, Float]:
    """Derivatives of residuals by the pose step (N, 6 + J) and by the shape (N, K).

    Args:
        gradient: (N, 3) of each residual by its world point.
    """
    N, S = len(points), len(posed.body.segment_names)
    T, every = posed.segment_transforms[points.segments], np.arange(N)
    carried = (T[..., :3, :3] @ points.local[:, None, :, None])[..., 0] + T[..., :3, 3]
    twist = np.concatenate(
        [np.cross(carried, gradient[:, None, :]), np.broadcast_to(gradient[:, None, :], carried.shape)], axis=2
    )
    by_segment = np.zeros((N, S, 6))
    for k in range(points.segments.shape[1]):
        by_segment[every, points.segments[:, k]] += points.weights[:, k, None] * twist[:, k]
    by_shape = motion.points(posed, points.segments, points.weights, points.local)
    return by_segment.reshape(N, 6 * S) @ posed.projector, np.einsum("kni,ni->nk", by_shape, gradient)


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
    system: Arrow, earlier: Instant, later: Instant, motion: RestMotion, cue: Brightness, blur: float, share: float
) -> float:
    """Add brightness constancy between two frames, ``I_b(π(x_b)) − I_a(π(x_a))``, both poses free; its energy.

    Bregler and Malik (DOI 10.1109/CVPR.1998.698581), eq. 17 ff., refine a sequence so; here in perspective.
    """
    energy = 0.0
    for camera in earlier.sights.keys() & later.sights.keys():
        a, b = earlier.sights[camera], later.sights[camera]
        P, points = b.view.camera.P, a.points
        tolerance = cue.depth_tolerance
        seen = visible_points(P, *points.bound_to(later.posed), b.seen.inverse_depth_image, tolerance)
        points = points[seen > 0.0]
        sides = [_sampled(side, instant.posed, points, blur) for side, instant in ((a, earlier), (b, later))]
        (value_a, gradient_a), (value_b, gradient_b) = sides
        residual = value_b - value_a
        both = gradient_a.any(axis=1) & gradient_b.any(axis=1)
        cost, weight = weighted_cauchy(residual, both * (share * cue.share / cue.sigma**2), cue.scale)
        Ja, Sa = row_jacobian(earlier.posed, motion, points, -gradient_a)
        Jb, Sb = row_jacobian(later.posed, motion, points, gradient_b)
        system.add_rows((earlier.number, later.number), (Ja, Jb), Sa + Sb, weight, residual)
        energy += cost
    return energy


def _sampled(sight: Sight, posed: Posed, points: SurfacePoints, blur: float) -> tuple[Float, Float]:
    """Brightness (N,) where points are seen and its gradient (N, 3) by the world point; 0 off the image."""
    N = len(points)
    image = sight.view.blurred(blur * sight.seen.px_per_m)
    P, world = sight.view.camera.P, points.at(posed)
    value, half = brightness_rows(P, world, image, np.zeros(N), np.zeros((N, 2)), np.ones(N))
    return value, 2.0 * half  # it takes the mean of two images' gradients, of which one is 0 here
