"""The formats of calibrations, by name and by what a path looks like."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twistcap.camera import Rig
from twistcap.doors.text import read_text
from twistcap.errors import InputError, check, check_choice, naming
from twistcap.io.calibration import knows_floor, parsed_rig, says_unit, write_rig
from twistcap.io.cameras.axes import Up, checked_up
from twistcap.io.cameras.parts import Asked
from twistcap.io.cameras.storage import read_easymocap, read_opencv, write_easymocap, write_opencv
from twistcap.io.cameras.studios import read_qualisys, read_vicon, write_qualisys, write_vicon
from twistcap.io.cameras.tables import caliscope_names, read_caliscope, read_opencap, write_caliscope, write_opencap
from twistcap.io.cameras.texts import read_colmap, read_projections, write_colmap, write_projections
from twistcap.io.cameras.units import UNITS, scaled, taken_unit
from twistcap.io.files import unwritable
from twistcap.io.plausible import check_plausible

OPENCAP_FLOOR = "OpenCap's world begins at its checkerboard, so the height of the floor is not known"


@dataclass(frozen=True)
class CameraFormat:
    """A format of calibrations.

    Attributes:
        name: of it.
        parsed: of a path; in the unit asked for, else in the file's, which counts as metres where it is not known.
        write: a rig to a path.
        folder: whether a path is a folder, or else the `ending` of its file.
        says_unit: whether a file fixes its unit; else its cameras tell it.
        renamed: names of cameras by which they are read again; None where they stay.
    """

    name: str
    parsed: Callable[[Path, Asked], Rig]
    write: Callable[[Rig, Path], None]
    folder: bool = False
    ending: str = ""
    says_unit: Callable[[Path], bool] = lambda path: True
    renamed: Callable[[Sequence[str]], Sequence[str]] | None = None

    def read(self, path: Path, asked: Asked) -> tuple[Rig, str]:
        """The rig of a path, m, and a sentence on its unit where that had to be told by its cameras, else "".

        Raises InputError: for a damaged file, one without a size or unit that is not asked for either.
        """
        rig = self.parsed(path, asked)
        if asked.unit is not None or self.says_unit(path):
            return rig, ""
        unit, told = taken_unit(rig, f"calibration {path}")
        return scaled(rig, UNITS[unit]), told


def _never(path: Path) -> bool:
    return False


def _read_toml(path: Path, asked: Asked) -> Rig:
    rig = parsed_rig(path, None if asked.unit is None else "m", "its path")
    return rig if asked.unit is None else scaled(rig, asked.unit)


FORMATS: dict[str, CameraFormat] = {
    f.name: f
    for f in (
        CameraFormat("toml", _read_toml, write_rig, ending=".toml", says_unit=says_unit),  # Pose2Sim and aniposelib
        CameraFormat("caliscope", read_caliscope, write_caliscope, False, ".toml", _never, caliscope_names),
        CameraFormat("opencv", read_opencv, write_opencv, True, says_unit=_never),
        CameraFormat("easymocap", read_easymocap, write_easymocap, True, says_unit=_never),
        CameraFormat("qualisys", read_qualisys, write_qualisys, ending=".qca.txt"),
        CameraFormat("vicon", read_vicon, write_vicon, ending=".xcp"),
        CameraFormat("opencap", read_opencap, write_opencap, True),
        CameraFormat("colmap", read_colmap, write_colmap, True),
        CameraFormat("projections", read_projections, write_projections, True, says_unit=_never),
    )
}


def format_named(name: str) -> CameraFormat:
    """The format of that name. Raises InputError for another."""
    check_choice("the format of the calibration", name, FORMATS)
    return FORMATS[name]


def format_of(path: Path) -> CameraFormat:
    """The format that a path looks like. Raises InputError where it looks like none."""
    inside = {p.name for p in path.iterdir()} if path.is_dir() else {p.name for p in path.parent.glob("*") if p == path}
    endings = {Path(name).suffix.lower() for name in inside}
    if inside & {"intri.yml", "extri.yml"}:
        return FORMATS["easymocap"]
    if inside & {"cameras.txt", "images.txt"}:
        return FORMATS["colmap"]
    if path.name.lower().endswith(".qca.txt"):
        return FORMATS["qualisys"]
    if path.suffix.lower() == ".toml":
        return FORMATS["caliscope" if "[cameras." in read_text(path) else "toml"]
    by_ending = {".xcp": "vicon", ".yml": "opencv", ".yaml": "opencv", ".xml": "opencv", ".pickle": "opencap"}
    named = [by_ending[e] for e in sorted(endings) if e in by_ending]
    if not named and path.is_dir() and any(path.rglob("*.pickle")):
        named = ["opencap"]
    if named:
        return FORMATS[named[0]]
    if ".txt" in endings:
        return FORMATS["projections"]
    if path.is_dir() and "Calib.toml" in inside:
        return FORMATS["toml"]  # which says that the file is to be named
    raise InputError(f"calibration {path}: its name does not say its format; say it, as --format opencv.")


def read_cameras(
    path: Path, name: str | None = None, asked: Asked | None = None, up: Up | None = None
) -> tuple[Rig, list[str]]:
    """A rig out of any format, m, z up, with a sentence that says how what is up is known, and one on its unit where
    the file does not say that.

    Raises InputError: for a file that is missing or damaged; where unit, size or up are not said and must be; for
    cameras that cannot stand so.
    """
    if not path.exists():
        raise InputError(f"calibration {path} does not exist; check its path.")
    with naming(path):
        kind = format_of(path) if name is None else format_named(name)
        rig, unit = kind.read(path, asked or Asked())
        names = rig.names
        for camera in names:
            if names.count(camera) > 1:
                raise InputError(f"calibration {path}: two cameras are named {camera!r}; give each its own name.")
        rig, statement = checked_up(rig, up, f"calibration {path}")
        check_plausible(rig, floor=None, source=f"calibration {path}")
    return rig, [statement, *([unit] if unit else [])]


def floor_doubt(path: Path, name: str | None = None) -> str:
    """Why z = 0 is not known to be the floor in a calibration of a format; "" where nothing speaks against it."""
    kind = name or format_of(path).name
    if kind == "opencap":
        return OPENCAP_FLOOR
    return "The calibration does not know the floor" if kind == "toml" and not knows_floor(path) else ""


def write_cameras(rig: Rig, path: Path, name: str, doubt: str = "") -> list[str]:
    """Write a rig in a format; `doubt` is why z = 0 is not known to be the floor. Sentences where the format names
    cameras otherwise, and where the floor is not known.

    Raises InputError for a lens that the format cannot say, or a place that cannot be written.
    """
    kind = format_named(name)
    for camera in rig.names if kind.folder else ():
        check(f"camera {camera!r}", Path(camera).name == camera, "its name can be no file's; give it another in IN")
    try:
        if name == "toml":
            write_rig(rig, path, floor=not doubt)
        else:
            kind.write(rig, path)
    except OSError as error:
        raise unwritable(path, error, "calibration") from error
    there = rig.names if kind.renamed is None else kind.renamed(rig.names)
    pairs = ", ".join(f"{mine} = {theirs}" for mine, theirs in zip(rig.names, there, strict=True) if mine != theirs)
    names = [f"In {name} cameras have other names: {pairs}. Name their videos so."] if pairs else []
    unsaid = f"{name} cannot say that, so set [cameras] floor = false in the session"
    kept = "floor = false is written" if name == "toml" else unsaid
    return [*names, f"{doubt}: {kept}."] if doubt else names
