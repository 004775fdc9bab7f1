"""Places of cameras that were bumped, and the poses of all frames, in one least squares.

The other cameras hold the world; each may be turned a little, as calibrations are, and as contours are drawn aside. A
body that is too thick, or a lens that is too long, looks as if the camera stood nearer. So both may err too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, tee
from typing import cast

import numpy as np

from twistcap import se3
from twistcap.adjust.cameras.coarse import small_picture, turned_towards
from twistcap.adjust.cameras.since import zero_beside
from twistcap.adjust.refine.measure import SequenceImages
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.adjust.sequence import SmoothMotion, claimed_sigma, design_effect
from twistcap.adjust.watch import KNOCK
from twistcap.arrays import AnyArray, Float
from twistcap.body import Body, Posed
from twistcap.camera import Camera, Rig
from twistcap.camera.bump import bumped
from twistcap.camera.projection import NEAR
from twistcap.errors import check
from twistcap.estimate import Estimate, Frame
from twistcap.predict.inertia import INFLATION
from twistcap.settings import Settings
from twistcap.solve import Arrow, minimise
from twistcap.solve.blocks import PoseTrack
from twistcap.terms import PointNormalTerm
from twistcap.terms.accumulate import normal_equations

_ROUNDS = 40
_COARSE_ROUNDS = 3
_SETTLED = 0.05  # standard deviations as claimed, by which the cameras may still move in the last round
_LONGEST = 0.05  # rad and m that a camera moves in one step
_DAMPING = 1e-3
_STEPS = 3  # of the solver in each round
_STILL = np.repeat([np.deg2rad(0.1), 1e-5], 3)  # (6,) rad and m by which a camera stands off that was not bumped
_BY_BACKGROUND = np.r_[np.full(3, np.deg2rad(0.03)), KNOCK[3:]]  # (6,) the same of one whose turn its background tells
_FOCAL = 0.002  # of the focal length, by which calibrations err: 0.0001 to 0.004 on `balance_4view`
_OUTWARD = 0.005  # m by which a surface lies farther out than that of its body, in the mean
_NEARLY_ALL = 0.9  # of the frames
_LOOKS = 60  # frames in which a camera that was turned is looked for

SWAYS = np.deg2rad(0.2)
"""By which the turn of a camera that stands may differ from frame to frame."""
Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class MendedCameras:
    """Where cameras stand.

    Attributes:
        places: by number of the camera, `T_cam_world` (4, 4).
        sigmas: by number, (6,) standard deviations of its left twist, rad and m.
        before, after: by number, (F,) share of the contour points that agree in each frame with the camera as given,
            and as mended.
        others: that share in the other cameras, all frames together.
        turned: by number, rad by which each of the others had to be turned to agree.
        moved: standard deviations by which the cameras moved in each round.
        poses: of the frames.
    """

    places: Mapping[int, Float]
    sigmas: Mapping[int, Float]
    before: Mapping[int, Float]
    after: Mapping[int, Float]
    others: float
    turned: Mapping[int, float]
    moved: tuple[float, ...]
    poses: PoseTrack


def mended_cameras(
    frames: Callable[[], Iterable[Frame]], body: Body, rig: Rig, estimates: Sequence[Estimate], wrong: Sequence[int],
    tracker: Settings | None = None, report: Report | None = None,
) -> MendedCameras:  # fmt: skip
    """Places of the cameras `wrong`, by the contours of a body that was tracked in the others.

    A camera that was turned far is looked for first (`turned_towards`). Lenses stay as they are.

    Args:
        frames: gives those of the estimates, in order; it is called twice.
        body, rig, estimates: of the track; the cameras are those of the images.
        wrong: numbers of the cameras that are to be found; at least two others must be left.
        tracker: settings of the contour cue.
        report: is called with the progress.

    Raises InputError for fewer than three frames or two other cameras, frames that are not those of the estimates, or
    images that do not tell where a camera is.
    """
    check("cameras", len(estimates) >= 3, f"{len(estimates)} frames are tracked; at least 3 are needed")
    check("cameras", len(rig) - len(wrong) >= 2, "at least two cameras must be right; name fewer cameras")
    settings = replace(tracker or Settings(), method="direct")
    tell = _Progress(report or (lambda *_: None), len(estimates))
    given = rig.pinhole()
    by_background = turned_by_background(given, estimates, wrong)
    found = _looked_for(frames(), body, given, estimates, [c for c in wrong if c not in by_background], settings, tell)
    found |= by_background
    own = [
        replace(e, left_out=(*(set(e.left_out) - set(wrong)), *_elsewhere(given, e, by_background)),
                bumps=_of_others(e.bumps, wrong))
        for e in estimates
    ]  # fmt: skip
    turned = Rig(tuple(found.get(c, camera) for c, camera in enumerate(given)))
    images, as_given = (SequenceImages(cameras, RefineConfig(), settings, body) for cameras in (turned, given))
    others = tuple(c for c in range(len(rig)) if c not in wrong)
    alone = [replace(e, left_out=others, bumps=None) for e in estimates]
    first, second = tee(frames())
    for done, _ in zip(images.read(first, own), as_given.read(second, alone), strict=True):
        tell("reading", done)
    track = PoseTrack(tuple(e.pose for e in own), np.array([e.time for e in own]))
    places = {c: camera.T_cam_world for c, camera in enumerate(turned)}
    x = Standpoints(track, places, dict.fromkeys(places, 0.0))
    stood = {c: by_background.get(c, camera).T_cam_world for c, camera in enumerate(given)}
    sure = {c: _BY_BACKGROUND if c in by_background else KNOCK if c in wrong else _STILL for c in stood}
    return _settled(images, as_given, x, wrong, (stood, sure), tell)


def turned_by_background(rig: Rig, estimates: Sequence[Estimate], wrong: Sequence[int]) -> dict[int, Camera]:
    """Those of the wrong cameras that stood turned in nearly all frames alike, as their backgrounds have told the
    tracker, by number.
    """
    out = dict[int, Camera]()
    for c in wrong:
        turns = np.array([np.zeros(3) if e.bumps is None else e.bumps[c] for e in estimates])
        turn = np.median(turns, axis=0)
        if np.any(turn) and np.mean(np.linalg.norm(turns - turn, axis=1) < SWAYS) >= _NEARLY_ALL:
            out[c] = bumped(rig[c], turn)
    return out


def _elsewhere(rig: Rig, estimate: Estimate, stood: Mapping[int, Camera]) -> list[int]:
    """Those of the cameras that stood elsewhere in a frame than in most."""
    now = np.zeros((len(rig), 3)) if estimate.bumps is None else estimate.bumps
    off = {c: bumped(rig[c], now[c]).T_cam_world - camera.T_cam_world for c, camera in stood.items()}
    return [c for c, difference in off.items() if np.abs(difference[:3, :3]).max() >= SWAYS]


def _of_others(bumps: Float | None, wrong: Sequence[int]) -> Float | None:
    """(C, 3) turns of the cameras that are not wrong; the others are looked for as they are calibrated."""
    return None if bumps is None else np.where(np.isin(np.arange(len(bumps)), wrong)[:, None], 0.0, bumps)


@dataclass
class _Progress:
    report: Report
    frames: int
    rounds: int = 0

    def __call__(self, note: str, done: int) -> None:
        self.report(note, done + self.rounds * self.frames, (_ROUNDS + 3) * self.frames)


def _looked_for(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], wrong: Sequence[int],
    settings: Settings, tell: _Progress,
) -> dict[int, Camera]:  # fmt: skip
    """The wrong cameras, turned to where the body is, from some of the frames."""
    step = max(1, len(estimates) // _LOOKS)
    pictures: dict[int, list[AnyArray | None]] = {c: [] for c in wrong}
    posed = [Posed(body, estimate.pose) for estimate in estimates[::step]]
    for k, frame in enumerate(islice(frames, len(estimates))):
        tell("looking", k + 1)
        if k % step == 0:
            for c in wrong:
                image = frame.sorted_by(estimates[k].sources).images[c]
                pictures[c].append(None if image is None else small_picture(image, rig[c], posed))
    return {c: turned_towards(rig[c], pictures[c], posed[: len(pictures[c])], settings.channels) for c in wrong}


@dataclass(frozen=True)
class Standpoints:
    """The variables: the poses of all frames; by number, `T_cam_world` of the cameras and the logarithms by which their
    focal lengths are larger; and by how many m the surface lies farther out than that of the body.
    """

    track: PoseTrack
    places: Mapping[int, Float]
    zooms: Mapping[int, float]
    outward: float = 0.0


def _settled(
    images: SequenceImages, as_given: SequenceImages, x: Standpoints, wrong: Sequence[int],
    stood: tuple[Mapping[int, Float], Mapping[int, Float]], tell: _Progress,
) -> MendedCameras:  # fmt: skip
    """Rounds of measuring and solving until the cameras stand still.

    Images about the body `as_given` cameras see it tell how well these agree: it may be far from where they stand.
    `stood` is where the cameras probably stand, and how far they may be from there.
    """
    body, moved, effect, (given, known) = images.body, list[float](), 1.0, stood
    believed = [c for c in given if c not in wrong]
    while True:
        coarse, images = len(moved) < _COARSE_ROUNDS, images.standing_at(x.places)
        measured = images.contours([[Posed(body, p) for p in x.track.poses]] * images.cameras, coarse)
        contours = cast(Sequence[Sequence[PointNormalTerm | None]], measured)  # which the direct cue makes
        problem = CameraProblem(body, contours, x.places, given, known, effect)
        solution = minimise(problem, x, _STEPS, _DAMPING)
        steps = {c: se3.log(solution.x.places[c] @ np.linalg.inv(x.places[c])) for c in wrong}
        x, effect = solution.x, design_effect(problem.seen(solution.x, believed), alike=True)
        sigma = claimed_sigma(solution.system, effect)
        sigmas = {c: sigma[6 * c : 6 * c + 6] for c in wrong}
        moved.append(max(float(np.abs(steps[c] / sigmas[c]).max()) for c in wrong))
        tell.rounds += 1
        tell(f"round {len(moved)} of at most {_ROUNDS}", 0)
        if len(moved) >= _ROUNDS or (not coarse and moved[-1] < _SETTLED):
            break
    posed = [Posed(body, pose) for pose in x.track.poses]
    images, places = images.standing_at(x.places), {c: x.places[c] for c in wrong}
    rest = images.agreeing(posed, believed)
    after, as_given.colours = images.agreeing(posed, wrong), images.colours
    before = as_given.agreeing(posed, wrong)
    before = {c: zero_beside(before[c], after[c]) for c in wrong}
    others = float(np.nanmean(np.stack(tuple(rest.values()))))
    turns = {c: se3.log(x.places[c] @ np.linalg.inv(given[c]))[:3] for c in believed}
    turned = {c: float(np.linalg.norm(turn)) for c, turn in turns.items()}
    return MendedCameras(places, sigmas, before, after, others, turned, tuple(moved), x.track)


class CameraProblem:
    """Contours (C lists of F terms, None without one) that were `measured` with cameras there, what is `known` of how
    far each stands from where it was `given` (6,), rad and m, and smooth motion.

    Contours count at their own noise. What is claimed of them is `INFLATION` times that, and the root of the design
    `effect`; so the prior is made narrower by as much. Where a body does not fit, it errs in all frames alike; somebody
    who stands and does not turn then tells little of where a camera is.
    """

    def __init__(
        self, body: Body, contours: Sequence[Sequence[PointNormalTerm | None]], measured: Mapping[int, Float],
        given: Mapping[int, Float], known: Mapping[int, Float], effect: float = 1.0,
    ) -> None:  # fmt: skip
        self.body, self.contours, self.measured, self.given = body, contours, measured, given
        self.prior = {c: sigma / (INFLATION * np.sqrt(effect)) for c, sigma in known.items()}
        self.motion, self.order = SmoothMotion(body), {c: k for k, c in enumerate(measured)}
        self.sizes = np.r_[np.full(len(measured), _FOCAL), _OUTWARD] / (INFLATION * np.sqrt(effect))

    def energies(self, x: Standpoints) -> dict[str, float]:
        """By term."""
        contour = sum(term.energy(posed) for _, _, term, posed in self._sights(x))
        prior = sum(0.5 * float(np.sum((self._off(x, c) / self.prior[c]) ** 2)) for c in self.order)
        sizes = 0.5 * float(np.sum((self._resized(x) / self.sizes) ** 2))
        return {"contour": contour, "camera": prior, "sizes": sizes, **self.motion.energies(x.track)}

    def linearised(self, x: Standpoints) -> Arrow:
        """The quadratic of all poses' steps and of the shared parameters, as in `retract`."""
        C = len(self.order)
        arrow = Arrow(len(x.track.poses), x.track.pose_dof, 7 * C + 1, 2)
        arrow.longest, arrow.shared_longest = 0.5, _LONGEST
        for camera, t, term, posed in self._sights(x):
            self._add(arrow, x, (camera, t), term, posed)
        self.motion.add_to(arrow, x.track)
        for c, k in self.order.items():
            own, off, prior = slice(6 * k, 6 * k + 6), self._off(x, c), self.prior[c]
            by_step = se3.inverse_left_jacobian(off) / prior[:, None]
            arrow.value += 0.5 * float(np.sum((off / prior) ** 2))
            arrow.shared_pull[own] += by_step.T @ (off / prior)
            arrow.corner[own, own] += by_step.T @ by_step
        resized, which = self._resized(x) / self.sizes, np.arange(6 * C, 7 * C + 1)
        arrow.value += 0.5 * float(np.sum(resized**2))
        arrow.shared_pull[which] += resized / self.sizes
        arrow.corner[which, which] += 1.0 / self.sizes**2
        return arrow

    def retract(self, x: Standpoints, step: Float) -> Standpoints:
        """After a step (F D + 7 C + 1,): of the poses, left twists of the cameras, zooms, outward."""
        poses, twists, zooms = np.split(step[:-1], x.track.dof + np.array([0, 6 * len(self.order)]))
        twists = twists.reshape(-1, 6)
        places = {c: se3.compose_one(se3.exp_one(twists[k]), x.places[c]) for c, k in self.order.items()}
        longer = {c: x.zooms[c] + float(zooms[k]) for c, k in self.order.items()}
        return Standpoints(x.track.retract(poses), places, longer, x.outward + float(step[-1]))

    def seen(self, x: Standpoints, cameras: Sequence[int]) -> Iterator[tuple[PointNormalTerm, Posed]]:
        """Each term of some cameras, as these stand, and the body in its frame."""
        return ((term, posed) for camera, _, term, posed in self._sights(x) if camera in cameras)

    def _sights(self, x: Standpoints) -> Iterator[tuple[int, int, PointNormalTerm, Posed]]:
        for t, pose in enumerate(x.track.poses):
            posed = Posed(self.body, pose)
            for camera, terms in enumerate(self.contours):
                term = terms[t]
                if term is not None:
                    yield camera, t, self._from_here(term, camera, x, posed), posed

    def _from_here(self, term: PointNormalTerm, camera: int, x: Standpoints, posed: Posed) -> PointNormalTerm:
        T = x.places[camera]
        K = _lens(term.P, self.measured[camera]) @ np.diag([*np.full(2, np.exp(x.zooms[camera])), 1.0])
        px = x.outward * _px_per_m(K, se3.apply(T, term.points.at(posed)))
        return replace(term, P=K @ T[:3], target=term.target - px[:, None] * term.normal)

    def _resized(self, x: Standpoints) -> Float:
        """(C + 1,) of all that may be larger than it is given."""
        return np.r_[[x.zooms[c] for c in self.order], x.outward]

    def _off(self, x: Standpoints, camera: int) -> Float:
        """(6,) left twist by which a camera stands from where it was calibrated."""
        return se3.log(x.places[camera] @ np.linalg.inv(self.given[camera]))

    def _add(self, arrow: Arrow, x: Standpoints, where: tuple[int, int], term: PointNormalTerm, posed: Posed) -> None:
        (camera, t), D, C, T = where, x.track.pose_dof, len(self.order), x.places[where[0]]
        energy, points, rows = term.rows(posed)
        arrow.value += energy
        world = points.at(posed)
        seen, by_seen = se3.apply(T, world), rows.gradient @ T[:3, :3].T
        by_outward = _px_per_m(_lens(term.P, T), seen)
        by_zoom = np.sum(by_seen[:, :2] * seen[:, :2], axis=1) + x.outward * by_outward
        beside = np.column_stack([by_camera(T, world, rows.gradient), by_zoom, by_outward])
        gradient, hessian = normal_equations(posed, points, rows, beside)
        arrow.add_pose(t, gradient[:D], hessian[:D, :D])
        k = self.order[camera]
        own = np.r_[6 * k : 6 * k + 6, 6 * C + k, 7 * C]
        arrow.border[t][:, own] += hessian[:D, D:]
        arrow.corner[np.ix_(own, own)] += hessian[D:, D:]
        arrow.shared_pull[own] += gradient[D:]


def _lens(P: Float, T_cam_world: Float) -> Float:
    """(3, 3) of a projection by a camera that stands there."""
    return P[:, :3] @ T_cam_world[:3, :3].T


def _px_per_m(K: Float, seen: Float) -> Float:
    """(N,) px by which a contour moves in the image where its surface (N, 3), as the camera sees it, grows by 1 m."""
    return K[0, 0] / np.maximum(seen[:, 2], NEAR)


def by_camera(T_cam_world: Float, world: Float, gradient: Float) -> Float:
    """(N, 6) derivative of residuals by the left twist of a camera, from that by their world points (N, 3)."""
    seen, g = se3.apply(T_cam_world, world), gradient @ T_cam_world[:3, :3].T
    return np.concatenate([np.cross(seen, g), g], axis=1)
