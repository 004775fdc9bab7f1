"""A session written from videos and a calibration, and its gaps in plain sentences."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.io.calibration import Unit, knows_floor, read_rig
from twistcap.io.cameras.axes import Up, axis_up, check_z_up
from twistcap.io.cameras.units import toml_unit
from twistcap.io.files import pasted
from twistcap.io.model_file import is_address, is_model_file
from twistcap.io.sources import IMAGE_ENDINGS, matching
from twistcap.io.video import Source, check_size, is_there, open_source

VIDEO_ENDINGS = {".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".mts"}
ENDS = 3  # frames at both ends of a video that are decoded before all is said to be well
_FILE_LINES = (
    "\n[first_pose]",
    "# One camera does not show depth, so the pose must be given, here or as first_pose.json beside this file:",
    '# file = "other/result.h5"   # or a pose as JSON or NPZ',
)
_POSE_LINES = (
    "\n[first_pose]",
    "# Where nothing is given, it is found in the images, unless first_pose.json lies here:",
    '# "twistcap init" writes that file from a handful of clicked joints.',
    "# Or a pose network finds keypoints in the first frame (pip install 'twistcap[detect]'):",
    '# detector = "rtmo.onnx"',
    "# Or 2D keypoints near the first frame are read:",
    "# [first_pose.keypoints]",
    '# format = "halpe_26"   # or "body_25", "body_25b", "coco_17", "coco_133", "blazepose"',
    '# folders = { cam01 = "pose/cam01_json" }   # one per camera',
)


@dataclass(frozen=True)
class Draft:
    """A session to be written."""

    rig: Rig  # cameras in use, as calibrated
    paths: Mapping[str, str]  # video or images by camera, in the rig's order
    sources: Mapping[str, Source]  # the same, opened
    unit: Unit | None  # of the calibration; None where the file names it or it is metres
    calibration: Path  # its file
    unused: tuple[str, ...]  # calibrated cameras without a video
    up: Up | None = None  # axis of the calibration that is up; None where it is z
    floor_known: bool = True  # whether the world's z = 0 is the floor
    keypoints: Mapping[str, Path] = field(default_factory=dict[str, Path])  # folders of JSON files, by camera
    layout: str | None = None  # their format
    detector: str | None = None  # model file, or name, of what finds keypoints
    people: str | None = None  # model file that finds people for it
    notes: tuple[str, ...] = ()  # on what was found and decided
    converted: str | None = None  # text of the calibration's file, where that is to be written too

    @property
    def frames(self) -> tuple[int, int]:
        """(fewest, most) frames of a camera."""
        counts = [len(source) for source in self.sources.values()]
        return min(counts), max(counts)

    @property
    def rates(self) -> dict[str, float]:
        """Frames per second by camera, where known."""
        return {name: source.fps for name, source in self.sources.items() if source.fps}


def draft_session(videos: Sequence[str], calibration: Path, unit: Unit | None = None, up: Up | None = None) -> Draft:
    """Open everything and check that it belongs together.

    `videos` are files, folders, globs or printf patterns, each alone (its name then names the camera) or as
    ``CAMERA=PATH``; `unit` is that of the calibration's translations, and `up` its axis that is up. Raises InputError
    for a video that does not open or whose ends cannot be decoded, matches no camera or has another size than its
    calibration, for cameras that two videos claim, and where `up` is not said and is surely not z.
    """
    unit, told = toml_unit(calibration, unit, "--calibration")
    rig = read_rig(calibration, unit, floor=None, key="--calibration")
    if up is None:
        check_z_up(rig, f"calibration {calibration}", "say --up {} (or --up z{})")
    paths = matched([path for text in videos for path in recordings(text)], rig.names)
    floor = knows_floor(calibration)
    notes = [told] if told else []
    if not floor:
        notes.append("The calibration does not know the floor: floor = false is set.")
    if up is not None and (seen := axis_up(rig)) not in (up, None):
        notes.append(f"Up is {up}, as said with --up; by the images it is {seen}, so look at it.")
    return replace(drafted(rig, paths, calibration, unit), up=up, floor_known=floor, notes=tuple(notes))


def drafted(rig: Rig, paths: Mapping[str, str], calibration: Path, unit: Unit | None = None) -> Draft:
    """The draft of cameras and the path of each one's video, all opened. Raises InputError as `draft_session`."""
    used = Rig(tuple(camera for camera in rig if camera.name in paths))
    sources = {camera.name: open_source(paths[camera.name]) for camera in used}
    ordered = {name: paths[name] for name in used.names}
    unused = tuple(name for name in rig.names if name not in paths)
    draft = Draft(used, ordered, sources, unit, calibration, unused)
    for camera in used:
        check_size(sources[camera.name], camera)
        _check_ends(sources[camera.name])
    return draft


def _check_ends(source: Source) -> None:
    """Raises InputError where a few frames at either end cannot be decoded."""
    numbers = sorted({k for k in (*range(ENDS), *range(len(source) - ENDS, len(source))) if 0 <= k < len(source)})
    for _ in source.read(numbers):
        pass


