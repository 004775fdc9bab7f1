"""``twistcap refine --cameras``: cameras that were bumped or badly calibrated, from the tracked body."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.errors import InputError

_OFTEN = 10  # frames in which a camera was left out, from which on it is mended by itself
_MOST = 150  # frames that are used, spread evenly
_FEWEST = 24
_GOOD = 0.75  # share of the agreement of the other cameras that a mended one must reach
_GAIN = 0.05  # of its agreement
_TURNED = np.deg2rad(0.5)  # from which on another camera, which had to be turned as well, is taken for the one that was
ELSEWHERE = "seems to stand elsewhere than it was calibrated"
_FOUND = (
    "off_px", "turned_deg", "turned_sigma_deg", "moved_mm", "moved_sigma_mm", "agreed_before", "agreed_after",
    "from_frame", "instead",
)  # fmt: skip


def mend_cameras(path: Path, out: Path, session: Any, names: Sequence[str] = ()) -> dict[str, Any]:
    """Estimate where cameras of a result stand, and write a new calibration into a folder; what ``--json`` prints.

    Without names, those are mended that the tracker left out, turned back or suspected. Each is looked for by itself;
    others that are wrong are not believed until they are mended. Where a camera that holds the world had to be turned
    as well, that one is mended instead: it stands near, and has outvoted the others.

    Raises InputError where no camera is wrong, or too few frames or cameras are left.
    """
    from twistcap.io.calibration import knows_floor, read_rig, write_rig
    from twistcap.io.result import read_result

    result = read_result(path)
    suspected = _suspected(result, session, path)
    wrong = _wrong(result, names, suspected, path)
    given = read_rig(session.cameras.calibration, session.cameras.unit, floor=None)
    goal = terminal.new_calibration(out, Path(session.cameras.calibration))
    rows, mended = _each_mended(result, session, wrong, suspected)
    if not names and (one := _one_instead(result, session, rows, suspected)) is not None:
        wrong, rows, mended = one
    sure = [row["camera"] for row in rows if row["sure"]]
    if sure:
        there, floor = _in_file(given, result.rig, mended, sure), knows_floor(session.cameras.calibration)
        write_rig(there, goal, session.cameras.unit or "m", floor)
    held = [camera.name for c, camera in enumerate(result.rig) if c not in wrong]
    about = {"id": "refine-cameras", "result": path, "cameras": rows, "held_by": held}
    return about | {"calibration": goal if sure else None}


def _each_mended(
    result: Any, session: Any, wrong: Sequence[int], suspected: Mapping[int, int]
) -> tuple[list[dict[str, Any]], Any]:
    """Rows of the table, and the rig with those cameras where they stand that are surely found."""
    from twistcap.io.recording import views_of

    rows, mended = list[dict[str, Any]](), result.rig
    for c in wrong:
        views = views_of(session, mended)
        others = [k for k in wrong if k != c and mended[k] is result.rig[k]]
        known = [k for k in wrong if mended[k] is not result.rig[k]]
        row, place = _mended(_as_mended(result, known), views, session, c, others, suspected.get(c, 0))
        rows.append(row)
        if row["sure"]:
            camera = replace(mended[c], T_cam_world=place)
            mended = replace(mended, cameras=(*mended.cameras[:c], camera, *mended.cameras[c + 1 :]))
    return rows, mended


def _one_instead(
    result: Any, session: Any, rows: Sequence[dict[str, Any]], suspected: Mapping[int, int]
) -> tuple[list[int], list[dict[str, Any]], Any] | None:
    """The one camera that had to be turned as well, if all others agree once it alone is mended: its number, its row
    and the rig. All others are believed then.
    """
    wrong = [result.rig.names.index(row["camera"]) for row in rows]
    since = min(_since(_wrong_in(result)[:, c]) or suspected.get(c, 0) for c in wrong)
    believed = replace(result, left_out=np.zeros_like(result.left_out), bumps=np.zeros_like(result.bumps))
    for c in sorted({result.rig.names.index(row["instead"]) for row in rows if row["instead"]} - {*wrong}):
        (row,), mended = _each_mended(believed, session, [c], {c: since})
        if row["sure"]:
            return [c], [row], mended
    return None


def _in_file(given: Any, turned: Any, mended: Any, names: Sequence[str]) -> Any:
    """The cameras of the session's file, those of `names` at their new places.

    The file's world may be turned to have z up: `turned` are its cameras as they were tracked with, `mended` as found.
    """
    cameras = {camera.name: camera for camera in given}
    for name in names:
        k = turned.names.index(name)
        back = np.linalg.inv(turned[k].T_cam_world) @ cameras[name].T_cam_world
        cameras[name] = replace(cameras[name], T_cam_world=mended[k].T_cam_world @ back)
    return replace(given, cameras=tuple(cameras.values()))


def mend_in_words(result: Any, path: Path, elsewhere: Collection[int] = ()) -> list[str]:
    """One statement on the cameras that were left out often, also at the end, or stand bumped or seem to stand
    `elsewhere` there, with what is to be done; none where all is well.
    """
    out, bumped = _wrong_in(result), np.any(result.bumps[-1:], axis=2).any(axis=0)
    facts = dict[str, str]()
    for c, name in enumerate(result.rig.names if len(out) else ()):
        if out[-1, c] and bumped[c]:
            facts[name] = "still stands bumped"
        elif out[-1, c] and out[:, c].sum() >= _OFTEN:
            facts[name] = "was left out to the end"
        elif c in elsewhere:
            facts[name] = ELSEWHERE
    if not facts:
        return []
    left = len(result.rig) - len({*_often(out), *elsewhere})  # that `--cameras` would believe
    said = [f"Camera {name} {fact}." for name, fact in facts.items()]
    late = set(facts.values()) != {"still stands bumped"}
    return [" ".join([*said, _mend(path, list(facts), len(result.rig) - len(facts), left, late)])]


def places_and_clocks(places: list[str], clocks: list[str]) -> list[str]:
    """What is said of the places and of the clocks of cameras; where of both, which is to be found first."""
    first = ["A camera that stands elsewhere seems late too, and may make others seem so: find the places first."]
    return [*places, *(first if places and clocks else []), *clocks]


def _mend(path: Path, names: Sequence[str], others: int, left: int, late: bool) -> str:
    """What is to be done about cameras; `others` are not named, `left` would be believed if none is named to `refine`.

    Without `late` it is sure that they were bumped.
    """
    from twistcap.io.files import pasted

    refine = f"twistcap refine {pasted(path)}"
    it_was, its, s = ("it was", "its", "") if len(names) == 1 else ("they were", "their", "s")
    sync = f"; if late, twistcap sync {its} offset{s}" if late else ""
    if others < 2 and len(names) == 1:
        return f"If {it_was} bumped, calibrate again: two others must be right to find its new place{sync}."
    if others < 2:
        one = f"If one alone was bumped, name it, as {refine} --camera {pasted(names[0])}"
        return f"{one}; if more were, calibrate again: two must be right to find the places of others{sync}."
    which = "--cameras" if left >= 2 else " ".join(f"--camera {pasted(name)}" for name in names)
    found = f"{refine} {which} finds {its} new place{s}"
    return f"If {it_was} bumped, {found}{sync}." if late else f"{found}."


def _suspected(result: Any, session: Any, path: Path) -> dict[int, int]:
    """Numbers of the cameras that the tracker suspected at its end, with the row from which on.

    None in a result without a state, or of another version or other settings.
    """
    from twistcap.commands.clocks import watched_by
    from twistcap.commands.follow import resumed
    from twistcap.commands.track import session_tracker
    from twistcap.io.recording import views_of

    tracker = session_tracker(session, result.body, views_of(session, result.rig), watch=True)
    try:
        resumed(tracker, path)
    except InputError:
        return {}
    watched, seen = watched_by(tracker), [row for row, e in enumerate(result.estimates) if e.seen]
    since = () if watched is None else watched.since
    return {c: seen[min(n, len(seen) - 1)] for c, n in enumerate(since) if n >= 0}


def _wrong(result: Any, names: Sequence[str], suspected: Collection[int], path: Path) -> list[int]:
    """Numbers of the cameras to be mended."""
    for name in names:
        if name not in result.rig.names:
            raise InputError(
                f"--camera names {name!r}, which {path} does not have; it has {', '.join(result.rig.names)}."
            )
    wrong = [result.rig.names.index(name) for name in names]
    wrong = wrong or sorted({*_often(_wrong_in(result)), *suspected})
    if not wrong:
        none = f"no camera was left out or stood bumped in {_OFTEN} frames, or seemed to stand elsewhere at the end"
        raise InputError(f"{path}: {none}; name one that is wrong with --camera.")
    if len(result.rig) - len(wrong) < 2:
        bad = ", ".join(result.rig.names[c] for c in wrong)
        raise InputError(
            f"{path}: of {len(result.rig)} cameras {bad} are wrong; two must be right to mend the others:"
            f" name one alone with --camera, or calibrate again."
        )
    return wrong


def _often(wrong: Any) -> list[int]:
    """Numbers of the cameras that were wrong in many frames of (N, C)."""
    return np.flatnonzero(wrong.sum(axis=0) >= _OFTEN).tolist()


def _mended(
    result: Any, views: Any, session: Any, camera: int, others: Sequence[int], suspected: int
) -> tuple[dict[str, Any], Any]:
    """One row of the table, and `T_cam_world` of a camera, which was `suspected` from a row on where not left out."""
    from twistcap.adjust.cameras import agreement_at, holds_from, mended_cameras

    name, first = result.rig.names[camera], _since(_wrong_in(result)[:, camera]) or suspected
    chosen = _frames(result, first, camera, others)
    if len(chosen) < _FEWEST:
        reason = f"only {len(chosen)} good frames show it where it stands now; track at least {_FEWEST}"
        return {"camera": name, **dict.fromkeys(_FOUND), "frames": len(chosen), "sure": False, "reason": reason}, None
    rest, settings = (result.body, views.image_rig), session.tracker_settings
    with terminal.status(f"mending {name}") as report:
        found = mended_cameras(lambda: _shown(views, chosen), *rest, chosen, [camera], settings, report)
    place = found.places[camera]
    before, after = (float(np.nanmean(by[camera])) for by in (found.before, found.after))
    with terminal.status(f"looking when {name} was moved"):
        whole = _frames(result, 0, camera, others)
        first = holds_from(*agreement_at(_shown(views, whole), *rest, whole, camera, place, settings))
    held = max(found.turned, key=lambda c: found.turned[c])
    instead = result.rig.names[held] if found.turned[held] > _TURNED else None
    reason = _doubt(before, after, found.others)
    if instead and not reason:
        reason = f"camera {instead} had to be turned by {np.rad2deg(found.turned[held]):.1f}° to agree with it; one of"
        reason += " the two was bumped"
    return {
        "camera": name, **_off(result, found, camera), "agreed_before": before, "agreed_after": after,
        "from_frame": whole[first].index if first < len(whole) else None, "frames": len(chosen),
        "sure": not reason, "reason": reason, "instead": instead,
    }, place  # fmt: skip


def _doubt(before: float, after: float, others: float) -> str:
    """Why a camera's calibration stays; "" where the new one is better."""
    if after >= before + _GAIN and after >= _GOOD * others:
        return ""
    if before >= _GOOD * others:
        return f"it agrees with the others as it is calibrated ({100 * before:.0f} %)"
    return "no place of it agrees with the others; it may be late, frozen or swapped"


