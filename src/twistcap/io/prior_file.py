"""Pose priors: trained from motion files and results, kept as NPZ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from twistcap.arrays import Float
from twistcap.doors.npz import read_npz
from twistcap.doors.schema import Schema, real, word
from twistcap.errors import InputError, check, naming
from twistcap.io.angles import complete_coordinates
from twistcap.io.files import write_npz
from twistcap.io.motion_files import poses_of_file
from twistcap.io.result import read_result
from twistcap.priors import ParzenPrior

FORMAT = "twistcap-prior"
_PRIOR: Schema = {
    "format": word(), "names": word("J"), "samples": real("N", "J"), "sigma": real(), "scale": real("J"),
}  # fmt: skip
_POSES: Schema = {"q": real("N", "J"), "coordinate_names": word("J")}
Motion = tuple[tuple[str, ...], Float]
"""Names of J joint coordinates, and samples (N, J) of them, rad."""


def write_prior(path: str | Path, prior: ParzenPrior) -> Path:
    """Write a prior as NPZ: format, names, samples (rad), sigma, scale."""
    scale = np.ones(len(prior.names)) if prior.scale is None else prior.scale
    arrays = {"names": prior.names, "samples": prior.samples, "sigma": prior.sigma, "scale": scale}
    return write_npz(path, "prior", format=FORMAT, **arrays)


def read_prior(path: str | Path) -> ParzenPrior:
    """Read what `write_prior` wrote. Raises InputError for a file that is missing, is no prior, or holds numbers that
    are not finite.
    """
    data = read_npz(path, "prior", _PRIOR, "it is no twistcap prior; make one with twistcap prior train")
    if str(data["format"]) != FORMAT:
        raise InputError(f"prior {path} is no twistcap prior; make one with twistcap prior train.")
    with naming(path):
        return ParzenPrior(tuple(data["names"].tolist()), data["samples"], float(data["sigma"]), data["scale"])


def trained_prior(
    paths: Sequence[str | Path], every: int = 1, coordinates: Sequence[str] | None = None, sigma: float | None = None,
    scale: Mapping[str, float] | None = None,
) -> ParzenPrior:  # fmt: skip
    """A prior of all samples of some motions.

    Args:
        paths: MOT or STO, a result file (its lost frames are left out), or an NPZ of poses (``q``,
            ``coordinate_names``, rad) such as the studio's ``truth.npz``.
        every: frames from one sample to the next, 1 for all.
        coordinates: to learn; by default all that every file has.
        sigma: kernel width, rad; by default the paper's rule.
        scale: by coordinate, divisor of its differences; 1 where it is not named.

    Raises InputError for a file that cannot be read, a value that is not finite, or a coordinate that a file lacks.
    """
    if not paths or every < 1:
        raise InputError("prior: give one motion file or more, and every how many frames to take (1 or more).")
    motions = [_motion(Path(path)) for path in paths]
    names = tuple(coordinates or [n for n in motions[0][0] if all(n in known for known, _ in motions)])
    check("prior", names, f"{', '.join(map(str, paths))} have no joint coordinate in common")
    parts: list[Float] = []
    for path, (known, q) in zip(paths, motions, strict=True):
        for name in names:
            if name not in known:
                raise InputError(f"motion {path} has no coordinate {name!r}; it has {', '.join(known)}.")
        parts.append(q[::every, [known.index(name) for name in names]])
    return ParzenPrior.trained(names, np.concatenate(parts), sigma, scale_of(names, scale))


def adjusted(prior: ParzenPrior, sigma: float | None, scale: Mapping[str, float] | None) -> ParzenPrior:
    """A prior with another width or scales; new scales without a width take the paper's rule again. Raises InputError
    for a scale of a coordinate that the prior does not have.
    """
    if sigma is None and not scale:
        return prior
    scales = scale_of(prior.names, scale) if scale else prior.scale
    return ParzenPrior.trained(prior.names, prior.samples, sigma, scales)


def scale_of(names: Sequence[str], scale: Mapping[str, float] | None) -> Float | None:
    """(J,) scales of the coordinates, 1 where none is given."""
    for name in scale or {}:
        check("prior", name in names, f"scale names {name!r}, which is none of its coordinates ({', '.join(names)})")
    return np.array([float(scale.get(name, 1.0)) for name in names]) if scale else None


def _motion(path: Path) -> Motion:
    readers = {".mot": _of_mot, ".sto": _of_mot, ".h5": _of_result, ".hdf5": _of_result, ".npz": _of_npz}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"motion {path} has an unknown ending; give .mot, .sto, .h5 or .npz.")
    names, q = reader(path)
    if q.shape != (len(q), len(names)) or not len(q):
        raise InputError(f"motion {path}: it holds no joint angles, or not one for each of its coordinate names.")
    return names, q


def _of_mot(path: Path) -> Motion:
    """The file's own joint coordinates, in our signs and order."""
    body, table, poses = poses_of_file(path)
    names = complete_coordinates(body, table.columns)
    return names, np.stack([pose.q for pose in poses])[:, [body.coordinate(name) for name in names]]


def _of_result(path: Path) -> Motion:
    result = read_result(path)
    return result.body.coordinate_names, result.q[~result.lost]


def _of_npz(path: Path) -> Motion:
    data = read_npz(path, "motion", _POSES, "it must hold q (poses, coordinates), rad, and coordinate_names")
    return tuple(data["coordinate_names"].tolist()), data["q"]
