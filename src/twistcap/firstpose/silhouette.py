"""Refining a pose, and if wanted the girths, on silhouettes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap._typing import AnyArray, Bool, Float
from twistcap.body import Body, Pose
from twistcap.body.kinematics import Posed, skin_points
from twistcap.body.shape import rescaled, stretch_maps
from twistcap.camera import Camera, Rectifier, Rig, pinhole
from twistcap.errors import InputError
from twistcap.firstpose.outline import Outline, match, outline_of
from twistcap.render import SurfacePoints, render, visible_contour

Groups = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class SilhouetteOptions:
    """How silhouettes are trusted.

    Attributes:
        iterations: re-matchings.
        spacing: of contour samples, parts of the person's height in the image.
        first_reach, last_reach: greatest distance of a match at the first and last iteration, parts of the height.
        sigma: standard deviation of an outline point, parts of the height.
        correlation: length along the outline over which its errors are alike, parts of the height.
        girth: standard deviation of a log-girth.
    """

    iterations: int = 20
    spacing: float = 0.01
    first_reach: float = 0.12
    last_reach: float = 0.03
    sigma: float = 0.006
    correlation: float = 0.04
    girth: float = 0.15


@dataclass(frozen=True)
class Refined:
    """What the silhouettes say.

    Attributes:
        body: with the girths fitted.
        poses: one for each instant.
        girths: factor of each segment against the body given.
        iou: (F, C) overlap of model and mask, NaN without mask.
        covariances: (6 + J, 6 + J) of each pose step.
    """

    body: Body
    poses: tuple[Pose, ...]
    girths: Mapping[str, float]
    iou: Float
    covariances: tuple[Float, ...]


def girth_groups(body: Body) -> dict[str, tuple[str, ...]]:
    """One group for each kind of segment, left and right together."""
    out: dict[str, tuple[str, ...]] = {}
    for name in body.segment_names:
        stem = name.removesuffix("_r").removesuffix("_l")
        out[stem] = (*out.get(stem, ()), name)
    return out


def refine_on_silhouettes(
    body: Body,
    rig: Rig,
    poses: Pose | Sequence[Pose],
    masks: Sequence[AnyArray | None] | Sequence[Sequence[AnyArray | None]],
    *,
    covariances: Sequence[Float] | None = None,
    groups: Groups | None = None,
    options: SilhouetteOptions | None = None,
) -> Refined:
    """Move body and girths so that the model's contour lies on the outlines of the masks.

    Gauss-Newton on distances along normals, matched from model to mask and from mask to model, Huber-weighted, with a
    reach that shrinks. The poses given pull back with their covariance.

    Args:
        poses: of one or more instants, which share their girths.
        masks: for each instant one mask (H, W) per camera, 0 off the person, or None; in the cameras' own pixels.
        covariances: (6 + J, 6 + J) of each pose (`FirstPose.covariance`); by default 10 degrees and 5 cm.
        groups: segments that share a girth factor; None keeps the girths, `girth_groups` gives one for each kind.

    Raises:
        InputError: if the number or size of the masks does not fit the rig, or an instant has no mask.
    """
    single = isinstance(poses, Pose)
    many_poses: list[Pose] = [poses] if isinstance(poses, Pose) else list(poses)
    many_masks: list[Sequence[AnyArray | None]] = [masks] if single else list(masks)  # type: ignore[list-item]
    options, names = options or SilhouetteOptions(), dict(groups or {})
    instants = [_Instant.of(rig, m, options) for m in many_masks]
    priors = [_information(body, covariances[f] if covariances else None) for f in range(len(many_poses))]
    state = _State(body, tuple(many_poses), np.zeros(len(names)), np.zeros((0, 0)))
    wider: list[_Wider] = []
    for i in range(options.iterations):
        part = i / max(options.iterations - 1, 1)
        reach = options.first_reach * (options.last_reach / options.first_reach) ** part
        if i % _REFRESH == 0:
            wider = [_Wider.of(state.body, group) for group in names.values()]
        state = _step(state, body, instants, priors, many_poses, names, wider, reach, options)
    iou = np.array([instant.overlaps(Posed(state.body, p)) for instant, p in zip(instants, state.poses, strict=True)])
    return Refined(state.body, state.poses, _factors(names, state.log_girths), iou, _covariances(state, body.dof))


@dataclass(frozen=True)
class _Instant:
    """Masks of one instant, rectified, and their outlines."""

    cameras: tuple[Camera, ...]
    masks: tuple[Bool | None, ...]
    outlines: tuple[Outline | None, ...]
    heights: tuple[float, ...]

    @staticmethod
    def of(rig: Rig, masks: Sequence[AnyArray | None], options: SilhouetteOptions) -> _Instant:
        if len(masks) != len(rig) or all(m is None for m in masks):
            raise InputError(
                f"masks: {len(masks)} were given for {len(rig)} cameras; give one or None for each, not all None."
            )
        flat = [None if m is None else _rectified(c, m) for c, m in zip(rig, masks, strict=True)]
        heights = tuple(0.0 if m is None else _height(m) for m in flat)
        outlines = tuple(
            None if m is None else outline_of(m, options.spacing * h) for m, h in zip(flat, heights, strict=True)
        )
        return _Instant(tuple(rig.pinhole()), tuple(flat), outlines, heights)

    def overlaps(self, posed: Posed) -> list[float]:
        """Intersection over union in each view, NaN without mask."""
        out: list[float] = []
        for camera, mask in zip(self.cameras, self.masks, strict=True):
            ours = render(posed, camera).mask
            out.append(np.nan if mask is None else float((ours & mask).sum() / max((ours | mask).sum(), 1)))
        return out


@dataclass(frozen=True)
class _State:
    body: Body
    poses: tuple[Pose, ...]
    log_girths: Float
    matrix: Float


def _rectified(camera: Camera, mask: AnyArray) -> Bool:
    if mask.shape != camera.size[::-1]:
        raise InputError(
            f"masks: that of camera {camera.name} is {mask.shape}, but the camera has {camera.size[::-1]}."
        )
    return np.asarray(Rectifier(camera)(np.where(mask > 0, 255, 0).astype(np.uint8), nearest=True) > 127)


def _height(mask: Bool) -> float:
    rows, columns = np.nonzero(mask)
    if not len(rows):
        raise InputError("masks: one is empty; give None for a camera that does not see the person.")
    return float(max(np.ptp(rows), np.ptp(columns), 1))


def _information(body: Body, covariance: Float | None) -> Float:
    if covariance is not None:
        return np.asarray(np.linalg.inv(covariance), np.float64)
    sigma = np.full(body.dof, np.deg2rad(10.0))
    sigma[3:6] = 0.05
    return np.diag(sigma**-2.0)


def _factors(groups: Groups, log_girths: Float) -> dict[str, float]:
    return {name: float(np.exp(g)) for g, group in zip(log_girths, groups.values(), strict=True) for name in group}


def _step(
    state: _State,
    generic: Body,
    instants: Sequence[_Instant],
    priors: Sequence[Float],
    starts: Sequence[Pose],
    groups: Groups,
    wider: Sequence[_Wider],
    reach: float,
    options: SilhouetteOptions,
) -> _State:
    """One re-matching and one Gauss-Newton step for all instants and girths."""
    D, F, n = generic.dof, len(instants), len(instants) * generic.dof + len(groups)
    g, H = np.zeros(n), np.zeros((n, n))
    for f, (instant, pose) in enumerate(zip(instants, state.poses, strict=True)):
        rows = np.r_[f * D : (f + 1) * D, F * D : n]
        gradient, matrix = _evidence(instant, Posed(state.body, pose), wider, reach, options)
        g[rows] += gradient
        H[np.ix_(rows, rows)] += matrix
        own = slice(f * D, (f + 1) * D)
        g[own] += priors[f] @ pose.minus(starts[f])
        H[own, own] += priors[f]
    g[F * D :] += state.log_girths / options.girth**2
    H[range(F * D, n), range(F * D, n)] += options.girth**-2.0
    step = np.asarray(np.clip(np.linalg.solve(H + 1e-9 * np.eye(n), -g), -0.2, 0.2), np.float64)
    moved = [pose.retract(step[f * D : (f + 1) * D]) for f, pose in enumerate(state.poses)]
    log_girths = state.log_girths + step[F * D :]
    body = rescaled(generic, girths=_factors(groups, log_girths)) if groups else generic
    return _State(body, tuple(p.within(generic.limits) for p in moved), log_girths, H)


_WIDER = 1e-3  # step of the difference quotient by a log-girth
_REFRESH = 5  # iterations after which the difference quotients are taken anew: the joints move little with girths


@dataclass(frozen=True)
class _Wider:
    """A body with one girth a little larger, the body as it was, and the map of each segment between them."""

    before: Body
    after: Body
    maps: Float

    @staticmethod
    def of(body: Body, group: Sequence[str]) -> _Wider:
        factors = dict.fromkeys(group, float(np.exp(_WIDER)))
        return _Wider(body, rescaled(body, girths=factors), np.ascontiguousarray(stretch_maps(body, {}, factors)))

    def derivative(self, posed: Posed, points: SurfacePoints) -> Float:
        """(N, 3) derivative of surface points by the log-girth."""
        local = skin_points(self.maps, points.segments, points.weights, points.local)
        after = Posed(self.after, posed.pose).points(points.segments, points.weights, local)
        return (after - points.at(Posed(self.before, posed.pose))) / _WIDER


def _evidence(
    instant: _Instant, posed: Posed, wider: Sequence[_Wider], reach: float, options: SilhouetteOptions
) -> tuple[Float, Float]:
    """Gradient and Gauss-Newton matrix of the outline distances by (pose step, log-girths)."""
    n = posed.body.dof + len(wider)
    g, H = np.zeros(n), np.zeros((n, n))
    for camera, outline, height in zip(instant.cameras, instant.outlines, instant.heights, strict=True):
        if outline is None:
            continue
        contour = visible_contour(render(posed, camera), options.spacing * height)
        found = match(contour, outline, reach * height)
        points = contour.points[found.index]
        by_pose = posed.point_jacobian(points.segments, points.weights, points.local)
        by_girth = [w.derivative(posed, points)[:, :, None] for w in wider]
        J = np.concatenate([by_pose, *by_girth], axis=2)
        row = np.einsum("ni,nij,njd->nd", found.normals, pinhole(camera.P, points.at(posed))[2], J)
        sigma = options.sigma * height
        size = np.abs(found.distance) / sigma
        # Neighbouring samples err alike: together they may count no more than one per correlation length, both ways.
        weight = found.weight * np.minimum(1.0, 2.0 / np.maximum(size, 1e-9)) / sigma**2
        weight *= 0.5 * options.spacing / options.correlation
        g -= row.T @ (weight * found.distance)
        H += row.T @ (weight[:, None] * row)
    return g, H


def _covariances(state: _State, dof: int) -> tuple[Float, ...]:
    whole = np.linalg.inv(state.matrix)
    own = [slice(f * dof, (f + 1) * dof) for f in range(len(state.poses))]
    return tuple(np.asarray(whole[s, s], np.float64) for s in own)
