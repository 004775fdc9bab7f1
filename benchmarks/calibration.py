"""How well `twistcap calibrate` does: on rendered boards with known cameras, and on real recordings.

    python -m benchmarks.calibration rendered --cameras 4 --seeds 0-2
    python -m benchmarks.calibration projected --seeds 0-19
    python -m benchmarks.calibration charuco
    python -m benchmarks.calibration balance

A rendered board goes the whole way: images with motion blur, defocus and noise, detection, choice, adjustment. Two in a
hundred points are then moved by some 30 px.
"""

from __future__ import annotations

import argparse
import csv
import os
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline

from reproduce.measures.cameras import aligned, errors
from twistcap import se3
from twistcap.arrays import AnyArray, Float
from twistcap.calibrate.adjust import Setup, adjust
from twistcap.calibrate.advice import camera_rows
from twistcap.calibrate.board import Board, board_of
from twistcap.calibrate.calibrate import Calibration, Options, alone_seen, of_sightings
from twistcap.calibrate.detect import Detector
from twistcap.calibrate.scene import Scene, calibrated_by_scene, read_scene
from twistcap.calibrate.sightings import Sighting, moving
from twistcap.calibrate.world import lying
from twistcap.camera import Camera, Rig, look_at
from twistcap.io.cameras import read_cameras
from twistcap.io.video import open_source

SIZE = (1280, 720)
BOARD = board_of("charuco:9x6:100:75:4X4_50")
WRONG, NOISE_PX = 0.02, 0.2
DATA = Path(os.environ.get("TWISTCAP_DATA", "../shared/data"))


@dataclass(frozen=True)
class Filmed:
    """A rig and what it saw; the board lies on the floor at moment 0."""

    rig: Rig
    board: Board
    floor: Float
    sightings: list[Sighting]


def rig_about(count: int, rng: np.random.Generator) -> Rig:
    """Cameras in a ring of 3 m, 2 m high, that look at its middle."""
    cameras = list[Camera]()
    for c in range(count):
        angle = 2 * np.pi * c / count + 0.1 * rng.normal()
        eye = np.array([3 * np.cos(angle), 3 * np.sin(angle), 2.0 + 0.2 * rng.normal()])
        focal = 850.0 * np.exp(0.1 * rng.normal())
        K = np.array([[focal, 0, 640 + 8 * rng.normal()], [0, focal, 360 + 8 * rng.normal()], [0, 0, 1]])
        dist = np.array([0.1, 0.05, 1e-3, 1e-3, 0.01]) * rng.normal(size=5)
        cameras.append(Camera(f"cam{c}", K, look_at(eye, [0, 0, 0.9]), SIZE, dist))
    return Rig(tuple(cameras))


def board_places(moments: int, rng: np.random.Generator, board: Board) -> Iterator[Float]:
    """(4, 4) board to world: first on the floor, then carried about, turned to one camera or half up to all."""
    yield se3.transform(np.diag([1.0, -1.0, -1.0]), [-0.5 * board.size[0], 0.5 * board.size[1], 0.0])
    upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
    for m in range(1, moments):
        back = se3.exp_rotation([-rng.uniform(0.7, 1.4) if m % 2 else 0.4 * rng.normal(), 0, 0])
        turn = se3.exp_rotation([0, 0, rng.uniform(0, 2 * np.pi)]) @ upright @ back
        turn = turn @ se3.exp_rotation(0.25 * rng.normal(size=3))
        middle = turn @ np.array([0.5 * board.size[0], 0.5 * board.size[1], 0.0])
        yield se3.transform(turn, rng.uniform([-0.9, -0.9, 0.3], [0.9, 0.9, 1.6]) - middle)


def on_face(camera: Camera, T: Float, board: Board) -> bool:
    """Whether a camera sees the face of a board at T, and not too obliquely."""
    view = se3.apply(T, board.points).mean(axis=0) - camera.centre
    return bool(view @ T[:3, 2] > 0.3 * np.linalg.norm(view))