def matched(videos: Sequence[tuple[str | None, str]], cameras: Sequence[str]) -> dict[str, str]:
    """Path by camera: as said, else the camera whose name the file's or folder's name is or holds. Raises InputError
    for a path that no camera or more than one fits, an unknown camera, or a camera taken twice.
    """
    paths: dict[str, str] = {}
    for said, path in videos:
        name = said if said is not None else _camera_of(path, cameras)
        if name not in cameras:
            raise InputError(f"camera {name!r} has no calibration; the calibration holds {', '.join(cameras)}.")
        if name in paths:
            raise InputError(f"camera {name!r} is given two videos, {paths[name]} and {path}; write CAMERA=PATH.")
        paths[name] = path
    if not paths:
        raise InputError("no video is given; name them with --videos.")
    return paths


def _camera_of(path: str, cameras: Sequence[str]) -> str:
    """By the name of the file, else of its folder, or of the folder above that."""
    stem = Path(path.split("%")[0].rstrip("/") if "%" in path else path)
    titles = [
        stem.stem if stem.suffix.lower() in VIDEO_ENDINGS else stem.name,
        *(up.name for up in list(stem.parents)[:2]),
    ]
    fitting = list[str]()
    for title in titles:
        fitting = _named(title.lower(), cameras)
        if len(fitting) == 1:
            return fitting[0]
        if fitting:
            break
    many = "no camera" if not fitting else "more than one camera"
    raise InputError(f"the name of {path} fits {many} of {', '.join(cameras)}; write it as CAMERA={path}.")


def _named(title: str, cameras: Sequence[str]) -> list[str]:
    exact = [name for name in cameras if name.lower() == title]
    held = [name for name in cameras if name.lower() in title]
    return exact or [name for name in held if len(name) == max(map(len, held))]


def recordings(text: str) -> list[tuple[str | None, str]]:
    """The recordings of one argument: each video of a folder of videos; a folder of images as one."""
    name, equals, path = text.partition("=")
    named = bool(equals) and not Path(text).exists()
    if not (path if named else text):
        raise InputError(f"--videos is {text!r}; give a path, or CAMERA=PATH.")
    if not any(c in text for c in "*?[") and not is_there(path if named else text):
        raise InputError(f"{path if named else text} does not exist; check --videos.")
    if named and Path(path).is_dir() and not _has_images(Path(path)):
        raise InputError(f"folder {path} holds no images; give camera {name!r} one video, or a folder of images.")
    if named or "%" in text:
        return [(name, path) if named else (None, text)]
    files = matching(text) if any(c in text for c in "*?[") else [text]
    if not files:
        raise InputError(f"no file matches {text}; check --videos.")
    return [(None, inside) for file in files for inside in _in_folder(Path(file))]


def _has_images(folder: Path) -> bool:
    return any(path.suffix.lower() in IMAGE_ENDINGS for path in folder.iterdir())


def _in_folder(path: Path) -> list[str]:
    if not path.is_dir():
        return [str(path)]
    if _has_images(path):
        return [str(path)]
    inside = sorted(path.iterdir())
    folders = [p for p in inside if p.is_dir()]
    pictures = [str(p) for p in folders if _has_images(p)]
    below = [str(q) for p in folders for q in sorted(p.iterdir()) if q.suffix.lower() in VIDEO_ENDINGS]
    videos = [str(p) for p in inside if p.suffix.lower() in VIDEO_ENDINGS] or pictures or below
    if not videos:
        raise InputError(f"folder {path} holds neither videos nor images; check --videos.")
    return videos


def session_lines(draft: Draft, folder: Path, stature: float | None) -> str:
    """The session file: known values are filled in, the rest is in comments."""
    fewest, most = draft.frames
    rate = next(iter(draft.rates.values()), None)
    lines = [
        "# A twistcap session; docs/formats/session.md lists every key. Paths are relative to this file.",
        f"{'' if fewest < most else '# '}frames = [0, {fewest - 1}]  # first and last frame, counted from 0",
        "# fps of the images; set it to what was recorded" if rate is None else f"# The videos have {rate:g} fps.",
        *(["fps = 60"] if rate is None else []),
        "# scale = 0.5   # smaller images track faster; a person 250 px high is plenty",
        "\n[cameras]",
        f"calibration = {_path(draft.calibration, folder)}",
        *([f'unit = "{draft.unit}"'] if draft.unit else []),
        *([f"use = {json.dumps(list(draft.rig.names))}"] if draft.unused else []),
        *([f'up = "{draft.up}"  # axis of the calibration that is up'] if draft.up else []),
        *([] if draft.floor_known else ["floor = false"]),
        "# floor = 0.0   # height of the floor, m; false where the world's z is not upward",
        "\n[videos]",
        *(
            f"{json.dumps(name, ensure_ascii=False)} = {_path(Path(path), folder)}"
            for name, path in draft.paths.items()
        ),
        "\n[body]",
        'kind = "humanoid"',
        f"stature = {stature:g}  # m" if stature else "# stature = 1.75   # m; measure the person",
        *_pose_lines(draft, folder),
        "\n# [tracker]",
        '# method = "direct"   # or "levelset"',
        "\n[output]",
        f'# folder = "out/{folder.resolve().name}"   # relative to where twistcap is started',
        'exports = ["trc", "csv"]   # also mot, bvh, glb, c3d, opensim, usd',
    ]
    return "\n".join(lines) + "\n"


