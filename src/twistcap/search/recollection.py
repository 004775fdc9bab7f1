"""What a recording has taught about a body: the backgrounds, the stances it has shown, and how clear it usually is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.observation import Fit, Sight
from twistcap.search import Problem
from twistcap.search.backdrop import PX_PER_M, Backdrop, small_camera, small_features
from twistcap.search.evidence import Evidence, EvidenceView, evidence_maps, sampled_evidence
from twistcap.search.placing import Stance
from twistcap.search.surroundings import Surroundings

CLIP = 3.0
"""Nats that one pixel can say."""
_MANY = 24  # stances that are remembered
_NEW = 0.3  # rad by which a stance must differ from all others in one joint
_MEMORY = 0.95  # share of the usual evidence that is kept from frame to frame
_CLEAR = 2.0  # nats for each pixel of a body of which nothing else is known
_FEW, _ENOUGH = 20.0, 150.0  # pixels below which nothing is said of a camera or part, and of the body
_TELLING = 0.2  # nats for each pixel below which the body's colours are not those that it has, or the background's
_SAMPLES = 36.0  # per m, pixels that are looked at in every frame; evidence counts as if small pictures had as many


@dataclass(frozen=True)
class Covered:
    """What the pictures say where a body covers them.

    Attributes:
        nats: (cameras, S) evidence of each part.
        pixels: (cameras, S) that it covers, weighted by the confidence in its colours.
    """

    nats: Float
    pixels: Float


@dataclass(frozen=True)
class Check(Covered):
    """How the pictures agree with a fit.

    Attributes:
        uncovered: (cameras, S) evidence for each part where nothing covers the picture.
        fitting: (cameras,) fraction of the other pixels that fit the background; NaN where there are none.
    """

    uncovered: Float
    fitting: Float


@dataclass(frozen=True)
class Recollection:
    """What the recording has taught.

    Attributes:
        backdrops: of each camera.
        turns, heights, angles: (K, 3, 3), (K,), (K, J) stances that the body has shown.
        nats, pixels, uncovered: (cameras, S) running means of what frames' checks said.
        fitting: (cameras,) of what fraction fits the background.
        lessons: taken so far.
    """

    backdrops: tuple[Backdrop, ...]
    turns: Float
    heights: Float
    angles: Float
    nats: Float
    pixels: Float
    uncovered: Float
    fitting: Float
    lessons: int = 0

    @staticmethod
    def blank(body: Body, rig: Rig) -> Recollection:
        """Nothing is known."""
        none = np.zeros((len(rig), len(body.segment_names)))
        stances = np.zeros((0, 3, 3)), np.zeros(0), np.zeros((0, body.dof - 6))
        return Recollection(tuple(Backdrop.blank() for _ in rig), *stances, none, none, none, np.full(len(rig), np.nan))

    def forgotten(self) -> Recollection:
        """With the stances alone: the pictures have changed."""
        none = np.zeros_like(self.nats)
        blank = tuple(Backdrop.blank() for _ in self.backdrops)
        return replace(
            self, backdrops=blank, nats=none, pixels=none, uncovered=none, fitting=np.full_like(self.fitting, np.nan),
            lessons=0,
        )  # fmt: skip

    @property
    def stances(self) -> list[Stance]:
        """That the body has shown."""
        return [Stance(*s) for s in zip(self.turns, self.heights, self.angles, strict=True)]

    @property
    def usual(self) -> Float:
        """(cameras, S) nats for each pixel of a part; of all parts together where a camera has hardly seen it."""
        own = self.nats / np.maximum(self.pixels, 1e-9)
        every = self.nats.sum() / self.pixels.sum() if self.sure else _CLEAR
        return np.where(self.pixels < _FEW, every, own)

    @property
    def sure(self) -> bool:
        """Whether enough of the body has been seen, in colours that differ from the background's, to judge by it."""
        return float(self.pixels.sum()) >= _ENOUGH and float(self.nats.sum()) >= _TELLING * float(self.pixels.sum())

    def nats_in(self, evidence: Evidence) -> Float:
        """(S,) usual evidence of each part in the cameras that tell something now."""
        return self.nats[[view.index for view in evidence.views]].sum(axis=0)

    def in_sight(self, covered: Covered) -> float:
        """How many pixels a body covers, over what is usual."""
        return float(covered.pixels.sum() / max(self.pixels.sum(), 1e-9))

    def ratios(self, covered: Covered, clear: float = 0.0) -> Float:
        """(cameras,) evidence of a body over what is usual for so many pixels; NaN in cameras that show nearly nothing
        of it. Where it usually has less than `clear` nats for each pixel, the evidence that lacks is divided by those.
        """
        usual, pixels = (self.usual * covered.pixels).sum(axis=1), covered.pixels.sum(axis=1)
        enough = pixels > np.maximum(0.15 * self.pixels.sum(axis=1), _FEW)
        lacking = (usual - covered.nats.sum(axis=1)) / np.maximum(usual, np.maximum(clear * pixels, 1e-9))
        return np.where(enough & (usual > 0.0), 1.0 - lacking, np.nan)

    def ratio(self, covered: Covered) -> float:
        """The same of all cameras together, of three or more without the one that contradicts most; NaN of none."""
        usual, each = (self.usual * covered.pixels).sum(axis=1), self.ratios(covered)
        kept = ~np.isnan(each)
        if kept.sum() >= 3:
            kept[np.nanargmin(each)] = False
        if not kept.any():
            return np.nan
        return float(covered.nats[kept].sum() / usual[kept].sum())

    def check(self, posed: Posed, sights: Sequence[Sight], problem: Problem, beside: bool = True) -> Check:
        """How the pictures agree with a fit, and `beside` it too; nothing is said in cameras without a background."""
        out, fitting = np.zeros((3, *self.nats.shape)), np.full(len(self.backdrops), np.nan)
        for sight in sights:
            i, view, backdrop = sight.camera_index, sight.view, self.backdrops[sight.camera_index]
            if backdrop.size == (0, 0):
                continue
            stride = max(1, round(sight.seen.px_per_m / _SAMPLES))
            factor = backdrop.size[0] / problem.rig[i].size[0]  # small pixels in a pixel
            grid = (*view.origin, factor, stride)
            colours = backdrop.channels_of(problem.colours(i, view.features.shape[2]))
            found, fits = sampled_evidence(
                view.features, sight.seen.part, grid, backdrop.background, backdrop.palette, colours, CLIP,
                beside,
            )  # fmt: skip
            out[:, i] = found * (stride * factor * _SAMPLES / PX_PER_M) ** 2  # as much with any stride
            fitting[i] = fits[0] / fits[1] if fits[1] else np.nan
        return Check(out[0], out[1], out[2], fitting)

    def accustomed(self, check: Check, parts: Bool, frames: int) -> Recollection:
        """With a check as one more of what is usual for some parts (S,), after so many frames."""
        memory = min(_MEMORY, 1.0 - 1.0 / max(frames, 1))
        keep = np.where((self.pixels > 0.0) & (check.pixels > 0.0), memory, (check.pixels == 0.0) * 1.0)
        keep = np.where(parts, keep, 1.0)
        means = (keep * a + (1.0 - keep) * b for a, b in zip(
            (self.nats, self.pixels, self.uncovered), (check.nats, check.pixels, check.uncovered), strict=True
        ))  # fmt: skip
        before = np.where(np.isnan(self.fitting), check.fitting, self.fitting)
        fitting = np.where(np.isnan(check.fitting), before, _MEMORY * before + (1.0 - _MEMORY) * check.fitting)
        nats, pixels, uncovered = means
        return replace(self, nats=nats, pixels=pixels, uncovered=uncovered, fitting=fitting)

    def taught(self, pose: Pose, views: Mapping[int, Surroundings]) -> Recollection:
        """With the backgrounds that some cameras see about a body, and its stance."""
        backdrops = list(self.backdrops)
        for i, view in views.items():
            backdrops[i] = view.backdrop.learnt(view.features, view.beside)
        return replace(self._with_stance(pose), backdrops=tuple(backdrops), lessons=self.lessons + 1)

    def _with_stance(self, pose: Pose) -> Recollection:
        if len(self.angles) and np.abs(self.angles - pose.q).max(axis=1).min() < _NEW:
            return self
        kept = slice(max(0, len(self.angles) + 1 - _MANY), None)
        return replace(
            self, turns=np.concatenate([self.turns[kept], pose.root[None, :3, :3]]),
            heights=np.append(self.heights[kept], pose.root[2, 3]), angles=np.vstack([self.angles[kept], pose.q]),
        )  # fmt: skip

    def evidence(self, problem: Problem) -> Evidence:
        """The evidence of a frame's whole pictures, in cameras that show a background that is known."""
        views = list[EvidenceView]()
        for i, (image, backdrop) in enumerate(zip(problem.frame.images, self.backdrops, strict=True)):
            if image is None or backdrop.size == (0, 0) or i in problem.left_out:
                continue
            camera = small_camera(problem.rig[i], backdrop, problem.start.root[:3, 3])
            features = small_features(image, camera.size, problem.channels)
            if not backdrop.is_in(features):
                continue
            colours = backdrop.channels_of(problem.colours(i, features.shape[2]))
            views.append(
                EvidenceView(i, camera, evidence_maps(features, backdrop.background, backdrop.palette, colours, CLIP))
            )
        return Evidence(problem.body, views)


@dataclass(frozen=True)
class Judged:
    """A frame's problem, its fit, and how its pictures agree with that."""

    problem: Problem
    fit: Fit
    check: Check


def fitted(known: Recollection, problem: Problem) -> Judged:
    """A problem fitted anew."""
    return fitted_at(known, problem, problem.align(problem.start))


def fitted_at(known: Recollection, problem: Problem, fit: Fit) -> Judged:
    """A problem with a fit, and how its pictures agree with that."""
    return Judged(problem, fit, known.check(fit.posed, fit.sights, problem))