def projected(seed: int, cameras: int, moments: int) -> Filmed:
    """Points of the board projected, with noise."""
    rng = np.random.default_rng(seed)
    rig, places, out = rig_about(cameras, rng), list(board_places(moments, rng, BOARD)), list[Sighting]()
    for m, T in enumerate(places):
        for c, camera in enumerate(rig):
            pixels, depth = camera.project(se3.apply(T, BOARD.points))
            inside = (depth > 0.2) & np.all((pixels > 0) & (pixels < np.array(SIZE)), axis=1)
            if on_face(camera, T, BOARD) and inside.sum() >= 8:
                seen = pixels[inside] + NOISE_PX * rng.normal(size=(int(inside.sum()), 2))
                out.append(Sighting(c, m, np.flatnonzero(inside).astype(np.int32), spoiled(seen, rng), 2.0))
    return Filmed(rig, BOARD, places[0], out)


def rendered(seed: int, cameras: int, moments: int) -> Filmed:
    """Images of the board, which moves while the shutter is open, a little defocused, noisy; then detected."""
    rng = np.random.default_rng(seed)
    rig, places, out = rig_about(cameras, rng), list(board_places(moments, rng, BOARD)), list[Sighting]()
    find, picture, views = Detector(BOARD), BOARD.image(40), [rays_of(camera) for camera in rig]
    for m, T in enumerate(places):
        motion = np.concatenate([0.003 * rng.normal(size=3), 0.002 * rng.normal(size=3)]) if m else np.zeros(6)
        for c, camera in enumerate(rig):
            if not on_face(camera, T, BOARD):
                continue
            moved = [se3.exp(share * motion) @ T for share in (-0.5, -0.25, 0.0, 0.25, 0.5)]
            image = np.mean([drawn(camera, views[c], place, BOARD, picture) for place in moved], axis=0)
            image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.5, 0.9)) + 2.0 * rng.normal(size=image.shape)
            found = find(np.clip(np.round(image), 0, 255).astype(np.uint8))
            if found is not None:
                out.append(Sighting(c, m, found.ids, spoiled(found.pixels, rng), found.blur))
    return Filmed(rig, BOARD, places[0], out)


