"""Cameras by points of the scene that were measured, and lenses by pictures of a board that each camera took alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.calibrate.adjust import Guess, Setup, adjust
from twistcap.calibrate.board import Board
from twistcap.calibrate.calibrate import Calibration, Options
from twistcap.calibrate.sightings import SCENE, Sighting, by_camera, chosen, sharp
from twistcap.calibrate.start import LensFit, fitted_lens, misfit, placed
from twistcap.calibrate.terms import Solid, flat, measured
from twistcap.calibrate.timing import in_step
from twistcap.camera import Rig
from twistcap.doors.text import number_array, read_json_table
from twistcap.errors import InputError, check

FEWEST = 6  # measured points that a camera must see
_SIGMA = 0.003  # m, of the measured points
_CLICKED = 0.5  # px, of where they are found in the images


@dataclass(frozen=True)
class Scene:
    """Measured points: places (P, 3), world, m, their names, and pixels (x, y) by camera and number of the point."""

    points: Float
    names: tuple[str, ...]
    pixels: Mapping[str, Mapping[int, Float]]
    source: str  # the file, for messages

    def sightings(self, cameras: Sequence[str]) -> list[Sighting]:
        """What each camera sees of it. Raises InputError for a camera that sees too little."""
        out = list[Sighting]()
        for c, camera in enumerate(cameras):
            own = self.pixels.get(camera, {})
            if len(own) < FEWEST:
                few = f"camera {camera} sees {len(own)} measured points; it needs at least {FEWEST}"
                known = (
                    f"; if it is one of {', '.join(self.pixels)}, write CAMERA=PATH" if self.pixels and not own else ""
                )
                raise InputError(f"{self.source}: {few}{known}.")
            out.append(Sighting(c, SCENE, np.array(list(own), np.int32), np.array(list(own.values())), solid="scene"))
        return out


def read_scene(path: Path) -> Scene:
    """Points of a JSON table: by name ``world_m`` [x, y, z] and ``pixels``, [x, y] by camera, or null where it
    does not see it. Raises InputError."""
    return scene_of(read_json_table(path), path)


def scene_of(table: Mapping[str, Any], path: Path) -> Scene:
    """Points of a table as `read_scene` reads it from `path`. Raises InputError."""
    pixels, points = dict[str, dict[int, Float]](), list[Float]()
    for k, (name, entry) in enumerate(table.items()):
        where = f"points {path}, {name!r}"
        held: Any = entry if isinstance(entry, dict) else {}
        needs = "it needs 'world_m', three numbers, and 'pixels', by camera; `twistcap calibrate --click` asks for them"
        check(where, isinstance(held.get("pixels"), dict), needs)
        points.append(number_array(held.get("world_m"), (3,), f"{where}: 'world_m'"))
        for camera, pixel in held["pixels"].items():
            if pixel is None:  # not seen
                continue
            pixels.setdefault(camera, {})[k] = number_array(pixel, (2,), f"{where}: 'pixels' of {camera}")
    check(f"points {path}", len(points) >= FEWEST, f"it holds {len(points)} points; at least {FEWEST} are needed")
    return Scene(np.array(points), tuple(table), pixels, f"points {path}")


def calibrated_by_scene(
    scene: Scene, sightings: Sequence[Sighting], board: Board, names: Sequence[str],
    sizes: Mapping[int, tuple[int, int]], options: Options | None = None,
    report: Callable[[str], None] = lambda note: None,
) -> Calibration:  # fmt: skip
    """Calibrate by measured points, which fix the world, and pictures of a board by each camera alone.

    Args:
        scene: the points.
        sightings: of the board; no two cameras share a moment.

    Raises InputError: for a camera that saw too little of either; points that no place of a camera explains.
    """
    options, solid, every = options or Options(), flat(board.points), by_camera(sightings)
    fits = list[LensFit]()
    for c, name in enumerate(names):
        report(f"lens of {name}")
        fits.append(fitted_lens(sharp(every.get(c, [])), solid, sizes[c], name, options.kinds))
    used = [s for own in every.values() for s in chosen(sharp(own), sizes, options.moments[1])]
    points, seen = measured(scene.points, _SIGMA), scene.sightings(names)
    guess = _guess(fits, used, solid, seen, points, names)
    seen = [replace(s, rough=max(_CLICKED / guess.noise[s.camera], 1.0)) for s in seen]
    used = [s for s in used if s.moment in guess.boards]
    report("adjusting")
    setup = Setup(guess, (*used, *seen), {"board": solid, "scene": points}, gauge=None)
    adjustment = adjust(setup, report)
    timing = in_step((), len(names))
    return Calibration(Rig(adjustment.cameras(names)), adjustment, board, timing, True, scene.names)


def _guess(
    fits: Sequence[LensFit], used: Sequence[Sighting], solid: Solid, seen: Sequence[Sighting], points: Solid,
    names: Sequence[str],
) -> Guess:  # fmt: skip
    lenses, numbers = tuple(f.lens for f in fits), tuple(f.numbers for f in fits)
    places = list[Float]()
    for s, name in zip(seen, names, strict=True):
        ways = placed(lenses[s.camera], numbers[s.camera], s, points)
        check(f"camera {name}", ways, "no place explains its measured points; check their numbers and pixels")
        own = {s.camera: np.eye(4)}
        places.append(min(ways, key=lambda T, s=s, own=own: misfit(T, [s], own, lenses, numbers, points)))
    boards = {
        s.moment: se3.inverse(places[s.camera]) @ ways[0]
        for s in used
        if (ways := placed(lenses[s.camera], numbers[s.camera], s, solid))
    }
    noise = tuple(float(f.adjustment.sigmas[0]) for f in fits)
    return Guess(lenses, numbers, tuple(places), boards, noise, (0.0,) * len(names))
