"""Project folders of other programs: where their calibration, videos and keypoints lie.

Layouts: Pose2Sim (``calibration/Calib.toml``, ``videos/``, ``pose/CAM_json``), OpenCap (``Videos/Cam0/InputMedia``),
EasyMocap (``intri.yml``, ``extri.yml``, ``videos/``, ``openpose/CAM`` or ``annots/CAM``), FreeMoCap
(``synchronized_videos/``, ``*_camera_calibration.toml``), after their documentation.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from twistcap.camera import Rig
from twistcap.doors.text import read_json_table, read_text
from twistcap.errors import InputError
from twistcap.io.calibration import Unit, knows_floor, rig_text
from twistcap.io.cameras import Asked, format_named
from twistcap.io.cameras.axes import Up, axis_up, up_instead_of_z, with_z_up
from twistcap.io.cameras.formats import OPENCAP_FLOOR
from twistcap.io.cameras.units import session_unit, toml_unit, unit_of
from twistcap.io.keypoint_format import fitting_format
from twistcap.io.keypoints import LAYOUTS
from twistcap.io.new_session import VIDEO_ENDINGS, Draft, drafted
from twistcap.io.sources import natural
from twistcap.io.video import open_source

_POSES = ("pose-associated", "pose-sync", "pose", "pose-2d", "raw-2d")  # of Pose2Sim, the furthest worked first


@dataclass(frozen=True)
class Project:
    """What was found in a project folder.

    `videos` are files, or pairs of camera and file where the folders say the camera. `keypoints` are folders of JSON
    files, by the name of their folder; `layouts` are the formats that they may have, `model` what the project calls it.
    """

    program: str
    calibration: Path
    format: str  # a name of `io.cameras.FORMATS`
    videos: Sequence[tuple[str | None, str]]
    keypoints: Mapping[str, Path] = field(default_factory=dict[str, Path])
    layouts: tuple[str, ...] = ()
    model: str = ""
    stature: float | None = None
    floor_known: bool = True
    notes: tuple[str, ...] = ()


def found_project(folder: Path, trial: str | None = None) -> Project:
    """What a folder of Pose2Sim, OpenCap, EasyMocap or FreeMoCap holds.

    Raises InputError where it is no such folder, has no calibration or videos, or has several trials and none is named.
    """
    if not folder.is_dir():
        raise InputError(f"project {folder} is no folder; name one, or give --calibration and --videos.")
    for look in (_opencap, _freemocap, _easymocap, _pose2sim):
        if (project := look(folder, trial)) is not None:
            if trial is not None and project.program in ("EasyMocap", "FreeMoCap"):
                _trial(folder, [], trial)
            return project
    known = "Pose2Sim, OpenCap, EasyMocap or FreeMoCap"
    raise InputError(f"{folder} is no project of {known}; give --calibration and --videos.")


def draft_project(project: Project, folder: Path, unit: str | None = None, up: Up | None = None) -> Draft:
    """The draft of a session in `folder`; a calibration that a session cannot read is converted: `Draft.converted` is
    to be written into Calib.toml there.

    `unit` and `up` are those of the calibration. Raises InputError as `draft_session`; where the axis that is up is not
    said and the images do not tell it, or videos and cameras cannot be paired.
    """
    if not project.videos:
        raise InputError(f"the {project.program} project at {project.calibration} has no videos where they should be.")
    rig, given, notes = _calibrated(project, unit)
    axis = _axis_up(project, rig, up)
    if axis != "z":
        notes.append(f"Up is {axis} in its calibration, {'as said' if up else 'by the images'}: it is turned to z.")
    file, converted, floor, remarks = _calibration_file(project, folder, rig, axis)
    titles = {name or Path(path).stem: path for name, path in project.videos}
    cameras = _paired(project, list(titles), rig.names)
    draft = drafted(rig, {cameras[title]: path for title, path in titles.items()}, file, given)
    notes += [*remarks, *_by_order("videos", list(titles), rig.names)]
    left = axis if converted is None else "z"  # for the session to turn
    draft = replace(draft, up=left if up or left != "z" else None, floor_known=floor, converted=converted)
    poses = _keypoints(project, draft.rig.names)
    layout, why = _layout_of(project, poses, with_z_up(draft.rig, axis))
    notes += _on_keypoints(project, layout, why, draft.rig)
    return replace(draft, keypoints=poses if layout else {}, layout=layout, notes=tuple(notes))


def _calibrated(project: Project, unit: str | None) -> tuple[Rig, Unit | None, list[str]]:
    """The cameras as calibrated, the unit that a session must be given, and notes on both."""
    unit = unit or ("mm" if project.program == "FreeMoCap" else None)
    asked = Asked(None if unit is None else unit_of(unit), open_source(project.videos[0][1]).size)
    given: Unit | None = None
    if project.format == "toml":
        given, _ = toml_unit(project.calibration, session_unit(unit), "its path")
    rig, note = format_named(project.format).read(project.calibration, asked)
    notes = [f"Project of {project.program}; its calibration is {project.calibration}.", *project.notes]
    return rig, given, [*notes, note] if note else notes


def _axis_up(project: Project, rig: Rig, said: Up | None) -> Up:
    """The axis of its calibration that is up: as said, else as its cameras tell; of TOML z, where they are not sure."""
    found = said or (up_instead_of_z(rig) or "z" if project.format == "toml" else axis_up(rig))
    if found is None:
        raise InputError(f"calibration {project.calibration}: the images do not say what is up; say it with --up.")
    return found


def _calibration_file(project: Project, folder: Path, rig: Rig, up: Up) -> tuple[Path, str | None, bool, list[str]]:
    """The file that a session reads, its text where it is to be written, whether z = 0 is the floor, and notes."""
    floor = project.floor_known
    if project.format != "toml":
        file = folder / "Calib.toml"
        return file, rig_text(with_z_up(rig, up), floor=floor), floor, [f"Its calibration was converted: {file}."]
    if floor and not knows_floor(project.calibration):
        return project.calibration, None, False, ["The calibration does not know the floor: floor = false is set."]
    return project.calibration, None, floor, []


def _on_keypoints(project: Project, layout: str | None, why: str, rig: Rig) -> list[str]:
    """Notes on keypoints of a format, or on why they are not read."""
    if layout:
        order = _by_order("keypoints", list(project.keypoints), rig.names)
        return [*order, *([why] if why else []), f"Its keypoints ({layout}) give the first pose."]
    if not project.keypoints:
        return []
    folders = ", ".join(project.keypoints)
    return [f"Its keypoints ({folders}) are not read: {why}. If you know, fill [first_pose.keypoints]."]


def _paired(project: Project, names: Sequence[str], cameras: Sequence[str]) -> dict[str, str]:
    found = paired(names, cameras)
    if found is None:
        fact = f"{len(names)} videos ({', '.join(names)}) do not fit its {len(cameras)} cameras ({', '.join(cameras)})"
        raise InputError(f"{project.program} project: the {fact}; give --calibration and --videos CAMERA=PATH.")
    return found


def _keypoints(project: Project, cameras: Sequence[str]) -> dict[str, Path]:
    """Folders by camera; none where they fit no cameras."""
    found = paired(list(project.keypoints), cameras) if project.keypoints else None
    return {camera: project.keypoints[name] for name, camera in (found or {}).items()}


def _layout_of(project: Project, poses: Mapping[str, Path], rig: Rig) -> tuple[str | None, str]:
    """The keypoints' format, and what is to be said of it; None, and why, where they cannot be read."""
    if not project.layouts or not poses:
        return None, "they fit no cameras" if project.layouts else "their points fit no format that is known"
    if len(project.layouts) == 1:
        return project.layouts[0], ""
    layout, reason = fitting_format(poses, rig, project.layouts)
    named = f"Config.toml names {project.model}, which has another number of points. " if project.model else ""
    return layout, named + reason


