"""What a user should see of a first pose: residuals, px, stature, length factors, and sentences where they are odd.

A body with free lengths follows almost any calibration, and a robust fit almost any keypoints. So it is said what they
became, and the file that is probably wrong is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.adjust.first_pose import FirstPose, fit_keypoints
from twistcap.adjust.first_pose.keypoints import Evidence, evidence
from twistcap.adjust.first_pose.triangulate import triangulate
from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.body.model import unsided
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.pose_file import frame_of
from twistcap.io.session import Session
from twistcap.io.session_tables import GlbBody, HumanoidBody

_ODD, _IMPOSSIBLE = 1.15, 1.45  # ratio of the fitted stature to the stated one
_PEOPLE, _GIANT = (1.3, 2.15), 2.45  # m, where no stature is stated
_FAR, _LEAST = 0.03, 3.0  # residual as a fraction of the person's height in the image, and px, that is too much
_ALONE = 2.0  # times farther off than any other camera: it is the odd one


@dataclass(frozen=True)
class StartReport:
    """A first pose that was fitted to keypoints or clicks.

    `residual_px` (C, L) is NaN where no keypoint is. `lengths` are the factors by kind of segment against a body of the
    fitted stature.
    """

    cameras: tuple[str, ...]
    names: tuple[str, ...]
    residual_px: Float
    stature: float  # m, as fitted
    stated: float  # m, of [body]
    lengths: Mapping[str, float]
    warnings: tuple[str, ...]

    def worst(self) -> list[tuple[str, Float]]:
        """The six joints of the largest residuals, the worst first, each with its residual (C,) by camera."""
        most = np.nan_to_num(self.residual_px, nan=-1.0).max(axis=0)
        order = [k for k in np.argsort(-most, kind="stable")[:6] if most[k] >= 0]
        return [(self.names[k], self.residual_px[:, k]) for k in order]

    @property
    def medians(self) -> Float:
        """(C,) median residual of each camera, px; NaN where it has no keypoint."""
        return _medians(self.residual_px)


def start_report(session: Session, rig: Rig, generic: Body, keypoints: Keypoints, fit: FirstPose) -> StartReport:
    """What a fit became, against the body before it. Raises InputError for a person of impossible size."""
    stated = session.body.stature if isinstance(session.body, HumanoidBody) else rest_height(generic)
    whole = stated / rest_height(generic)  # of whom the body may be the legs alone
    stature = whole * rest_height(fit.body)
    size = stature if session.fits_lengths else whole * rest_height(fit_keypoints(generic, rig, keypoints).body)
    lengths = {unsided(name): factor for name, factor in fit.proportions.lengths.items()}
    far = _residual_warnings(session, generic, rig, keypoints, fit)
    warnings = [*_size_warning(session, size, stated, far), *far]
    return StartReport(fit.cameras, fit.names, fit.residual_px, stature, stated, lengths, tuple(warnings))


def other_frame_in_words(session: Session) -> str:
    """That the first pose is of another frame than the first one; "" where it is not, or nothing says of which."""
    table, first = session.first_pose, (session.frames or (0,))[0]
    if table.file is None:
        return ""
    of = frame_of(table.file) if table.frame is None else table.frame
    if of is None or of == first:
        return ""
    fact = f"the first pose is of frame {of}, and tracking begins at frame {first}: the person may be lost"
    return f"{session.source}: {fact}; give a first pose of frame {first}, or begin at frame {of}."


def rest_height(body: Body) -> float:
    """Height of the surface in the rest pose, m."""
    return float(np.ptp(body.vertices[:, 2]))


def _size_warning(session: Session, size: float, stated: float, far: Sequence[str]) -> list[str]:
    """A person who is much larger or smaller than stated: mostly the unit or the board's squares. These leave keypoints
    on the body; where what is said of them is that they are `far` from it, that is the cause.
    """
    ratio, calibration = size / stated, f"calibration {session.cameras.calibration}"
    said = not isinstance(session.body, HumanoidBody) or "stature" in session.body.model_fields_set
    what = "the body of [body] is" if isinstance(session.body, GlbBody) else "[body] stature is"
    if said:
        odd, absurd = (max(ratio, 1 / ratio) > limit for limit in (_ODD, _IMPOSSIBLE))
        fact = f"by the keypoints the person is {size:.2f} m tall, {what} {stated:.2f} m"
    else:
        odd, absurd = not _PEOPLE[0] < size < _PEOPLE[1], size > _GIANT
        fact = f"by the keypoints the person is {size:.2f} m tall"
    larger = f"{ratio:.2f} times too large" if ratio > 1 else f"{1 / ratio:.2f} times too small"
    mend = "check its unit, its board's squares, the size of the keypoints' images"
    mend += ", or [body]" if said else ", or set [body] stature"
    sentence = f"{calibration} is probably {larger}: {fact}; {mend}."
    if absurd:
        raise InputError(far[0] if far else sentence)
    return [sentence] if odd else []


def _residual_warnings(session: Session, body: Body, rig: Rig, keypoints: Keypoints, fit: FirstPose) -> list[str]:
    """Keypoints that are far from the body: of one camera, of all that contradict each other, or of a body that cannot
    take their pose."""
    seen = evidence(body, rig, keypoints)
    views = zip(seen.pixels, seen.weights, strict=True)
    limit = np.array([max(_FAR * np.ptp(p[w > 0], axis=0).max(), _LEAST) if w.any() else np.inf for p, w in views])
    median = _medians(fit.residual_px)
    ratios = np.nan_to_num(median / limit)
    worst, *others = np.argsort(-ratios)
    if ratios[worst] <= 1:
        return []
    given, calibration = keypoints_source(session), f"calibration {session.cameras.calibration}"
    if len(others) >= 2 and ratios[worst] > _ALONE * ratios[others[0]]:
        name, off = rig.names[worst], median[worst]
        causes = f"it shows another person or time in {given}, or {calibration} has it in another place"
        return [f"camera {name}: its keypoints are {off:.0f} px from the body that the others agree on; {causes}."]
    off = f"the keypoints of {given} are {np.nanmedian(median):.0f} px from the fitted body"
    if _agreement(seen, limit) < 0.5:
        causes = f"the views contradict each other: {calibration} is of another set-up, or they are of other frames,"
        return [f"{off}, and {causes} people or sizes of image."]
    return [f"{off}, though the views agree: their format is another one, or [body] cannot take this pose."]


def _agreement(seen: Evidence, limit: Float) -> float:
    """Fraction of the keypoints that lie on the triangulated points, whatever the body."""
    sigma = np.broadcast_to(limit[:, None] / 4.0, seen.weights.shape)
    _, inliers = triangulate(seen.rig, np.where(seen.weights[..., None] > 0, seen.pixels, np.nan), seen.weights, sigma)
    return float(inliers.sum() / max((seen.weights > 0).sum(), 1))


def _medians(residual: Float) -> Float:
    return np.array([np.median(r[np.isfinite(r)]) if np.isfinite(r).any() else np.nan for r in residual])


def keypoints_source(session: Session) -> str:
    """The file, folder or model from which the keypoints are."""
    table = session.first_pose
    if table.detector is not None:
        return f"detector {table.detector.model}"
    if table.keypoints is not None and table.keypoints.folders:
        return next(iter(table.keypoints.folders.values()))
    return table.clicks or "the clicks"