def _wrong_in(result: Any) -> Any:
    """(N, C) frames in which each camera was left out, or stood as it has stood bumped at the end, and not swayed."""
    from twistcap.adjust.cameras import SWAYS

    alike = np.linalg.norm(result.bumps - result.bumps[-1:], axis=2) < SWAYS
    stands = np.any(result.bumps[-_OFTEN:], axis=2).all(axis=0) & alike[-_OFTEN:].all(axis=0)
    return result.left_out | (alike & stands)


def _since(wrong: Any) -> int:
    """Row of (F,) at which the last stretch begins in which a camera is mostly wrong; 0 without one.

    A stretch has a surplus of `_OFTEN` such rows, and ends with a gap of at most `_FEWEST` others.
    """
    start, begun, surplus = 0, 0, 0
    for row, out in enumerate(wrong):
        begun = begun if surplus else row
        surplus = min(max(surplus + (1 if out else -1), 0), _FEWEST)
        start = begun if surplus >= _OFTEN else start
    return start


def _shown(views: Any, chosen: Sequence[Any]) -> Iterator[Any]:
    """The frames of estimates."""
    kept = {e.index for e in chosen}
    span = replace(views, indices=range(chosen[0].index, chosen[-1].index + 1))
    return (frame for frame in span if frame.index in kept)


