"""Every reader of files, with a small file that it can read."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from support.cameras import ring
from support.networks import one_stage_model
from support.results import estimate, two_links
from support.videos import with_sound
from twistcap.body import Pose
from twistcap.body.gltf import load_glb, save_glb
from twistcap.body.humanoid import humanoid
from twistcap.body.obj_rig import load_makehuman
from twistcap.body.rig_spec import read_rig as read_rig_spec
from twistcap.calibrate.board import Board, read_board
from twistcap.calibrate.scene import read_scene
from twistcap.camera import Rig
from twistcap.errors import naming
from twistcap.evaluate.load import load_reference
from twistcap.io.asf import read_amc
from twistcap.io.bvh import read_bvh, write_bvh
from twistcap.io.calibration import read_rig, write_rig
from twistcap.io.cameras import Asked, read_cameras, write_cameras
from twistcap.io.deepmimic import read_deepmimic
from twistcap.io.keypoints import LAYOUTS, read_clicks, read_openpose
from twistcap.io.keyviews import read_key_views, read_uncut
from twistcap.io.markers import write_trc
from twistcap.io.masks import read_masks
from twistcap.io.motion_files import poses_of_file, write_mot
from twistcap.io.motion_library import read_library, write_library
from twistcap.io.norms import read_norms
from twistcap.io.onnx_detector import load_network
from twistcap.io.pose_file import body_at, read_pose, write_pose
from twistcap.io.prior_file import read_prior, write_prior
from twistcap.io.projects import found_project
from twistcap.io.result import ResultWriter, read_result, read_state
from twistcap.io.session import load_session
from twistcap.io.soundtrack import read_sound
from twistcap.io.study import load_study
from twistcap.io.video import open_source
from twistcap.io.videowriter import VideoWriter
from twistcap.motion import MotionLibrary
from twistcap.motion.table import read_table
from twistcap.priors import ParzenPrior

SMALL = two_links()
RIG = ring()
_MESH = ("m.obj", "r.json", "w.json")
ASF = """:units
  length 0.45
:root
  order TX TY TZ RX RY RZ
:bonedata
  begin
    name upper
    direction 0 1 0
    length 3
    axis 0 0 20 XYZ
    dof rx ry rz
  end
:hierarchy
  begin
    root upper
  end
"""
OBJ = (
    "o body\n"
    + "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 8) for z in (0, 1))
    + """g body