def rays_of(camera: Camera, fine: int = 3) -> Float:
    """(fine H, fine W, 2) image-plane coordinates of the parts of each pixel: a spline through every 16th px.

    A lens that folds the corners of its image shows nothing there; each pixel is then computed by itself.
    """
    x, y = ((np.arange(fine * n) + 0.5) / fine - 0.5 for n in SIZE)
    across, down = (np.linspace(-0.5, n - 0.5, n // 16 + 1) for n in SIZE)
    knots = camera.normalised(np.stack(np.meshgrid(across, down), axis=-1))
    if not np.isfinite(knots).all():
        return camera.normalised(np.stack(np.meshgrid(x, y), axis=-1))
    return np.stack([RectBivariateSpline(down, across, knots[..., k])(y, x) for k in range(2)], axis=-1)


def drawn(camera: Camera, rays: Float, T: Float, board: Board, picture: AnyArray, fine: int = 3) -> Float:
    """(H, W) the board before grey, white paper about it."""
    pixels = len(picture) / board.size[1] * board.square
    rim = round(0.5 * pixels)
    paper = cv2.copyMakeBorder(picture, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=255)
    image = np.full(SIZE[::-1], 90.0)
    rows, columns = where_paper(camera, T, board)
    rays = rays[fine * rows.start : fine * rows.stop, fine * columns.start : fine * columns.stop]
    if not rays.size:
        return image
    finer = int(np.ceil(pixels / (fine * shortest_square(camera, T, board))))
    rays = cv2.resize(rays, (0, 0), fx=finer, fy=finer, interpolation=cv2.INTER_LINEAR)
    M = camera.T_cam_world @ T
    to_plane = np.linalg.inv(M[:3, [0, 1, 3]])
    at = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ to_plane.T
    at = (at[..., :2] / at[..., 2:] / board.square * pixels - 0.5 + rim).astype(np.float32)
    at = np.where(np.isfinite(at), at, -1e4).astype(np.float32)
    parts = cv2.remap(paper, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=90).astype(np.float32)
    size = (columns.stop - columns.start, rows.stop - rows.start)
    image[rows, columns] = cv2.resize(parts, size, interpolation=cv2.INTER_AREA)
    return image


def shortest_square(camera: Camera, T: Float, board: Board) -> float:
    """The shortest side of a square in the image, px, at least 1: the picture must not be drawn coarser than it is."""
    grid = camera.project(se3.apply(T, board.points))[0].reshape(board.rows - 1, board.columns - 1, 2)
    sides = [np.linalg.norm(np.diff(grid, axis=k), axis=-1).min() for k in range(2)]
    return max(1.0, float(min(sides)))


def where_paper(camera: Camera, T: Float, board: Board) -> tuple[slice, slice]:
    """Rows and columns of the image in which the paper about a board at T may be."""
    rim, (w, h) = 0.6 * board.square, board.size
    x, y = np.meshgrid(np.linspace(-rim, w + rim, 20), np.linspace(-rim, h + rim, 20))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    pixels, depth = camera.project(se3.apply(T, points))
    if depth.min() < 0.1:
        return slice(0, SIZE[1]), slice(0, SIZE[0])
    (left, top), (right, bottom) = np.floor(pixels.min(axis=0)) - 2, np.ceil(pixels.max(axis=0)) + 3
    column, row = np.clip([left, right], 0, SIZE[0]).astype(int), np.clip([top, bottom], 0, SIZE[1]).astype(int)
    return slice(int(row[0]), int(row[1])), slice(int(column[0]), int(column[1]))


def spoiled(pixels: Float, rng: np.random.Generator) -> Float:
    """Pixels (N, 2) of which some are wrong."""
    wrong = rng.uniform(size=len(pixels)) < WRONG
    return pixels + 30.0 * wrong[:, None] * rng.normal(size=pixels.shape)


def calibration_of(made: Filmed) -> tuple[Calibration, Rig]:
    """The calibration, and the truth in its world."""
    sizes = dict.fromkeys(range(len(made.rig)), SIZE)
    found = of_sightings(made.sightings, made.board, made.rig.names, sizes, Options(floor=0))
    back = se3.inverse(lying(made.board) @ se3.inverse(made.floor))
    return found, Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ back) for c in made.rig))


def standardised(found: Calibration, true: Rig) -> Float:
    """Errors of all numbers of all cameras over their claimed standard deviations."""
    out, a = list[Float](), found.adjustment
    for c, camera in enumerate(true):
        step = se3.log(camera.T_cam_world @ se3.inverse(a.guess.places[c]))
        numbers = a.guess.lenses[c].numbers(camera.K, camera.dist)
        out += [step / np.sqrt(np.diagonal(a.places[c])), (numbers - a.guess.numbers[c]) / lens_sigmas(found, c)]
    return np.concatenate(out)


def lens_sigmas(found: Calibration, camera: int) -> Float:
    """Claimed standard deviations of the numbers of a lens."""
    return np.sqrt(np.diagonal(found.adjustment.lenses[camera]))


def simulated(kind: str, seeds: Sequence[int], cameras: int, moments: int) -> None:
    """Errors over all seeds, in the world of the board on the floor and after the best rigid motion; the covariance."""
    raw, moved, scores = list[Float](), list[Float](), list[Float]()
    for seed in seeds:
        made = (rendered if kind == "rendered" else projected)(seed, cameras, moments)
        found, true = calibration_of(made)
        raw.append(errors(found.rig, true))
        moved.append(errors(aligned(found.rig, true), true))
        scores.append(standardised(found, true))
        print(
            f"seed {seed}: {len(made.sightings)} sightings, noise {found.adjustment.sigmas.mean():.3f} px, worst",
            end=" ",
        )
        print(f"{raw[-1].max(axis=0).round(3)}, aligned {moved[-1].max(axis=0).round(3)}", flush=True)
    every = np.abs(np.concatenate(scores))
    for name, values in (("floor's world", raw), ("aligned", moved)):
        all_of = np.concatenate(values)
        print(
            f"{kind}, {cameras} cameras, {name}: focal %, rotation deg, centre mm: median",
            np.median(all_of, axis=0).round(4),
            end="",
        )
        print(", worst", all_of.max(axis=0).round(4))
    print(f"within 2 sigma {100 * np.mean(every < 2):.1f} %, rms of error over sigma {np.sqrt(np.mean(every**2)):.2f}")


