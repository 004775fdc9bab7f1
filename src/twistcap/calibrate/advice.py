"""A calibration in numbers and sentences: how good it is, what is odd about it, and what to film again."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.calibrate.calibrate import Calibration
from twistcap.calibrate.sightings import SCENE, Sighting, coverage
from twistcap.calibrate.world import centre_covariance
from twistcap.errors import InputError
from twistcap.io.plausible import camera_distances, check_plausible, span_in_words

_SURE = 4.0  # standard deviations from which on something is mentioned
_WRONG = 0.05  # share of wrong points from which on they are mentioned
_EMPTY = 0.25  # share of the image without any point from which on it is mentioned
_SHARED = 8  # moments with others that a camera needs
_FOCAL, _PLACE = 0.003, 0.01  # standard deviations, share and m, above which more filming is advised
_APART, _AWAY = (0.5, 20.0), (0.2, 15.0)  # m: of the cameras farthest apart; of the board from cameras, mostly
_STRETCH, _BENT = 0.003, 0.003  # share, m
_LATE = 0.1  # frames


def camera_rows(found: Calibration) -> list[dict[str, Any]]:
    """What is known of each camera: a row of plain values, px, m, degrees, frames of the slowest camera, s."""
    out, a, (late, late_sigmas) = list[dict[str, Any]](), found.adjustment, found.late
    tick = found.timing.interval
    for c, camera in enumerate(found.rig):
        sizes = distances(found, c)
        own = [s for s in a.sightings if s.camera == c]
        sigma = np.sqrt(np.diagonal(a.lenses[c]))
        measured, wrong = _measured(found, c)
        row = {
            "camera": camera.name, "lens": a.guess.lenses[c].kind, "focal_px": float(np.mean(np.diag(camera.K)[:2])),
            "focal_sigma": float(sigma[0]), "sightings": len(own), "points": len(sizes),
            "wrong": 1.0 - float(np.mean(np.concatenate([k for s, k in kept(found) if s.camera == c]))),
            "rms_px": float(np.sqrt(np.mean(sizes**2))), "median_px": float(np.median(sizes)),
            "covered": float(np.mean(coverage(own, camera.size) > 0)), "centre_m": camera.centre,
            "centre_sigma_m": np.sqrt(np.diagonal(centre_covariance(camera.T_cam_world, a.places[c]))),
            "turn_sigma_deg": float(np.rad2deg(np.sqrt(np.trace(a.places[c][:3, :3])))),
            "measured_px": measured, "measured_wrong": wrong, "late_frames": float(late[c]),
            "late_sigma": float(late_sigmas[c]), "late_s": tick * float(late[c]),
        }  # fmt: skip
        out.append(row)
    return out


def kept(found: Calibration) -> list[tuple[Sighting, AnyArray]]:
    """Each sighting with which of its points (N,) were taken for right."""
    return list(zip(found.adjustment.sightings, found.adjustment.kept, strict=True))


def distances(found: Calibration, camera: int) -> Float:
    """(N,) px from the points of a camera that were taken for right to where its calibration has them."""
    a = found.adjustment
    parts = zip(a.sightings, a.kept, a.residuals, strict=True)
    own = [np.linalg.norm(r[k], axis=1) for s, k, r in parts if s.camera == camera]
    return np.concatenate(own) if own else np.zeros(0)


def sentences(found: Calibration) -> list[str]:
    """What a user should know, the weightiest first."""
    rows = camera_rows(found)
    out = [_line(row) for row in rows]
    world = [*_world(found), *_implausible(found), *_scale(found)]
    return [*out, *world, *_clocks(found, rows), *_board(found), *again(found)]


def again(found: Calibration) -> list[str]:
    """What to film again."""
    out = list[str]()
    for c, row in enumerate(camera_rows(found)):
        name = row["camera"]
        empty = _empty_side(found, c)
        if empty:
            out.append(f"Camera {name}: no point was seen in {empty} of its image; show the board there.")
        if row["measured_wrong"]:
            which = ", ".join(row["measured_wrong"])
            out.append(f"Camera {name}: measured points that do not fit: {which}; look at their places and pixels.")
        if row["focal_sigma"] > _FOCAL:
            reason = f"its focal length is known to {100 * row['focal_sigma']:.1f} % only"
            out.append(f"Camera {name}: {reason}; tilt the board before it, near, by 30 to 45 degrees each way.")
        if float(np.max(row["centre_sigma_m"])) > _PLACE:
            reason = f"its place is known to {1e3 * float(np.max(row['centre_sigma_m'])):.0f} mm only"
            out.append(f"Camera {name}: {reason}; film the board where it and others see it, over all of the space.")
        if row["wrong"] > _WRONG:
            reason = f"{100 * row['wrong']:.0f} % of its points were wrong and left out"
            out.append(f"Camera {name}: {reason}; film slower, in more light, and keep the board flat.")
    return out + _lonely(found)


def _line(row: dict[str, Any]) -> str:
    lens = "" if row["lens"] == "brown" else " (fisheye)"
    where = 1e3 * float(np.max(row["centre_sigma_m"]))
    scene = "" if row["measured_px"] is None else f" measured points {row['measured_px']:.2f} px off (median),"
    return (
        f"Camera {row['camera']}{lens}: {row['rms_px']:.2f} px rms over {row['points']} points,{scene} focal length"
        f" {row['focal_px']:.0f} px ± {100 * row['focal_sigma']:.2f} %, place ± {where:.1f} mm,"
        f" ± {row['turn_sigma_deg']:.2f}°."
    )


def _measured(found: Calibration, camera: int) -> tuple[float | None, list[str]]:
    """Px by which the measured points of the scene are off, the median, and the names of those that were left out."""
    a = found.adjustment
    for s, keep, off in zip(a.sightings, a.kept, a.residuals, strict=True):
        if s.moment == SCENE and s.camera == camera:
            wrong = [found.points[k] for k in s.ids[~keep].tolist()]
            return float(np.median(np.linalg.norm(off[keep], axis=1))), wrong
    return None, []


def _world(found: Calibration) -> list[str]:
    if found.floor_known:
        return []
    return [
        "The floor is not known: up is a guess by the images, and z = 0 is amid the board's places. Film the board as"
        " it lies on the floor and name that frame with --floor. Else `twistcap new` sets floor = false in the session."
    ]


def _implausible(found: Calibration) -> list[str]:
    try:
        check_plausible(found.rig, floor=0.0 if found.floor_known else None)
    except InputError as error:
        side = f"is the square of the board truly {1e3 * found.board.square:g} mm?"
        return [f"This calibration cannot be: {str(error).removesuffix('.')}; {side}"]
    return []


def _scale(found: Calibration) -> list[str]:
    """The distances that follow from the square of the board, which the pictures cannot tell: a user can."""
    apart, away = camera_distances(found.rig), np.percentile(_board_distances(found), (5, 95))
    facts = [f"the cameras are {span_in_words(apart)} apart"] if len(apart) else []
    facts += [f"the board was {span_in_words(away)} from them"]
    odd = len(apart) and not _APART[0] < float(apart.max()) < _APART[1]
    odd = odd or not _AWAY[0] < float(away[0]) or float(away[1]) > _AWAY[1]
    known = "its points" if "scene" in found.adjustment.solids else f"{1e3 * found.board.square:g} mm a square"
    told = f"By {known}, {' and '.join(facts)}"
    if odd:
        return [f"{told}: that is hardly so. Measure the squares again, name them in --board, and calibrate again."]
    return [f"{told}. If that is not so, measure and calibrate once more: pictures do not tell the scale."]


def _board_distances(found: Calibration) -> Float:
    """(S,) m from cameras to the middle of the board, of each sighting of it."""
    guess, middle = found.adjustment.guess, np.append(found.board.points.mean(axis=0), 1.0)
    seen = [s for s in found.adjustment.sightings if s.moment in guess.boards]
    places = np.array([(guess.places[s.camera] @ guess.boards[s.moment] @ middle)[:3] for s in seen])
    return np.linalg.norm(places, axis=1).astype(float)


def _clocks(found: Calibration, rows: Sequence[dict[str, Any]]) -> list[str]:
    """In frames where cameras are equally fast, else in seconds."""
    out, tick, alike = list[str](), found.timing.interval, found.timing.alike
    for row in rows:
        late, sigma = row["late_frames"], row["late_sigma"]
        if abs(late) > max(_LATE, _SURE * sigma):
            which = "later" if late > 0 else "earlier"
            by = f"{abs(late):.2f} ± {max(sigma, 0.01):.2f} frames"
            by = by if alike else f"{tick * abs(late):.4f} ± {max(tick * sigma, 1e-4):.4f} s"
            start = f"Camera {row['camera']} shows moments {by} {which} than camera {rows[0]['camera']}"
            out.append(f"{start}; this was allowed for. In the videos of a person, twistcap sync finds it.")
    return out


def _board(found: Calibration) -> list[str]:
    """What the pictures say about the board's print."""
    if "board" not in found.adjustment.shapes:
        return []
    shape, sigmas = found.adjustment.shapes["board"], found.adjustment.shape_sigmas["board"]
    out = list[str]()
    if abs(shape[0]) > max(_STRETCH, _SURE * sigmas[0]):
        more = "higher" if shape[0] > 0 else "lower"
        by = f"{100 * abs(shape[0]):.1f} ± {max(100 * float(sigmas[0]), 0.1):.1f} %"
        start = f"The board is {by} {more} than its width says; it was printed so"
        out.append(f"{start}: measure its squares both ways. This was allowed for.")
    bent = float(np.abs(shape[1:]).max())
    if bent > max(_BENT, _SURE * float(sigmas[1 + int(np.abs(shape[1:]).argmax())])):
        out.append(f"The board is bent by about {1e3 * bent:.0f} mm; glue it on something flat. This was allowed for.")
    return out