def _frames(result: Any, first: int, camera: int, others: Sequence[int]) -> list[Any]:
    """Good estimates from a row on, spread evenly, in which the camera is believed and the others are not."""
    rows = [e for e in result.estimates[first:] if e.seen and not e.lost]
    spread = rows[:: max(1, -(-len(rows) // _MOST))]
    return [replace(e, left_out=tuple({*e.left_out, *others} - {camera})) for e in spread]


def _as_mended(result: Any, cameras: Sequence[int]) -> Any:
    """The result, some cameras of which are no longer thought to stand turned: their calibration holds the turn."""
    if not cameras:
        return result
    return replace(result, bumps=np.where(np.isin(np.arange(len(result.rig)), cameras)[:, None], 0.0, result.bumps))


def _off(result: Any, found: Any, camera: int) -> dict[str, float]:
    """By how much the camera was off: px of the body's landmarks in its whole image, degrees, mm."""
    from twistcap import se3
    from twistcap.body import Posed

    given = result.rig[camera]
    now = replace(given, T_cam_world=found.places[camera])
    turn = se3.log_rotation(now.T_cam_world[:3, :3] @ given.T_cam_world[:3, :3].T)
    marks = np.concatenate([Posed(result.body, pose).landmarks for pose in found.poses.poses])
    apart = np.linalg.norm(now.project(marks)[0] - given.project(marks)[0], axis=1)
    sigma = found.sigmas[camera]
    return {
        "off_px": float(np.nanmean(apart)),
        "turned_deg": float(np.rad2deg(np.linalg.norm(turn))),
        "turned_sigma_deg": float(np.rad2deg(np.linalg.norm(sigma[:3]))),
        "moved_mm": 1000.0 * float(np.linalg.norm(now.centre - given.centre)),
        "moved_sigma_mm": 1000.0 * float(np.linalg.norm(sigma[3:])),
    }


def show(document: dict[str, Any]) -> None:
    """Print the end of a run for a person."""
    rows = [[r["camera"], *["–"] * 5] if r["off_px"] is None else [
        r["camera"], f"{r['off_px']:.1f}", f"{r['turned_deg']:.2f} ± {r['turned_sigma_deg']:.2f}",
        f"{r['moved_mm']:.0f} ± {r['moved_sigma_mm']:.0f}", f"{100 * r['agreed_before']:.0f} %",
        f"{100 * r['agreed_after']:.0f} %",
    ] for r in document["cameras"]]  # fmt: skip
    columns = ["camera", "was off, px", "turned, deg", "moved, mm", "agreed before", "and now"]
    terminal.show_table("cameras: against the calibration given, ± 1σ", columns, rows, ["camera"])
    for r in document["cameras"]:
        terminal.say(_sentence(r))
    if document["calibration"] is None:
        words.print("Nothing is written.")
        return
    held = document["held_by"]
    if len(held) <= sum(r["sure"] for r in document["cameras"]):
        also = f"If one of these was bumped instead, this is wrong: look for it alone, as --camera {held[0]}"
        terminal.say(f"Only {' and '.join(held)} hold the world. {also}.")
    terminal.say(f"Track again with [cameras] calibration = {str(document['calibration'])!r}.")


def _sentence(row: dict[str, Any]) -> str:
    name, frames = row["camera"], row["frames"]
    if not row["sure"]:
        return f"Camera {name}: {row['reason']} ({frames} frames). Its calibration stays."
    if row["from_frame"] is None:  # it was believed so far that the body was tracked by it
        when = "since when it holds, the body as it was tracked does not tell"
        return f"Camera {name}: the new calibration is that of {frames} frames; {when}."
    return f"Camera {name}: the new calibration holds from frame {row['from_frame']} on ({frames} frames were used)."
