"""OpenSim's inverse kinematics on exported tracks against their own motion: python benchmarks/opensim_ik.py RESULT...

For each result file `--to opensim` is written, IK runs on its TRC, and what it finds is compared with its MOT, frame by
frame: greatest root mean square of the angles and of the pelvis's place, and the angles that IK holds at a limit of the
model. It needs the package opensim. The results come from `twistcap track` and `twistcap studio`.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
import opensim

from twistcap.io.angles import PELVIS_PLACE
from twistcap.io.motion_files import MotionTable, read_mot
from twistcap.io.opensim_package import write_opensim
from twistcap.io.result import read_result

AT_LIMIT = np.deg2rad(0.1)


def solved(path: Path, folder: Path) -> tuple[MotionTable, MotionTable]:
    """Ours, of the frames that are known, and what IK finds. It runs in the folder, as its set-up says."""
    write_opensim(folder, read_result(path))
    before = Path.cwd()
    os.chdir(folder)
    try:
        assert opensim.InverseKinematicsTool("ik.xml").run()
    finally:
        os.chdir(before)
    return read_mot(folder / "angles.mot"), read_mot(folder / "ik.mot")


def at_limits(model: Path, found: MotionTable) -> list[str]:
    """Names of the angles that touch an end of their range in any frame."""
    opened, out = opensim.Model(str(model)), list[str]()  # its coordinates die with it
    coordinates = opened.getCoordinateSet()
    for k in range(coordinates.getSize()):
        one = coordinates.get(k)
        if one.getName() in found.columns and one.getName() not in PELVIS_PLACE:
            values = found.get(one.getName())
            ends = values - one.getRangeMin(), one.getRangeMax() - values
            if min(end.min() for end in ends) < AT_LIMIT:
                out.append(one.getName())
    return out


def compared(path: Path, folder: Path) -> str:
    ours, theirs = solved(path, folder)
    np.testing.assert_allclose(theirs.times, ours.times, atol=1e-6)
    rms = {name: float(np.sqrt(np.mean((ours.get(name) - theirs.get(name)) ** 2))) for name in ours.columns}
    place = 1000 * max(rms.pop(name) for name in PELVIS_PLACE)
    worst = max(rms, key=lambda name: rms[name])
    limits = at_limits(next(folder.glob("*.osim")), theirs)
    return (
        f"{path}: {len(ours.times)} frames, {len(rms)} angles within {np.degrees(rms[worst]):.4f} deg rms ({worst}), "
        f"pelvis within {place:.3f} mm, at a limit: {', '.join(limits) or 'none'}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", type=Path)
    opensim.Logger.setLevelString("error")
    for result in parser.parse_args().results:
        with tempfile.TemporaryDirectory() as place:
            print(compared(result.resolve(), Path(place)), flush=True)