def _lonely(found: Calibration) -> list[str]:
    """Pairs are not all needed, but every camera needs some moments with others."""
    if "scene" in found.adjustment.solids:
        return []
    seen: dict[int, set[int]] = {}
    for s in found.adjustment.sightings:
        if s.moment != SCENE:
            seen.setdefault(s.camera, set()).add(s.moment)
    shared = dict.fromkeys(sorted(seen), 0)
    for a, b in combinations(sorted(seen), 2):
        both = len(seen[a] & seen[b])
        shared[a], shared[b] = max(shared[a], both), max(shared[b], both)
    few = [(found.rig[c].name, n) for c, n in shared.items() if n < _SHARED and len(found.rig) > 1]
    ask = "carry the board where others see it too"
    return [f"Camera {name}: it shares only {n} moments with any other camera; {ask}." for name, n in few]


def _empty_side(found: Calibration, camera: int) -> str:
    """How much of the emptiest half of the image has no points, in words; nothing where little is empty."""
    own = [s for s in found.adjustment.sightings if s.camera == camera]
    bare = coverage(own, found.rig[camera].size) == 0
    if bare.mean() < _EMPTY:
        return ""
    rows, columns = bare.shape
    halves = {
        "upper half": bare[: rows // 2], "lower half": bare[rows // 2 :],
        "left half": bare[:, : columns // 2], "right half": bare[:, columns // 2 :],
    }  # fmt: skip
    name, part = max(halves.items(), key=lambda item: float(item[1].mean()))
    return f"{100 * part.mean():.0f} % of the {name}"
