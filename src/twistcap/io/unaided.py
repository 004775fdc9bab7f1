"""The first pose of a session that gives none: it is found in the images, at a size at which that is quick."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from twistcap.adjust.first_pose.keypoints import check_views
from twistcap.adjust.first_pose.triangulate import nearest_points
from twistcap.adjust.unaided import Proof, ProofRule, Unaided, middle_of_sight, scenery_of
from twistcap.adjust.unaided.scenery import Still
from twistcap.arrays import AnyArray, Bool, Float
from twistcap.body import Body, Pose
from twistcap.build import build
from twistcap.camera import Camera, Rig
from twistcap.doors.images import read_image
from twistcap.errors import InputError, check
from twistcap.features import Channels
from twistcap.io.masks import rectified_masks
from twistcap.io.session import Session
from twistcap.io.video import Views, preparation
from twistcap.search.backdrop import small_features
from twistcap.search.placing import Stance

_PX_PER_M = 110.0  # of the images that are searched; a person is 190 px high
_PICTURES = 25  # by which the background is known
_STANCES = 20  # that are taken from a motion library
_LEAST_S = 0.9  # s in which a person who moves leaves most of the place where he was
_MEET_M = 0.4  # by which rays may miss the place where they meet: no one clicks the same point of a trunk twice
_COLOURS: Channels = "lab"
_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def found_unaided(session: Session, body: Body, views: Views, floor: float | None) -> Proof:
    """The first pose of the frames, from their images alone. Raises InputError for a camera alone, where the pose is
    not clear enough to be believed, a plate cannot be read, or the pixels of ``[first_pose] at`` are none of one
    person.
    """
    check_views(views.rig)
    middle = middle_of_sight(views.image_rig)
    views = replace(views, scale=views.scale * _smaller(views.image_rig, middle))
    settings = replace(session.tracker_settings, predictor="constant_velocity")
    if settings.method == "differential":
        settings = replace(settings, method="direct")
    model = build(body, views.image_rig, settings, session.pose_prior)
    pictures = list(zip(*(frame.images for frame in _spread(views)), strict=True))
    plates = _plates(session, views)
    scenery = scenery_of(views.image_rig, pictures, middle, model.channels, plates)
    ground = middle[2] - 1.0 if floor is None else floor
    return Unaided(
        ProofRule(), model, scenery, lambda places: _read(views, places), len(views), views.fps / session.step,
        float(ground), _known(session, body), asked_for(session.first_pose.at, views.rig),
        f"calibration {session.cameras.calibration}",
    ).found()  # fmt: skip


def asked_for(pixels: Mapping[str, tuple[float, float]], rig: Rig) -> Float | None:
    """(3,) m, where the rays through pixels (x, y) of cameras meet, None without any.

    Raises InputError for an unknown camera, one camera alone, a pixel outside its image, and rays that do not meet.
    """
    if not pixels:
        return None
    if strange := [name for name in pixels if name not in rig.names]:
        raise InputError(f"[first_pose] at names {strange[0]}; the cameras are {', '.join(rig.names)}.")
    cameras = [rig[rig.names.index(name)] for name in pixels]
    for camera, (x, y) in zip(cameras, pixels.values(), strict=True):
        if not (0 <= x < camera.size[0] and 0 <= y < camera.size[1]):
            raise InputError(f"[first_pose] at: ({x:g}, {y:g}) is outside the image of {camera.name}, {camera.size}.")
    if len(cameras) < 2:
        raise InputError(f"[first_pose] at has only {cameras[0].name}; give the person's pixel in a second camera too.")
    centres = np.stack([camera.centre for camera in cameras])
    ways = np.stack([camera.rays(pixel)[0] for camera, pixel in zip(cameras, pixels.values(), strict=True)])
    place = nearest_points(centres, ways[:, None], np.ones((len(cameras), 1)))[0]
    miss = float(np.linalg.norm(np.cross(place - centres, ways), axis=1).max())
    check("[first_pose] at", miss < _MEET_M, f"the pixels miss each other by {miss:.2f} m; give one person's")
    return place


@dataclass(frozen=True)
class Silhouette:
    """The pixels `mask` (h, w) of a small image by which `camera` sees something that is not always there."""

    camera: Camera
    mask: Bool


def silhouettes_of(session: Session, views: Views) -> tuple[Silhouette | None, ...]:
    """Of the first frame, for each camera: the session's own masks, else what stands out from the still picture of the
    recording; None for a camera without image or mask, and for all in a recording too short to tell what is still.

    Raises InputError for masks, plates or images that cannot be read.
    """
    if (folder := session.first_pose.masks) is not None:
        given = rectified_masks(folder, views.rig, views.indices[0], views.scale)
        rig = views.image_rig
        return tuple(None if m is None else Silhouette(c, m) for c, m in zip(rig, given, strict=True))
    if views.indices[-1] - views.indices[0] < _LEAST_S * views.fps and session.first_pose.plates is None:
        return (None,) * len(views.rig)
    middle = middle_of_sight(views.image_rig)
    views = replace(views, scale=views.scale * _smaller(views.image_rig, middle))
    spread = list(_spread(views))
    pictures = list(zip(*(frame.images for frame in spread), strict=True))
    scenery = scenery_of(views.image_rig, pictures, middle, _COLOURS, _plates(session, views))
    return tuple(
        None if still is None or image is None else Silhouette(still.camera, _outstanding(still, image))
        for image, still in zip(spread[0].images, scenery.stills, strict=True)
    )


def _outstanding(still: Still, image: AnyArray) -> Bool:
    features = small_features(image, still.camera.size, _COLOURS)
    return np.asarray(still.standing_out(features) > 0.0, np.bool_)


def start_in_words(proof: Proof, views: Views) -> str:
    """What was found, in a sentence."""
    x, y, z = proof.first.root[:3, 3]
    start = views.indices[proof.track.start]
    clear = f"contour agreement {proof.agreement:.2f}, {100 * np.mean(proof.margins):.0f} % clearer than any other"
    return f"first pose found by itself at ({x:.2f}, {y:.2f}, {z:.2f}) m in frame {start}: {clear}."


def _smaller(rig: Rig, place: AnyArray) -> float:
    """The factor at which a person in the middle is seen at the wanted resolution, or 1."""
    depths = [float(c.T_cam_world[2, :3] @ place + c.T_cam_world[2, 3]) for c in rig]
    return min(1.0, *(_PX_PER_M * max(d, 0.1) / float(c.K[0, 0]) for c, d in zip(rig, depths, strict=True)))


def _read(views: Views, places: range) -> Views:
    return replace(views, indices=views.indices[places.start : places.stop : places.step])


def _spread(views: Views) -> Views:
    return _read(views, range(0, len(views), max(1, len(views) // _PICTURES)))


def _known(session: Session, body: Body) -> Sequence[Stance]:
    """Stances of the session's motion library, spread over it."""
    library = session.motion_library
    if library is None:
        return ()
    out, columns = list[Stance](), {name: k for k, name in enumerate(library.names)}
    for k in np.unique(np.linspace(0, len(library) - 1, _STANCES).astype(int)):
        q = np.array([library.q[k, columns[n]] if n in columns else 0.0 for n in body.coordinate_names], float)
        pose = Pose(library.roots[k], q).within(body.limits)
        out.append(Stance(pose.root[:3, :3], float(pose.root[2, 3]), pose.q))
    return out


def _plates(session: Session, views: Views) -> Sequence[AnyArray | None] | None:
    """Pictures of the empty scene, as the images of the views; a camera may have none."""
    folder = session.first_pose.plates
    if folder is None:
        return None
    out = list[AnyArray | None]()
    for camera in views.rig:
        file = next((f for e in _ENDINGS if (f := Path(folder) / f"{camera.name}{e}").is_file()), None)
        image = None if file is None else cv2.cvtColor(read_image(file, "plate"), cv2.COLOR_BGR2RGB)
        if image is not None and image.shape[1::-1] != camera.size:
            its, wanted = (f"{w}×{h}" for w, h in (image.shape[1::-1], camera.size))
            raise InputError(f"plate {file} is {its} pixels, but the calibration is for {wanted}; film it anew.")
        out.append(None if image is None else preparation(camera, views.scale)(image))
    if all(image is None for image in out):
        wanted = f"{views.rig.names[0]}.png"
        raise InputError(f"[first_pose] plates: {folder} holds no picture of a camera; one would be {wanted}.")
    return out
