"""One round's measurements: the body is rendered into all images, and what these show of it becomes terms."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from twistcap.adjust.refine.evidence import BrightnessPair
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Posed
from twistcap.build import contour_of
from twistcap.camera import Rig
from twistcap.cues.appearance import Appearance, AppearanceRule
from twistcap.cues.brightness import Brightness, cell_of
from twistcap.cues.contour import ContourCue
from twistcap.cues.memory import empty_grid, strongest_in_cells
from twistcap.cues.support import SupportRule
from twistcap.cues.view import View, as_calibrated, crop_view, despeckled
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.render import RenderedView, SurfacePoints, render, visible_contour
from twistcap.settings import Settings
from twistcap.terms import PointTerm
from twistcap.track.model import MARGIN
from twistcap.track.schedule import Schedule

_ROOM = 0.15  # m about the body, added to the tracker's margin, by which refining may move it
_SIDES = 8  # octants of the direction in which a contour point's residual grows
_COARSE = 2.0  # factor on the reach of the contours in coarse rounds

Tally = tuple[Float, Float]
"""Contour points (S,) of each part that agree with the image, and how many there are."""


@dataclass(frozen=True)
class CameraRound:
    """What one camera shows in one round: contours (None without an image of the body) and tallies of each frame,
    brightness between pairs of frames, and colours of the parts in all frames."""

    contours: Sequence[PointTerm | None]
    pairs: Sequence[BrightnessPair]
    tallies: Sequence[Tally]
    colours: Appearance


class SequenceImages:
    """The images of a sequence, cropped about the body, and the colours of its S parts over the whole sequence. `views`
    are of each camera and frame, None without an image; the cue `contour` is None for the differential method."""

    def __init__(self, rig: Rig, config: RefineConfig, tracker: Settings, body: Body) -> None:
        self.config, self.tracker, self.cameras, self.parts = config, tracker, len(rig), len(body.segment_names)
        self.rig, self.body = rig, body
        self.views: list[list[View | None]] = [[] for _ in rig]
        self.contour: ContourCue | None = None if tracker.method == "differential" else contour_of(tracker)
        self.colours = self._blank()

    def read(self, frames: Iterable[Frame], estimates: Sequence[Estimate]) -> Iterable[int]:
        """Keep the surroundings of the body in each frame; yields how many are read. Raises InputError where the frames
        are not those of the estimates."""
        for count, (frame, estimate) in enumerate(zip_longest(frames, estimates), start=1):
            if frame is None or estimate is None or frame.index != estimate.index:
                raise InputError("refine: the frames are not those of the estimates; give those that were tracked.")
            posed, margin = Posed(self.body, estimate.pose), MARGIN + _ROOM
            for i, image in enumerate(despeckled(as_calibrated(frame, estimate, self.rig)).images):
                if image is None or i in estimate.left_out:
                    self.views[i].append(None)
                    continue
                seen = crop_view(image, self.rig[i], posed, margin, self.tracker.channels)
                self.views[i].append(seen)
            yield count

    def _blank(self) -> Appearance:
        """No colours yet. None of them fades: all frames of a sequence count alike."""
        return Appearance.blank(self.cameras, self.body.segment_names, AppearanceRule(memory=1.0))

    def measure(self, posed: Sequence[Posed], trusted: Bool, coarse: bool) -> list[CameraRound]:
        """A round of all cameras; frames that are not `trusted` (F,) are left out."""
        return self._round([posed] * self.cameras, trusted, coarse)

    def contours(self, posed: Sequence[Sequence[Posed]], coarse: bool) -> list[Sequence[PointTerm | None]]:
        """Contours alone, each camera's of poses of its own (C lists of F)."""
        rounds = self._round(posed, np.ones(len(posed[0]), dtype=np.bool_), coarse, brightness=False)
        return [of_camera.contours for of_camera in rounds]

    def _round(
        self, posed: Sequence[Sequence[Posed]], trusted: Bool, coarse: bool, brightness: bool = True
    ) -> list[CameraRound]:
        """One thread for each camera; what all have seen of the colours is known from now on."""
        with ThreadPoolExecutor(min(self.cameras, os.cpu_count() or 1)) as pool:
            work = [(i, own, trusted, coarse, brightness) for i, own in enumerate(posed)]
            rounds = list(pool.map(self._one_camera, *zip(*work, strict=True)))
        self.colours = sum((of_camera.colours for of_camera in rounds), self._blank())
        return rounds

    def agreeing(self, posed: Sequence[Posed], cameras: Sequence[int]) -> dict[int, Float]:
        """Of some cameras, the share (F,) of the contour points of poses that agree; NaN without an image."""
        trusted, out = np.ones(len(posed), dtype=np.bool_), dict[int, Float]()
        for i in cameras:
            tallies = self._one_camera(i, posed, trusted, False, False).tallies
            good, points = (np.array([tally[k].sum() for tally in tallies]) for k in (0, 1))
            out[i] = np.where(points > 0, good / np.maximum(points, 1.0), np.nan)
        return out

    def standing_at(self, places: Mapping[int, Float]) -> SequenceImages:
        """The same images, taken by cameras that stand elsewhere: `T_cam_world` (4, 4) by number."""
        out = copy(self)
        out.views = list(self.views)
        for i, T in places.items():
            views = self.views[i]
            out.views[i] = [view and replace(view, camera=replace(view.camera, T_cam_world=T)) for view in views]
        return out

    def _one_camera(
        self, i: int, posed: Sequence[Posed], trusted: Bool, coarse: bool, brightness: bool = True
    ) -> CameraRound:
        learnt, recent = self._blank(), list[tuple[int, View, RenderedView, SurfacePoints]]()
        contours, pairs, tallies = list[PointTerm | None](), list[BrightnessPair](), list[Tally]()
        nothing = np.zeros(self.parts), np.zeros(self.parts)
        for t, at in enumerate(posed):
            kept = self.views[i][t] if trusted[t] else None
            view = kept and crop_view(kept.image, kept.camera, at, MARGIN, kept.channels)
            contours.append(None)
            tallies.append(nothing)
            if view is None:
                continue
            seen = render(at, view.camera)
            if self.contour is not None:
                contours[-1], tallies[-1], learnt = self._contour(self.contour, i, view, seen, coarse, learnt)
            if not brightness:
                continue
            pairs += self._pairs(recent, (t, view, seen), coarse)
            recent = [r for r in recent if t - r[0] < max(self.config.strides)]
            recent.append((t, view, seen, followed_points(view, seen, self.config.points)))
        return CameraRound(contours, pairs, tallies, learnt)

    def _contour(
        self, cue: ContourCue, i: int, view: View, seen: RenderedView, coarse: bool, learnt: Appearance
    ) -> tuple[PointTerm, Tally, Appearance]:
        contour = visible_contour(seen, max(1.0, Schedule().contour_spacing * seen.px_per_m))
        colours = self.colours.of(i, view.features.shape[2])
        evidence = cue.locate(view, seen, contour, _COARSE if coarse else 1.0, colours)
        assert isinstance(evidence.term, PointTerm) and evidence.agreement is not None
        agreeing, points = evidence.agreement.agreeing, evidence.agreement.points
        learnt = learnt.learnt(i, view, seen, agreeing / np.maximum(points, 1), 1)
        return evidence.term, (agreeing, points.astype(float)), learnt

    def _pairs(
        self, recent: Sequence[tuple[int, View, RenderedView, SurfacePoints]], now: tuple[int, View, RenderedView],
        coarse: bool,
    ) -> list[BrightnessPair]:  # fmt: skip
        cue, config, (t, view, seen) = Brightness(), self.config, now
        blur = cue.blurs[0] if coarse else cue.blurs[-1]
        information = config.brightness / len(config.strides) / config.sigma**2
        noise = (information, cue.scale * config.sigma, cue.depth_tolerance)
        return [
            BrightnessPair.of((before, t), points, (old, rendered), (view, seen), blur, noise)
            for before, old, rendered, points in recent
            if t - before in config.strides
        ]