def charuco() -> None:
    """The corners that caliscope found in charuco_4cam: by us, with and without clocks, and by the supplied cameras.

    caliscope 0.11.8 itself, on these 2175 corners with the supplied lenses: 1.588 px rms after `optimize`, 1.347 px
    after leaving the worst 2.5 % out; its `calibrate_extrinsics`: 1.318 px.
    """
    folder = DATA / "charuco_4cam/tests/sessions/post_optimization"
    board, seen = board_of("charuco:4x5:54:40.5:4X4_1000"), corners_of(folder)
    supplied = read_camera_array(folder / "camera_array.toml")
    sizes, count = dict.fromkeys(range(4), SIZE), sum(len(s.ids) for s in seen)
    print(f"{count} corners in {len(seen)} sightings; all rms are of distances, px")
    for name, options in {
        "without clocks": Options(("brown",), clocks=False),
        "with clocks": Options(("brown",)),
    }.items():
        found = of_sightings(moving(seen) if options.clocks else seen, board, supplied.names, sizes, options)
        a = found.adjustment
        every = np.concatenate([np.linalg.norm(r, axis=1) for r in a.residuals])
        right = np.concatenate([np.linalg.norm(r[k], axis=1) for r, k in zip(a.residuals, a.kept, strict=True)])
        print(f"{name}: rms {rms(every):.3f} over {len(every)}, {rms(right):.3f} over the {len(right)} taken for right")
        print("  frames later than the first:", found.late[0].round(3), "+-", found.late[1].round(3))
        compare(found, supplied)


GRIDS = {"cam01": ((1.0075, -0.10), (1.0076, -7.29)), "cam02": ((1.0076, -0.10), (1.0075, -7.25))}
"""From the pixels of the balancing videos to those of the plates and lens pictures: the README of balance_4view."""


def balance() -> None:
    """balance_4view from scratch: lenses by 25 chessboard pictures, places by the 18 points of the treadmill."""
    folder = DATA / "balance_4view"
    scene, names = read_scene(folder / "calibration/landmarks.json"), ("cam01", "cam02", "cam03", "cam04")
    on_plates = {c: {k: _on_plate(c, pixel) for k, pixel in own.items()} for c, own in scene.pixels.items()}
    scene, board = replace(scene, pixels=on_plates), board_of("chessboard:5x8:60")
    pictures = {name: open_source(folder / f"calibration/intrinsics/int_{name}_img") for name in names}
    options, sizes = Options(("brown",)), dict.fromkeys(range(4), (1088, 1920))
    seen = alone_seen(pictures, names, board, options, lambda note: None)
    found = calibrated_by_scene(scene, seen, board, names, sizes, options)
    supplied, _ = read_cameras(folder / "calibration/Calib.qca.txt")
    a, left = found.adjustment, left_out(found, scene, names)
    for c, name in enumerate(names):
        off = next(r for s, r in zip(a.sightings, a.residuals, strict=True) if s.camera == c and s.solid == "scene")
        focal = 100 * (found.rig[c].K[0, 0] / supplied[c].K[0, 0] - 1)
        median, alone = np.median(np.linalg.norm(off, axis=1)), np.median(left[c])
        summary = f"median {median:.2f} px, each left out in turn {alone:.2f} px"
        sigma = 100 * lens_sigmas(found, c)[0]
        print(f"{name}: scene points {summary}; focal {focal:.2f} % from the supplied, claimed +- {sigma:.2f}")


