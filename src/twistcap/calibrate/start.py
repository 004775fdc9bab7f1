"""Where an adjustment starts: each lens by itself, then the cameras chained by the moments that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np

from twistcap import se3
from twistcap.arrays import AnyArray, Bool, Float
from twistcap.calibrate.adjust import Adjustment, Guess, Setup, adjust
from twistcap.calibrate.detect import on_one_plane
from twistcap.calibrate.lens import Kind, Lens
from twistcap.calibrate.sightings import Sighting, by_moment, chosen
from twistcap.calibrate.terms import Solid
from twistcap.errors import InputError

_OFF_PLANE = 6.0  # px by which a right point may miss the plane of the others, seen through a lens not yet known
_FEWEST, _MOST = 3, 30  # sightings by which a lens is fitted
_TILTED = 3  # times that a lens is fitted, at most: with a better lens a flat board may be seen tilted the other way
_OPENINGS = (0.7, 1.0, 1.4, 1.9, 2.5)  # rad across the image, with which a fisheye lens is begun
_TURN, _SHIFT = np.deg2rad(6.0), 0.12  # rad, and share of the distance, within which two moments agree on two cameras
_CLEAR = 10.0  # nats of evidence that a lens needs to be called a fisheye


@dataclass(frozen=True)
class LensFit:
    """A lens and its numbers by one camera's own sightings.

    `evidence` is what speaks for the model of the lens, nats: the Bayesian information criterion over −2.
    """

    lens: Lens
    numbers: Float
    adjustment: Adjustment
    evidence: float = 0.0


def fitted_lens(
    own: Sequence[Sighting], solid: Solid, size: tuple[int, int], name: str, kinds: Sequence[Kind]
) -> LensFit:
    """The lens of one camera: each kind is fitted to the same sightings, and the one of most evidence is taken.

    Raises InputError for a camera that saw too little.
    """
    if len(own) < _FEWEST:
        saw = f"the board was found in {len(own)} of its pictures"
        raise InputError(
            f"camera {name}: {saw}; film it nearer, slower and in more light, in at least {_FEWEST} places."
        )
    few = [replace(s, camera=0) for s in chosen(own, {own[0].camera: size}, _MOST)]
    fits = [_fit(few, solid, Lens(kind, size), name) for kind in kinds]
    if len(fits) == 1:
        return fits[0]
    noise = min(float(fit.adjustment.sigmas[0]) for fit in fits)
    judged = [replace(fit, evidence=_evidence(fit, noise)) for fit in fits]
    brown, fisheye = judged
    return fisheye if fisheye.evidence > brown.evidence + _CLEAR else brown


def placed(lens: Lens, numbers: Float, s: Sighting, solid: Solid) -> list[Float]:
    """Places `T_cam_board` that a sighting may mean, the likelier first: a flat board may be seen tilted either way."""
    return _placed(numbers, s, lens.normalised(numbers, s.pixels), solid)


def _placed(numbers: Float, s: Sighting, xy: Float, solid: Solid) -> list[Float]:
    """The same by image-plane coordinates (N, 2)."""
    good = np.all(np.isfinite(xy), axis=1) & (np.abs(xy).max(axis=1) < 10.0)
    if good.sum() < 4:
        return []
    points, image = solid.points[s.ids[good]], np.ascontiguousarray(xy[good])
    flat = bool(np.ptp(points[:, 2]) == 0.0)
    if flat:  # one wrong point may tilt the board the other way
        right = on_one_plane(points[:, :2], image, _OFF_PLANE / float(np.exp(numbers[0])))
        points, image = (points[right], image[right]) if right.sum() >= 4 else (points, image)
    flag = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_SQPNP
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(points, image, np.eye(3), np.zeros(4), flags=flag)
    except cv2.error:
        return []
    pairs = zip(turns, shifts, strict=True)
    out = [se3.transform(np.asarray(cv2.Rodrigues(r)[0], float), np.ravel(t).astype(float)) for r, t in pairs]
    return [T for T in out if np.all(np.isfinite(T)) and np.all(se3.apply(T, points)[:, 2] > 0.0)]


def chained(sightings: Sequence[Sighting], fits: Sequence[LensFit], solid: Solid, names: Sequence[str]) -> Guess:
    """All cameras and boards in the axes of one camera, along the pairs that agree in most moments.

    Raises InputError where cameras are joined by no moment, with the groups that are.
    """
    lenses, numbers = tuple(f.lens for f in fits), tuple(f.numbers for f in fits)
    seen = {(s.camera, s.moment): (s, placed(lenses[s.camera], numbers[s.camera], s, solid)) for s in sightings}
    joined = _pairs({key: places for key, (_, places) in seen.items() if places}, len(names))
    places = _tree(joined, len(names))
    _check_joined(places, names)
    boards = {}
    for moment, own in by_moment(sightings).items():
        there = [(s, T) for s in own for T in seen[s.camera, moment][1]]
        guesses = [se3.inverse(places[s.camera]) @ T for s, T in there]
        if guesses:
            boards[moment] = min(guesses, key=lambda T: misfit(T, own, places, lenses, numbers, solid))
    noise = tuple(float(f.adjustment.sigmas[0]) for f in fits)
    return Guess(lenses, numbers, tuple(places[c] for c in range(len(names))), boards, noise, (0.0,) * len(names))


def _fit(few: Sequence[Sighting], solid: Solid, lens: Lens, name: str) -> LensFit:
    if lens.kind == "brown":
        starts = _brown_starts(few, solid, lens)
    else:
        starts = [_plain(lens, lens.side / opening) for opening in _OPENINGS]  # px for each rad
    best = min(starts, key=lambda numbers: float(np.mean([off for off, _ in best_places(few, solid, lens, numbers)])))
    fit = _fit_from(few, solid, lens, best)
    if fit is None:
        why = "no lens explains its pictures of the board; check --board, and film it again"
        raise InputError(f"camera {name}: {why}.")
    return fit


def best_places(own: Sequence[Sighting], solid: Solid, lens: Lens, numbers: Float) -> list[tuple[float, Float | None]]:
    """Of the places `T_cam_board` that each sighting may mean, the least distance of its points, px, and that place;
    None where it means none."""
    xy = lens.normalised(numbers, np.concatenate([np.zeros((0, 2)), *(s.pixels for s in own)]))
    ways = [_placed(numbers, s, plane, solid) for s, plane in zip(own, _by_sighting(xy, own), strict=True)]
    pairs = [(s, T) for s, places in zip(own, ways, strict=True) for T in places]
    off = iter(_misfits(pairs, lens, numbers, solid))
    return [min(((next(off), T) for T in places), key=lambda p: p[0], default=(1e3, None)) for places in ways]


def _by_sighting(values: Float, own: Sequence[Sighting]) -> list[Float]:
    """Values of all points, apart."""
    return np.split(values, np.cumsum([len(s.ids) for s in own])[:-1])


def _fit_from(few: Sequence[Sighting], solid: Solid, lens: Lens, numbers: Float) -> LensFit | None:
    """The lens, begun with these numbers; and begun again, where it shows a board tilted the other way."""
    fit: LensFit | None = None
    for _ in range(_TILTED):
        ways = zip(few, best_places(few, solid, lens, numbers), strict=True)
        boards = {s.moment: T for s, (_, T) in ways if T is not None}
        if len(boards) < _FEWEST or (fit is not None and not _tilted(boards, fit.adjustment.guess.boards)):
            return fit
        guess = Guess((lens,), (numbers,), (np.eye(4),), boards, (1.0,), (0.0,))
        own = tuple(s for s in few if s.moment in boards)
        try:
            out = adjust(Setup(guess, own, {"board": solid}))
        except InputError:
            return fit
        if fit is not None and out.energy >= fit.adjustment.energy:
            return fit
        numbers = out.guess.numbers[0]
        fit = LensFit(lens, numbers, out)
    return fit


def _tilted(boards: Mapping[int, Float], others: Mapping[int, Float]) -> bool:
    """Whether a board is turned otherwise, or is no longer there."""
    return any(m not in others or not _alike(T, others[m][None])[0] for m, T in boards.items())


def _brown_starts(few: Sequence[Sighting], solid: Solid, lens: Lens) -> list[Float]:
    points = [solid.points[s.ids].astype(np.float32) for s in few]
    pixels = [s.pixels.astype(np.float32) for s in few]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO
    starts = [_plain(lens, f * lens.side) for f in (0.6, 1.0, 2.0)]
    K = lens.matrix(starts[1])
    flags |= cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT
    try:
        _, found, dist, _, _ = cv2.calibrateCamera(points, pixels, lens.size, K, None, flags=flags)
    except cv2.error:
        return starts
    sane = 0.2 * lens.side < found[0, 0] < 20.0 * lens.side and np.abs(dist).max() < 2.0
    return [*starts, lens.numbers(np.asarray(found, float), np.ravel(dist).astype(float)[:5])] if sane else starts


def _plain(lens: Lens, focal: float) -> Float:
    """The numbers of a lens without distortion, its axis in the middle."""
    numbers = np.zeros(len(lens.sigmas))
    numbers[:2] = np.log(focal)
    return numbers


def _evidence(fit: LensFit, noise: float) -> float:
    """Robust log-likelihood at a common noise, less half the numbers of the lens times the log of the samples."""
    squares = np.concatenate([np.sum((r / noise) ** 2, axis=1) for r in fit.adjustment.residuals])
    loss = 0.5 * np.minimum(np.nan_to_num(squares, nan=16.0), 16.0)
    return -float(loss.sum()) - 0.5 * len(fit.numbers) * float(np.log(2 * len(squares)))


def _pairs(seen: Mapping[tuple[int, int], list[Float]], count: int) -> dict[tuple[int, int], tuple[int, Float]]:
    """By pair of cameras: in how many moments they agree on their places, and the place of the second by the first."""
    out = {}
    for a, b in combinations(range(count), 2):
        shared = sorted({m for c, m in seen if c == a} & {m for c, m in seen if c == b})
        choices = [[B @ se3.inverse(A) for A in seen[a, m] for B in seen[b, m]] for m in shared]
        if shared:
            every, moment = np.concatenate(choices), np.repeat(np.arange(len(shared)), [len(ways) for ways in choices])
            out[a, b] = _agreed(every, moment)
    return out


def _agreed(every: Float, moment: AnyArray) -> tuple[int, Float]:
    """Of motions (N, 4, 4), each one that a moment (N,) allows: the one like those of most moments, in how many, and
    the mean of the first like it of each."""
    like = [_alike(T, every) for T in every]
    votes = np.array([len(np.unique(moment[own])) for own in like])
    best = int(np.argmax(votes))
    T, others = every[best], np.flatnonzero(like[best])
    own = every[others[np.unique(moment[others], return_index=True)[1]]]
    turn = np.median(se3.log_rotation(own[:, :3, :3] @ T[:3, :3].T), axis=0)
    mean = se3.transform(se3.exp_rotation(turn) @ T[:3, :3], np.median(own[:, :3, 3], axis=0))
    return int(votes[best]), mean


def _alike(T: Float, others: Float) -> Bool:
    """(N,) which of some motions are nearly T."""
    cosine = 0.5 * (np.einsum("ij,nij->n", T[:3, :3], others[:, :3, :3]) - 1.0)
    reach = max(float(np.linalg.norm(T[:3, 3])), 0.1)
    near = np.linalg.norm(T[:3, 3] - others[:, :3, 3], axis=1) < _SHIFT * reach
    return np.asarray(near & (cosine > np.cos(_TURN)), np.bool_)


def _tree(joined: Mapping[tuple[int, int], tuple[int, Float]], count: int) -> dict[int, Float]:
    """`T_cam_world` by camera, along the strongest pairs, in the axes of the camera that has the strongest."""
    strength = [sum(n for pair, (n, _) in joined.items() if c in pair) for c in range(count)]
    places = {int(np.argmax(strength)): np.eye(4)}
    while True:
        edges = [(n, a, b, T) for (a, b), (n, T) in joined.items() if (a in places) != (b in places)]
        if not edges:
            return places
        _, a, b, T = max(edges, key=lambda edge: edge[0])
        if a in places:
            places[b] = T @ places[a]
        else:
            places[a] = se3.inverse(T) @ places[b]


def _check_joined(places: Mapping[int, AnyArray], names: Sequence[str]) -> None:
    alone = [name for c, name in enumerate(names) if c not in places]
    if alone:
        there = ", ".join(names[c] for c in sorted(places))
        raise InputError(
            f"the board was never seen by {', '.join(alone)} together with {there}; film it where both see it at once,"
            " or where another camera sees it with each of them."
        )


def misfit(
    T: Float, own: Sequence[Sighting], places: Mapping[int, Float], lenses: Sequence[Lens], numbers: Sequence[Float],
    solid: Solid,
) -> float:  # fmt: skip
    """Median distance, px, of the points of a board at T from all cameras' pixels."""
    off = [_misfits([(s, places[s.camera] @ T)], lenses[s.camera], numbers[s.camera], solid) for s in own]
    return float(np.mean(off))


def _misfits(pairs: Sequence[tuple[Sighting, Float]], lens: Lens, numbers: Float, solid: Solid) -> list[float]:
    """The same of each sighting of one camera with the board at a place `T_cam_board`."""
    if not pairs:
        return []
    own = [s for s, _ in pairs]
    seen = np.concatenate([se3.apply(T, solid.points[s.ids]) for s, T in pairs])
    pixels = lens.pixels(numbers, np.where(seen[:, 2:] > 0.02, seen, np.nan))
    off = np.nan_to_num(np.linalg.norm(pixels - np.concatenate([s.pixels for s in own]), axis=1), nan=1e4)
    return [float(np.median(part)) for part in _by_sighting(off, own)]