f 1 2 4 3
f 5 7 8 6
f 1 5 6 2
f 3 4 8 7
"""
)
RIG_JSON = {
    "joints": {"a": [0, 1], "b": [2, 3], "c": [6, 7]},
    "bones": {"low": {"parent": None, "head": "a", "tail": "b"}, "high": {"parent": "low", "head": "b", "tail": "c"}},
}
SESSION = """data = "."
frames = [0, 5]
scale = 0.5
[cameras]
calibration = "Calib.toml"
[videos]
cam0 = "a.mp4"
[body]
kind = "humanoid"
lengths = { torso = 1.1 }
[first_pose]
file = "pose.json"
[tracker]
method = "levelset"
surface_sigma = 0.006
[tracker.differential]
stray_deg = 4.0
"""


CAMERA_FILES = {
    "caliscope": "array.toml",
    "opencv yml": "opencv/cam0.yml",
    "opencv xml": "cam0.xml",
    "easymocap intri": "easymocap/intri.yml",
    "easymocap extri": "easymocap/extri.yml",
    "qualisys": "a.qca.txt",
    "vicon": "a.xcp",
    "opencap": "opencap/cam0/cameraIntrinsicsExtrinsics.pickle",
    "colmap cameras": "colmap/cameras.txt",
    "colmap images": "colmap/images.txt",
    "projections": "P.txt",
}
"""A file of each format of calibrations; of a pair, both."""


@dataclass(frozen=True)
class Target:
    """A reader, and the file that it is given damaged."""

    seed: Path
    read: Callable[[Path], Any]


def targets(folder: Path) -> Mapping[str, Target]:
    """All readers by name; their whole files are written into a folder."""
    _write(folder)
    man = humanoid()
    by_name: dict[str, tuple[str, Callable[[Path], Any]]] = {
        "calibration": ("Calib.toml", read_rig),
        **{f"calibration {name}": (file, _cameras(name, folder)) for name, file in CAMERA_FILES.items()},
        "calibration board": ("board.toml", read_board),
        "session": ("session.toml", load_session),
        "study": ("study.toml", load_study),
        "study table": ("trials.csv", lambda p: _study(p, folder)),
        "key views": ("keyviews.toml", lambda p: (_key_views(p, folder), read_key_views(p))),
        "pictures to cut": ("keyviews.toml", lambda p: (_key_views(p, folder), read_uncut(p))),
        "measured points": ("scene.json", lambda p: read_scene(p).sightings(RIG.names[:1])),
        "gait norms": ("norms.json", read_norms),
        "project": ("sessionMetadata.yaml", lambda p: _project(p, folder)),
        "sound": ("heard.mp4", lambda p: read_sound(p, 2.0)),
        "rig": ("hinge.rig.toml", read_rig_spec),
        "skeleton table": ("table.toml", read_table),
        "pose": ("pose.json", lambda p: read_pose(p, body_at(p, man))),
        "pose npz": ("pose.npz", lambda p: read_pose(p, SMALL, 1)),
        "pose of a result": ("result.h5", lambda p: read_pose(p, SMALL)),
        "clicks": ("clicks.csv", lambda p: read_clicks(p, RIG.names)),
        "clicks json": ("clicks.json", lambda p: read_clicks(p, RIG.names)),
        "openpose": ("people.json", lambda p: read_openpose({RIG.names[0]: p}, RIG.names, "body_25")),
        "prior": ("prior.npz", read_prior),
        "library": ("library.npz", read_library),
        "truth": ("truth.npz", lambda p: load_reference(p, SMALL, _times)),
        "keypoints 3d": ("points.npz", lambda p: load_reference(p, SMALL, _times)),
        "trc": ("joints.trc", lambda p: load_reference(p, SMALL, _times)),
        "c3d": ("points.c3d", lambda p: load_reference(p, SMALL, _times)),
        "mot": ("walk.mot", poses_of_file),
        "mot reference": ("walk.mot", lambda p: load_reference(p, man, _times)),
        "bvh": ("walk.bvh", read_bvh),
        "amc": ("a.amc", lambda p: read_amc(p, folder / "a.asf")),
        "asf": ("a.asf", lambda p: read_amc(folder / "a.amc", p)),
        "deepmimic": ("clip.json", lambda p: read_deepmimic(p, folder / "skeleton.json")),
        "deepmimic skeleton": ("skeleton.json", lambda p: read_deepmimic(folder / "clip.json", p)),
        "glb": ("body.glb", load_glb),
        "obj": ("m.obj", lambda p: load_makehuman(p, folder / "r.json", folder / "w.json")),
        "obj rig": ("r.json", lambda p: load_makehuman(folder / "m.obj", p, folder / "w.json")),
        "obj weights": ("w.json", lambda p: load_makehuman(folder / "m.obj", folder / "r.json", p)),
        "obj target": ("t.target", lambda p: load_makehuman(*(folder / f for f in _MESH), {p: 0.5})),
        **{f"image {e}": (f"0001.{e}", _image) for e in ("png", "jpg", "bmp", "tif", "ppm")},
        "mask": ("mask.png", _mask),
        "video": ("a.mp4", lambda p: (len(s := open_source(p)), s.size, list(s.read(range(min(len(s), 6)))))),
        "network": ("net.onnx", lambda p: load_network(str(p))),
        "result": ("result.h5", read_result),
        "state": ("result.h5", read_state),
    }  # fmt: skip
    made = {name: Target(folder / file, read) for name, (file, read) in by_name.items()}
    return {
        name: target for name, target in made.items() if target.seed.exists()
    }  # C3D only where ezc3d is, networks where onnx is


def _write_c3d(path: Path, points: Any) -> None:
    try:
        import ezc3d
    except ImportError:
        return
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"], point["LABELS"]["value"] = [60.0], ["m"], ["knee_r", "tip"]
    file["data"]["points"], file["data"]["rotations"] = points, np.tile(np.eye(4)[:, :, None, None], (1, 1, 1, 3))
    file.add_parameter("ROTATION", "LABELS", ["r_thigh_4X4"])
    file.write(str(path))


def _write_network(path: Path) -> None:
    try:
        import onnx  # noqa: F401  # pyright: ignore[reportUnusedImport]
        import onnxruntime  # noqa: F401  # pyright: ignore[reportUnusedImport]
    except ImportError:
        return
    one_stage_model(path, (32, 32), np.full((2, 17, 3), 0.8))


def _cameras(name: str, seeds: Path) -> Callable[[Path], Any]:
    """A reader of one of the other formats; of a pair of files, the other one is whole."""
    kind, seed = name.split()[0], seeds / CAMERA_FILES[name]
    asked = Asked(1.0 if kind in ("colmap", "opencv") else None, (384, 280))

    def read(path: Path) -> Any:
        if kind not in ("colmap", "easymocap"):
            return read_cameras(path, kind, asked, up="z")
        pair = path.parent / "pair"
        shutil.copytree(seed.parent, pair, dirs_exist_ok=True)
        shutil.copyfile(path, pair / seed.name)
        with naming(path):
            return read_cameras(pair, kind, asked, up="z")

    return read


def _study(path: Path, seeds: Path) -> Any:
    (path.parent / "study.toml").write_text((seeds / "study.toml").read_text())
    with naming(path):
        return load_study(path.parent / "study.toml")


def _key_views(path: Path, seeds: Path) -> None:
    """What the file names."""
    for name in ("Calib.toml", "plate.png", "mask.png"):
        if not (path.parent / name).exists():
            shutil.copyfile(seeds / name, path.parent / name)


def _project(path: Path, seeds: Path) -> Any:
    """A folder of OpenCap whose notes are damaged."""
    folder = path.parent / "project"
    if not folder.exists():
        shutil.copytree(seeds / "opencap", folder / "Videos")
        for camera in (folder / "Videos").iterdir():
            camera.rename(camera.with_name(camera.name.capitalize()))
        (folder / "Videos" / "Cam0" / "InputMedia" / "walk").mkdir(parents=True)
    shutil.copyfile(path, folder / path.name)
    with naming(path):
        return found_project(folder)


def _times(rows: int) -> Any:
    return np.arange(rows) / 60


def _image(path: Path) -> Any:
    source = open_source(str(path.parent / f"{path.stem[:-1]}?{path.suffix}"))
    return source.size, list(source.read(range(len(source))))


def _mask(path: Path) -> Any:
    folder = path.parent / RIG.names[0]
    folder.mkdir(exist_ok=True)
    shutil.copyfile(path, folder / "frame_0000.png")
    return read_masks(path.parent, Rig(RIG.cameras[:1]), 0)


def _write_cameras(folder: Path) -> None:
    straight = Rig(tuple(replace(c, dist=np.r_[c.dist[:2], 0, 0, 0]) for c in RIG))
    for name in ("opencv", "easymocap", "opencap", "colmap"):
        write_cameras(RIG, folder / name, name)
    write_cameras(RIG, folder / "array.toml", "caliscope")
    write_cameras(RIG, folder / "a.qca.txt", "qualisys")
    write_cameras(straight, folder / "a.xcp", "vicon")
    (folder / "P.txt").write_text("\n".join(" ".join(map(str, row)) for c in RIG for row in c.P))
    (folder / "board.toml").write_text(Board().toml)
    storage = cv2.FileStorage(str(folder / "cam0.xml"), cv2.FILE_STORAGE_WRITE)
    for key, value in (("camera_matrix", RIG[0].K), ("distortion_coefficients", RIG[0].dist[None])):
        storage.write(key, value)
    storage.write("R", RIG[0].T_cam_world[:3, :3])
    storage.write("T", RIG[0].T_cam_world[:3, 3:])
    storage.release()


def _write(folder: Path) -> None:
    rng = np.random.default_rng(0)
    man, poses = humanoid(), [Pose.rest(humanoid())] * 3
    write_rig(RIG, folder / "Calib.toml")
    _write_cameras(folder)
    for name, text in (
        ("session.toml", SESSION),
        ("study.toml", 'trials = "trials.csv"\n[body]\nfit = true\n[session]\nscale = 0.5\n'),
        ("trials.csv", "subject,trial,session,stature\nanna,walk,session.toml,1.7\nanna,run,session.toml,\n"),
        ("sessionMetadata.yaml", "mass_kg: 70.0\nheight_m: 1.81\n"),
        (
            "keyviews.toml",
            'calibration = "Calib.toml"\nbody_line = 1.0\n[views.front]\n'
            f'camera = "{RIG.names[0]}"\nimage = "plate.png"\nmask = "mask.png"\n',
        ),
        ("a.asf", ASF),
        ("m.obj", OBJ),
        ("t.target", "0 0.1 0 0\n3 0 0.2 0\n"),
        ("a.amc", "1\nroot 0 0 0 0 0 0\nupper 4 5 6\n2\nroot 0 1 0 0 0 0\nupper 40 50 60\n"),
        ("clicks.csv", f"camera,joint,x,y\n{RIG.names[0]},knee_r,3,4\n"),
        ("table.toml", (resources.files("twistcap.motion") / "tables" / "cmu.toml").read_text("utf-8")),
        ("hinge.rig.toml", 'root = "low"\n[joints.high]\nkind = "revolute"\naxes = [[0, 1, 0]]\n'),
    ):
        (folder / name).write_text(text)
    documents: dict[str, Any] = {
        "norms.json": {"Schwartz2008": {"Free": {"KneeAngles": {"X": [[k, -5.0, 5.0] for k in range(0, 101, 10)]}}}},
        "scene.json": {f"p{k}": {"world_m": [k, 0, 1], "pixels": {RIG.names[0]: [k, 2], "b": None}} for k in range(6)},
        "clicks.json": {RIG.names[0]: {"knee_r": [3, 4]}},
        "people.json": {"people": [{"pose_keypoints_2d": [1.0] * 3 * len(LAYOUTS["body_25"])}]},
        "clip.json": {"Frames": [[0.1, 1, 2, 3, 1, 0, 0, 0, 1, 0, 0, 0, 0.3]] * 3},
        "skeleton.json": {"Skeleton": {"Joints": [
            {"Name": n, "Type": t, "Parent": k - 1, "AttachX": 0, "AttachY": 0.4, "AttachZ": 0}
            for k, (n, t) in enumerate((("root", "none"), ("chest", "spherical"), ("elbow", "revolute")))]}},
        "r.json": RIG_JSON,
        "w.json": {"weights": {"low": [[k, 1.0] for k in range(4)], "high": [[k, 1.0] for k in range(4, 8)]}},
    }  # fmt: skip
    for name, document in documents.items():
        (folder / name).write_text(json.dumps(document))
    write_pose(folder / "pose.json", man, poses[0])
    write_mot(folder / "walk.mot", man, np.arange(3) / 60, poses)
    write_bvh(folder / "walk.bvh", man, poses, 60.0)
    _write_network(folder / "net.onnx")
    _write_c3d(folder / "points.c3d", rng.normal(size=(4, 2, 3)))
    write_trc(folder / "joints.trc", np.arange(3) / 60, ("knee_r", "tip"), rng.normal(size=(3, 2, 3)))
    write_prior(folder / "prior.npz", ParzenPrior(("a", "b"), rng.normal(size=(5, 2)), 0.1))
    roots = np.tile(np.eye(4), (6, 1, 1))
    library = MotionLibrary(("a",), 60.0, ("c",), np.array([0, 6], np.int32), np.zeros((6, 1), np.float32), roots)
    write_library(folder / "library.npz", library)
    q, names = rng.normal(size=(6, 2)), SMALL.coordinate_names
    np.savez(folder / "pose.npz", root=roots, q=q, coordinate_names=names)
    np.savez(
        folder / "truth.npz", q=q, coordinate_names=names, names=("knee_r",), landmarks=np.zeros((6, 1, 3)), fps=60
    )
    np.savez(folder / "points.npz", X=np.zeros((4, 25, 3)), times=np.arange(4) / 60)
    save_glb(SMALL, folder / "body.glb")
    picture = rng.integers(0, 255, (20, 24, 3)).astype(np.uint8)
    for ending in ("png", "jpg", "bmp", "tif", "ppm"):
        cv2.imwrite(str(folder / f"0001.{ending}"), picture)
    width, height = RIG[0].size
    for name in ("mask.png", "plate.png"):
        cv2.imwrite(str(folder / name), np.zeros((height, width), np.uint8))
    with VideoWriter(folder / "a.mp4", 30.0) as video:
        for k in range(6):
            video.write(np.full((32, 48, 3), 40 * k, np.uint8))
    shutil.copyfile(folder / "a.mp4", folder / "heard.mp4")
    with_sound(folder / "heard.mp4", 0.5 * np.sin(np.arange(24_000) / 9), 16_000)
    with ResultWriter(folder / "result.h5", SMALL, RIG, {"videos": {"cam0": "a.mp4"}}) as writer:
        writer.save_state(np.arange(50, dtype=np.uint8))
        for k in range(5):
            writer.append(estimate(k))