def left_out(found: Calibration, scene: Scene, names: Sequence[str]) -> list[list[float]]:
    """By camera, px: how far each point is from where it was seen, if left out and placed by the others."""
    a, out = found.adjustment, [list[float]() for _ in names]
    for k in range(len(scene.points)):
        fewer = [_without(s, k) if s.solid == "scene" else s for s in a.sightings]
        rig = adjust(Setup(a.guess, tuple(fewer), a.solids, gauge=None)).cameras(names)
        seeing = [c for c, name in enumerate(names) if k in scene.pixels[name]]
        for c in seeing:
            rays = {d: rig[d].rays(scene.pixels[names[d]][k]) for d in seeing if d != c}
            if len(rays) > 1:
                rows = np.concatenate([-se3.hat(n) for n, _ in rays.values()])
                point = np.linalg.lstsq(rows, np.concatenate([m for _, m in rays.values()]), rcond=None)[0]
                out[c].append(float(np.linalg.norm(rig[c].project(point)[0] - scene.pixels[names[c]][k])))
    return out


def _without(s: Sighting, point: int) -> Sighting:
    return replace(s, ids=s.ids[s.ids != point], pixels=s.pixels[s.ids != point])


def _on_plate(camera: str, pixel: Float) -> Float:
    grid = np.array(GRIDS.get(camera, ((1.0, 0.0), (1.0, 0.0))))
    return grid[:, 0] * pixel + grid[:, 1]


def compare(found: Calibration, supplied: Rig) -> None:
    """Places against the supplied ones, after the best rigid motion, with what is claimed."""
    rows, claimed = errors(aligned(found.rig, supplied), supplied), camera_rows(found)
    for camera, row, claim in zip(found.rig, rows, claimed, strict=True):
        sigma = 1e3 * float(np.max(claim["centre_sigma_m"]))
        summary = f"{row[2]:.1f} mm and {row[1]:.2f} deg from the supplied, focal {row[0]:.2f} %"
        print(f"  {camera.name}: {summary}; claimed +- {sigma:.1f} mm, {claim['turn_sigma_deg']:.2f} deg")


def corners_of(folder: Path) -> list[Sighting]:
    """The sightings of caliscope's table of corners."""
    with (folder / "calibration/extrinsic/CHARUCO/xy_CHARUCO.csv").open() as file:
        rows = list(csv.DictReader(file))
    found: dict[tuple[int, int], list[list[float]]] = {}
    for row in rows:
        point = [float(row[key]) for key in ("keypoint_id", "img_loc_x", "img_loc_y")]
        found.setdefault((int(row["cam_id"]), int(row["sync_index"])), []).append(point)
    tables = {key: np.array(points) for key, points in found.items()}
    return [Sighting(c, m, t[:, 0].astype(np.int32), t[:, 1:], 2.0) for (c, m), t in tables.items()]


def read_camera_array(path: Path) -> Rig:
    """The supplied cameras."""
    tables = tomllib.loads(path.read_text())["cameras"]
    return Rig(
        tuple(
            Camera(
                f"cam{key}", np.array(t["matrix"]), se3.transform(t["rotation"], t["translation"]), tuple(t["size"]),
                np.array(t["distortions"]),
            )
            for key, t in tables.items()
        )
    )  # fmt: skip


def rms(sizes: Float) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(sizes**2)))


def main() -> None:
    """Print the measures of one case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=["rendered", "projected", "charuco", "balance"])
    parser.add_argument("--seeds", default="0-2")
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--moments", type=int, default=100)
    given = parser.parse_args()
    if given.case in ("charuco", "balance"):
        (charuco if given.case == "charuco" else balance)()
        return
    first, _, last = given.seeds.partition("-")
    simulated(given.case, range(int(first), int(last or first) + 1), given.cameras, given.moments)


if __name__ == "__main__":
    main()