def _by_order(what: str, names: Sequence[str], cameras: Sequence[str]) -> list[str]:
    """A sentence on the pairs, where the names did not decide."""
    if _by_name(names, cameras) is not None:
        return []
    pairs = ", ".join(f"{name} = {camera}" for name, camera in (paired(names, cameras) or {}).items())
    return [f"The names of its {what} do not tell the cameras, so they are paired by their order: {pairs}. Check it."]


def _opencap(folder: Path, trial: str | None) -> Project | None:
    cameras = sorted(p for p in folder.glob("Videos/Cam*") if p.is_dir())
    pickled = [c for c in cameras if (c / "cameraIntrinsicsExtrinsics.pickle").is_file()]
    if not pickled:
        return None
    trials = sorted({p.name for c in pickled for p in (c / "InputMedia").glob("*") if p.is_dir()})
    name = _trial(folder, [t for t in trials if t.lower() not in ("calibration", "neutral")] or trials, trial)
    videos = list[tuple[str | None, str]]()
    for camera in pickled:
        files = _videos(camera / "InputMedia" / name)
        if files:
            synced = [f for f in files if f.stem.endswith("_sync")]
            videos.append((camera.name, str((synced or files)[0])))
    metadata = folder / "sessionMetadata.yaml"
    height = re.search(r"(?m)^height_m:\s*([0-2]\.\d{1,9})\s*$", read_text(metadata)) if metadata.is_file() else None
    floor = f"{OPENCAP_FLOOR}: floor = false is set."
    stature = float(height[1]) if height else None
    return Project("OpenCap", folder / "Videos", "opencap", videos, stature=stature, floor_known=False, notes=(floor,))