def followed_points(view: View, seen: RenderedView, count: int) -> SurfacePoints:
    """About `count` points of the visible surface: the most textured of each cell of a grid, none at a rim."""
    cell, inverse = cell_of(seen, count), seen.camera.inverse_depth
    free = empty_grid(seen.mask.shape, cell)
    return seen.surface_points(*strongest_in_cells(view.grey, seen.nearness_image, inverse, cell, free))


def agreement(rounds: Sequence[CameraRound]) -> float:
    """Fraction of all contour points that agree with the images; 0 without contours."""
    good, points = (sum(float(tally[k].sum()) for r in rounds for tally in r.tallies) for k in (0, 1))
    return good / max(points, 1.0)


def support(rounds: Sequence[CameraRound]) -> Float:
    """(F, S) support of each frame's pose by the contours, as in tracking: the fraction of each part."""
    rule, frames, parts = SupportRule(), len(rounds[0].tallies), len(rounds[0].tallies[0][0])
    out, fraction = np.ones((frames, parts)), np.ones(parts)
    for t in range(frames):
        good, points = (np.sum([r.tallies[t][k] for r in rounds], axis=0) for k in (0, 1))
        judged = points >= rule.least_points
        fraction[judged] *= rule.memory
        fraction[judged] += (1.0 - rule.memory) * good[judged] / points[judged]
        out[t] = fraction
    return out


def design_effect(rounds: Sequence[CameraRound], posed: Sequence[Posed], variance: float) -> float:
    """Factor by which the information of contours about the shape is overcounted, 1 or more.

    A surface that is not quite the person's shifts the same contour in the same direction in every frame. For the
    shape, which all frames share, n such points are worth ``n / d`` independent ones, with the design effect
    ``d = E (Σ w r)² / Σ w`` (Kish, "Survey Sampling", 1965, section 5.4), over groups of one part of the body in one
    camera, on one side. `variance` is the claimed one of a residual times its information, for independent points.
    """
    parts = len(posed[0].body.segment_names)
    squares, information = 0.0, 0.0
    for of_camera in rounds:
        pull, weight = np.zeros(parts * _SIDES), np.zeros(parts * _SIDES)
        for term, at in zip(of_camera.contours, posed, strict=True):
            if term is not None:
                _, points, rows = term.rows(at)
                group = np.resize(points.part, len(rows.residual)) * _SIDES + (rows.gradient > 0.0) @ [1, 2, 4]
                pull += np.bincount(group, rows.weight * rows.residual, len(pull))
                weight += np.bincount(group, rows.weight, len(weight))
        known = weight > 0.0
        squares += float(np.sum(pull[known] ** 2))  # of each group (Σ w r)² / Σ w, the mean weighted by Σ w
        information += float(np.sum(weight[known]))
    return max(1.0, squares / max(information, 1e-12) / variance)