def _pose_lines(draft: Draft, folder: Path) -> Sequence[str]:
    if draft.detector is not None:
        named = {"model": draft.detector} | ({"people": draft.people} if draft.people else {})
        return ["\n[first_pose.detector]", *(f"{key} = {_model(name, folder)}" for key, name in named.items())]
    if not draft.keypoints:
        return _POSE_LINES if len(draft.rig) > 1 else _FILE_LINES
    paths = {json.dumps(name, ensure_ascii=False): _path(path, folder) for name, path in draft.keypoints.items()}
    return [
        "\n[first_pose.keypoints]",
        f'format = "{draft.layout}"',
        "frames = [0]   # numbers of the JSON files, near the first frame",
        f"folders = {{ {', '.join(f'{name} = {path}' for name, path in paths.items())} }}",
    ]


def _model(name: str, folder: Path) -> str:
    """A model file's path from the session; addresses and names stay."""
    local = is_model_file(name) and not is_address(name)
    return _path(Path(name).expanduser(), folder) if local else json.dumps(name)


def _path(path: Path, folder: Path) -> str:
    return json.dumps(os.path.relpath(path.resolve(), folder.resolve()), ensure_ascii=False)


def findings(draft: Draft) -> list[str]:
    """Facts about the recording, in sentences."""
    fewest, most = draft.frames
    rates = draft.rates
    rate = f"{next(iter(rates.values())):g} frames per second" if rates else "images without a known frame rate"
    count = f"{len(draft.rig)} camera{'' if len(draft.rig) == 1 else 's'}"
    out = [f"{count} ({', '.join(draft.rig.names)}), {fewest} frames, {rate}; all sizes agree."]
    if fewest < most:
        out.append(f"The videos differ in length ({fewest} to {most} frames): frames = [0, {fewest - 1}] is set.")
    if _rates_differ(draft):
        listed = ", ".join(f"{name} {rate:g}" for name, rate in rates.items())
        out.append(f"Frame rates differ ({listed}): frames are paired by time. Find the clocks with twistcap sync.")
    out += [*draft.notes, *(f"{source.note}." for source in draft.sources.values() if source.note)]
    if draft.unused:
        out.append(f"Calibrated, but without a video: {', '.join(draft.unused)}; they are left out by [cameras] use.")
    return out


def _rates_differ(draft: Draft) -> bool:
    rates = draft.rates.values()
    return bool(rates) and max(rates) - min(rates) > 0.001 * max(rates)


def missing(draft: Draft, session: Path, stature: float | None) -> list[str]:
    """What a track still lacks, in sentences that say what to do."""
    out: list[str] = []
    pose, alone = session.parent / "first_pose.json", len(draft.rig) < 2
    if alone:
        ways = "so a first pose is found neither in its images nor by keypoints or clicks"
        out.append(f"A second view: one camera does not show depth, {ways}. Else give the pose: [first_pose] file.")
    if stature is None:
        out.append("The body: it is the built-in person of 1.75 m. Put the true height into [body] stature.")
    if not draft.rates:
        out.append("The frame rate: 60 is set. Put the true one into fps.")
    if not alone and not pose.is_file() and not draft.keypoints and draft.detector is None:
        by_clicks = f"click it with:  twistcap init {pasted(session)}"
        out.append(f"The first pose: track looks for it in the images. If it is not clear there, {by_clicks}")
        out.append("Keypoints: none are named. They can replace the search ([first_pose.keypoints] in the file).")
    return out


def next_steps(draft: Draft, session: Path, failed: bool = False) -> list[str]:
    """What comes next, in sentences with the command; `failed` where keypoints gave no first pose."""
    if len(draft.rig) < 2 and not (session.parent / "first_pose.json").is_file():
        return ["Next, film with a second camera, calibrate both, and begin anew."]
    clocks, init, track = (f"twistcap {command} {pasted(session)}" for command in ("sync", "init", "track"))
    steps = [f"find the clocks of the cameras:  {clocks}"] if _rates_differ(draft) else []
    if not steps and draft.frames[0] < draft.frames[1]:  # a trigger would have ended them together
        steps = [f"if the cameras were not started together, find their clocks:  {clocks}"]
    steps += [f"click the first pose:  {init}"] if failed else []
    steps.append(f"track:  {track}")
    return [f"{'Then' if k else 'Next'}, {step}" for k, step in enumerate(steps)]