def _freemocap(folder: Path, trial: str | None) -> Project | None:
    videos = next((f for n in ("synchronized_videos", "SyncedVideos") if (f := folder / n).is_dir()), None)
    if videos is None:
        return None
    files = sorted([*folder.glob("*calibration*.toml"), *folder.parent.glob("*calibration*.toml")])
    if not files:
        raise InputError(f"{folder} has no *_camera_calibration.toml; copy it there from the calibration's recording.")
    notes = ["FreeMoCap's world begins at its first camera or board: floor = false is set."]
    if any(folder.glob("output_data/raw_data/mediapipe*2dData*.npy")):
        notes.append("Its 2D data (.npy) are not read; the first pose is found in the images, or by clicks.")
    paired = [(None, str(p)) for p in _videos(videos)]
    return Project("FreeMoCap", files[0], "toml", paired, floor_known=False, notes=tuple(notes))


def _easymocap(folder: Path, trial: str | None) -> Project | None:
    if not (folder / "intri.yml").is_file() or not (folder / "extri.yml").is_file():
        return None
    videos: list[tuple[str | None, str]] = [(p.stem, str(p)) for p in _videos(folder / "videos")]
    if not videos:
        videos = [(p.name, str(p)) for p in sorted((folder / "images").glob("*")) if p.is_dir()]
    for name in ("openpose", "annots"):
        poses = {p.name: p for p in sorted((folder / name).glob("*")) if any(p.glob("*.json"))}
        if poses:
            return Project("EasyMocap", folder, "easymocap", videos, poses, _layouts(poses, ""))
    return Project("EasyMocap", folder, "easymocap", videos)


def _pose2sim(folder: Path, trial: str | None) -> Project | None:
    above = [folder, folder.parent, folder.parent.parent]
    calibrations = [f for up in above for c in sorted(up.glob("[Cc]alib*")) for f in _calibrations(c)]
    trials = sorted(p.name for p in folder.glob("*") if (p / "videos").is_dir())
    if not calibrations or not (trials or (folder / "videos").is_dir()):
        return None
    alone = trial is None and (folder / "videos").is_dir()
    own = folder if alone else folder / _trial(folder, trials, trial)
    videos: list[tuple[str | None, str]] = [(None, str(p)) for p in _videos(own / "videos")]
    for name in _POSES:
        folders = {p.name.removesuffix("_json"): p for p in sorted((own / name).glob("*")) if any(p.glob("*.json"))}
        if folders:
            model = _model(own, *above)
            return Project("Pose2Sim", calibrations[0], "toml", videos, folders, _layouts(folders, model), model)
    return Project("Pose2Sim", calibrations[0], "toml", videos)


def _calibrations(path: Path) -> list[Path]:
    files = sorted(path.glob("*.toml")) if path.is_dir() else [path]
    return [f for f in files if f.suffix == ".toml" and "config" not in f.name.lower()]


def _model(*folders: Path) -> str:
    """The pose model that a Config.toml names, in small letters."""
    files = [folder / "Config.toml" for folder in folders if (folder / "Config.toml").is_file()]
    named = [m[1] for f in files if (m := re.search(r"(?m)^\s*pose_model\s*=\s*['\"](\w+)['\"]", read_text(f)))]
    return named[0].lower() if named else ""


def _layouts(folders: Mapping[str, Path], model: str) -> tuple[str, ...]:
    """The formats with the number of points in the first file; the one that Config.toml names, if it is one of them."""
    for path in sorted(next(iter(folders.values())).glob("*.json")):
        content = read_json_table(path)
        people = content.get("people", content.get("annots"))
        person = people[0] if isinstance(people, list) and people and isinstance(people[0], dict) else {}
        given = person.get("pose_keypoints_2d", person.get("keypoints"))
        if isinstance(given, list) and given:
            count = len(given) if isinstance(given[0], list) else len(given) // 3
            fitting = tuple(name for name, names in LAYOUTS.items() if len(names) == count)
            return (model,) if model in fitting else fitting
    return ()


def _videos(folder: Path) -> list[Path]:
    return sorted(p for p in folder.glob("*") if p.suffix.lower() in VIDEO_ENDINGS)


def _trial(folder: Path, trials: Sequence[str], named: str | None) -> str:
    if named is not None and named not in trials:
        mend = f"it has {', '.join(trials)}" if trials else "leave --trial away"
        raise InputError(f"{folder} has no trial {named!r}; {mend}.")
    if named is None and len(trials) != 1:
        raise InputError(f"{folder} has the trials {', '.join(trials) or '(none)'}; choose one with --trial.")
    return named or trials[0]


def paired(names: Sequence[str], cameras: Sequence[str]) -> dict[str, str] | None:
    """Camera by name of file or folder: the one that it holds, else the one at the same place in the order of names.

    None where neither gives each name a camera of its own.
    """
    found = _by_name(names, cameras)
    if found is not None or len(names) != len(cameras):
        return found
    in_order = (sorted(those, key=lambda name: natural(name.lower())) for those in (names, cameras))
    return dict(zip(*in_order, strict=True))


def _by_name(names: Sequence[str], cameras: Sequence[str]) -> dict[str, str] | None:
    held = {name: [c for c in cameras if c.lower() in name.lower()] for name in names}
    found = {name: max(fitting, key=len) for name, fitting in held.items() if fitting}
    return found if len(found) == len(names) and len(set(found.values())) == len(names) else None
