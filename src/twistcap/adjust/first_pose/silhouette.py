"""Refinement of a pose, and of the girths if wanted, on silhouettes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.adjust.first_pose.outline import Girths, Outline, OutlineTerm, match, outline_of
from twistcap.arrays import AnyArray, Bool
from twistcap.body import Body, Pose
from twistcap.body.kinematics import Posed
from twistcap.body.model import unsided
from twistcap.body.shape import RestMotion
from twistcap.camera import Camera, Rectifier, Rig
from twistcap.errors import InputError, check
from twistcap.render import render, visible_contour
from twistcap.solve import BlockProblem, PoseTrack, Variables, minimise
from twistcap.terms import BlockGaussian, BlockTerm, GaussianTerm, OnPose

Groups = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class Refined:
    """A body, and its pose at each of F instants, refined on silhouettes.

    `girths` are factors of the segments against the body given.
    """

    body: Body
    poses: tuple[Pose, ...]
    girths: Mapping[str, float]


# Lengths as fractions of the person's height in the image.
_ITERATIONS = 20  # matchings
_REACH = 0.12, 0.03  # greatest distance of a match, at the first and last iteration
_SPACING = 0.01  # of contour samples
_SIGMA = 0.006  # standard deviation of an outline point
_CORRELATION = 0.04  # along the outline, over which its errors are alike
_COUNTED = 0.5 * _SPACING / _CORRELATION  # of each sample: both ways together, one per correlation length
_GIRTH = 0.15  # standard deviation of a log-girth
_LONGEST = 0.5  # rad, m, log-girth; the matches hold no farther
_DAMPING = 1e-6
_REFRESH = 5  # iterations between updates of the motion with girths: the joints move little with them


def girth_groups(body: Body) -> dict[str, tuple[str, ...]]:
    """One group for each kind of segment, left and right together."""
    out: dict[str, tuple[str, ...]] = {}
    for name in body.segment_names:
        out[unsided(name)] = (*out.get(unsided(name), ()), name)
    return out


def refine_on_silhouettes(
    body: Body, rig: Rig, poses: Sequence[Pose], masks: Sequence[Sequence[AnyArray | None]], *,
    groups: Groups | None = None,
) -> Refined:  # fmt: skip
    """Move body and girths so that the model's contour lies on the outlines of the masks.

    Each iteration matches model to mask and mask to model, with a reach that shrinks, and takes one step on the
    distances along the normals with Huber's loss (DOI 10.1214/aoms/1177703732). Each pose has a Gaussian prior about
    its start, of 10 degrees and 5 cm.

    Args:
        body, rig, poses: of one or more instants, which share their girths; cameras with their distortion.
        masks: for each instant one mask (H, W) per camera, 0 off the person, or None; in the cameras' own pixels.
        groups: segments that share a girth factor; None keeps the girths, `girth_groups` gives one for each kind.

    Raises InputError if the number or size of the masks does not fit the rig, or an instant has no mask.
    """
    names, instants = dict(groups or {}), [_Instant.of(rig, of_instant) for of_instant in masks]
    sigma = np.full(body.dof, np.deg2rad(10.0))
    sigma[3:6] = 0.05
    about = [GaussianTerm(pose, np.diag(sigma**-2.0), "start") for pose in poses]
    priors: list[BlockTerm] = [OnPose(term, body, frame=f) for f, term in enumerate(about)]
    priors.append(BlockGaussian("girths", np.zeros(len(names)), np.full(len(names), _GIRTH), "girths"))
    blocks = {
        "poses": PoseTrack(tuple(poses), np.arange(float(len(poses)))),
        "girths": Girths(np.zeros(len(names)), generic=body, groups=names),
    }
    x = Variables(blocks, ("poses", "girths"), dict.fromkeys(blocks, _LONGEST))
    motion: RestMotion | None = None
    for i in range(_ITERATIONS):
        reach = _REACH[0] * (_REACH[1] / _REACH[0]) ** (i / (_ITERATIONS - 1))
        if names and i % _REFRESH == 0:
            motion = x["girths"].rest_motion()
        terms = [term for f, instant in enumerate(instants) for term in instant.terms(x, motion, f, reach)]
        x = _stepped(x, [*terms, *priors])
    girths = x["girths"]
    return Refined(girths.body, x["poses"].poses, girths.factors)


def _stepped(x: Variables, terms: Sequence[BlockTerm]) -> Variables:
    """All poses, inside their limits, and girths after one step."""
    x = minimise(BlockProblem(terms, reach=0), x, damping=_DAMPING).x
    track = x["poses"]
    inside = replace(track, poses=tuple(pose.within(x["girths"].generic.limits) for pose in track.poses))
    return replace(x, blocks={**x.blocks, "poses": inside})


@dataclass(frozen=True)
class _Instant:
    """Outlines of the rectified masks of one instant, and the heights of these, px."""

    cameras: tuple[Camera, ...]
    outlines: tuple[Outline | None, ...]
    heights: tuple[float, ...]

    @staticmethod
    def of(rig: Rig, masks: Sequence[AnyArray | None]) -> _Instant:
        if len(masks) != len(rig) or all(m is None for m in masks):
            need = "give one or None for each, not all None"
            raise InputError(f"masks: {len(masks)} were given for {len(rig)} cameras; {need}.")
        flat = tuple(None if m is None else _rectified(c, m) for c, m in zip(rig, masks, strict=True))
        heights = tuple(0.0 if m is None else _height(m) for m in flat)
        outlines = tuple(None if m is None else outline_of(m, _SPACING * h) for m, h in zip(flat, heights, strict=True))
        return _Instant(tuple(rig.pinhole()), outlines, heights)

    def terms(self, x: Variables, motion: RestMotion | None, f: int, reach: float) -> list[OutlineTerm]:
        """The outlines of this instant, number `f` of the track, matched with the model as it is."""
        girths: Girths = x["girths"]
        posed, out = Posed(girths.body, x["poses"].poses[f]), list[OutlineTerm]()
        for camera, outline, height in zip(self.cameras, self.outlines, self.heights, strict=True):
            if outline is not None:
                contour = visible_contour(render(posed, camera), _SPACING * height)
                matches = match(contour, outline, reach * height)
                points, target = contour.points[matches.index], matches.target(contour)
                sigma, weight = _SIGMA * height, _COUNTED * matches.weight
                out.append(OutlineTerm(camera.P, points, girths, motion, matches.normals, target, sigma, weight, f))
        return out


def _rectified(camera: Camera, mask: AnyArray) -> Bool:
    if mask.shape != camera.size[::-1]:
        shapes = f"{mask.shape}, but the camera has {camera.size[::-1]}"
        raise InputError(f"masks: that of camera {camera.name} is {shapes}.")
    return np.asarray(Rectifier(camera)(np.where(mask > 0, 255, 0).astype(np.uint8), nearest=True) > 127)


def _height(mask: Bool) -> float:
    rows, columns = np.nonzero(mask)
    check("masks", len(rows), "one is empty; give None for a camera that does not see the person")
    return float(max(np.ptp(rows), np.ptp(columns), 1))
