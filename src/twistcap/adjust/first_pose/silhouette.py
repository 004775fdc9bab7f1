"""Refining a pose, and if wanted the girths, on silhouettes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap._typing import AnyArray, Bool, Float
from twistcap.adjust.first_pose.outline import Outline, match, outline_of
from twistcap.adjust.first_pose.outline_term import Girths, OutlineTerm
from twistcap.body import Body, Pose
from twistcap.body.kinematics import Posed
from twistcap.body.shape import RestMotion
from twistcap.camera import Camera, Rectifier, Rig
from twistcap.errors import InputError
from twistcap.render import render, visible_contour
from twistcap.solve import Arrow, BlockProblem, Dense, PoseTrack, Variables, minimise
from twistcap.terms import BlockGaussian, BlockTerm, GaussianTerm, OnPose

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


_LONGEST = 0.5  # rad, m, log-girth; the matches hold no farther
_DAMPING = 1e-6
_REFRESH = 5  # iterations after which the motion with girths is worked out anew: the joints move little with them


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

    One step on distances along normals after each matching, from model to mask and from mask to model, Huber-weighted,
    with a reach that shrinks. The poses given pull back with their covariance.

    Args:
        poses: of one or more instants, which share their girths.
        masks: for each instant one mask (H, W) per camera, 0 off the person, or None; in the cameras' own pixels.
        covariances: (6 + J, 6 + J) of each pose (`FirstPose.covariance`); by default 10 degrees and 5 cm.
        groups: segments that share a girth factor; None keeps the girths, `girth_groups` gives one for each kind.

    Raises:
        InputError: if the number or size of the masks does not fit the rig, or an instant has no mask.
    """
    single = isinstance(poses, Pose)
    starts: list[Pose] = [poses] if isinstance(poses, Pose) else list(poses)
    many_masks: list[Sequence[AnyArray | None]] = [masks] if single else list(masks)  # type: ignore[list-item]
    options, names = options or SilhouetteOptions(), dict(groups or {})
    instants = [_Instant.of(rig, m, options) for m in many_masks]
    given = covariances or [None] * len(starts)
    priors: list[BlockTerm] = [
        OnPose(GaussianTerm(pose, _information(body, c), "start"), body, frame=f)
        for f, (pose, c) in enumerate(zip(starts, given, strict=True))
    ]
    priors.append(BlockGaussian("girths", np.zeros(len(names)), np.full(len(names), options.girth), "girths"))
    blocks = {
        "poses": PoseTrack(tuple(starts), np.arange(float(len(starts)))),
        "girths": Girths(body, names, np.zeros(len(names))),
    }
    x, system = Variables(blocks, ("poses", "girths"), dict.fromkeys(blocks, _LONGEST)), None
    motion: RestMotion | None = None
    for i in range(options.iterations):
        part = i / max(options.iterations - 1, 1)
        reach = options.first_reach * (options.last_reach / options.first_reach) ** part
        if names and i % _REFRESH == 0:
            motion = x["girths"].rest_motion()
        terms = [term for f, instant in enumerate(instants) for term in instant.terms(x, motion, f, reach, options)]
        x, system = _stepped(x, [*terms, *priors])
    assert isinstance(system, Arrow)
    found, girths = x["poses"].poses, x["girths"]
    iou = np.array([instant.overlaps(Posed(girths.body, p)) for instant, p in zip(instants, found, strict=True)])
    return Refined(girths.body, found, girths.factors, iou, tuple(system.marginals().poses))


def _stepped(x: Variables, terms: Sequence[BlockTerm]) -> tuple[Variables, Dense | Arrow]:
    """All poses, inside their limits, and girths after one step; the system of the step."""
    found = minimise(BlockProblem(terms, reach=0), x, damping=_DAMPING)
    track = found.x["poses"]
    inside = replace(track, poses=tuple(pose.within(x["girths"].generic.limits) for pose in track.poses))
    return replace(found.x, blocks={**found.x.blocks, "poses": inside}), found.system


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

    def terms(
        self, x: Variables, motion: RestMotion | None, f: int, reach: float, options: SilhouetteOptions
    ) -> list[OutlineTerm]:
        """The outlines of this instant, number `f` of the track, matched with the model as it is."""
        girths: Girths = x["girths"]
        posed, out = Posed(girths.body, x["poses"].poses[f]), list[OutlineTerm]()
        # Neighbouring samples err alike: together they may count no more than one per correlation length, both ways.
        fraction = 0.5 * options.spacing / options.correlation
        for camera, outline, height in zip(self.cameras, self.outlines, self.heights, strict=True):
            if outline is not None:
                contour = visible_contour(render(posed, camera), options.spacing * height)
                found = match(contour, outline, reach * height)
                points, target = contour.points[found.index], found.target(contour)
                sigma, weight = options.sigma * height, fraction * found.weight
                out.append(OutlineTerm(camera.P, points, girths, motion, found.normals, target, sigma, weight, f))
        return out

    def overlaps(self, posed: Posed) -> list[float]:
        """Intersection over union in each view, NaN without mask."""
        out: list[float] = []
        for camera, mask in zip(self.cameras, self.masks, strict=True):
            ours = render(posed, camera).mask
            out.append(np.nan if mask is None else float((ours & mask).sum() / max((ours | mask).sum(), 1)))
        return out


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
