"""Zero-lag low-pass filtering of time series, across no gap."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool, Float, runs
from twistcap.errors import InputError

_ORDER = 2  # of one pass; there and back it is 4
_PASSES = 2
_LEAST = 12  # frames of a run that can be filtered


def butterworth(values: Float, rate: float, cutoff: float, known: Bool | None = None) -> Float:
    """Values (N, ...) at an even `rate` (1/s), low-passed by a Butterworth filter of fourth order without lag.

    It runs forth and back; the `cutoff` (Hz, −3 dB) is that of both passes together (Winter, "Biomechanics and Motor
    Control of Human Movement", 4th ed. 2009, ch. 3, DOI 10.1002/9780470549148). Runs of `known` frames (N,) are
    filtered by themselves; frames that are not known are NaN, and so are runs of fewer than 12 frames. Raises
    InputError for a cutoff that is not between 0 and half the rate.
    """
    from scipy.signal import butter, sosfiltfilt  # slow to import

    if not 0 < cutoff < rate / 2:
        most = f"above 0 and below {rate / 2:.3g} Hz"
        raise InputError(f"the cutoff is {cutoff:g} Hz; at {rate:g} frames per second it must be {most}.")
    turned = np.tan(np.pi * cutoff / rate) / (2 ** (1 / _PASSES) - 1) ** (1 / (2 * _ORDER))  # as the filter warps it
    corrected = rate / np.pi * np.arctan(turned)
    sos = butter(_ORDER, corrected, fs=rate, output="sos")
    out = np.full(values.shape, np.nan)
    for start, end in runs(np.ones(len(values), np.bool_) if known is None else known):
        if end - start >= _LEAST:
            out[start:end] = sosfiltfilt(sos, values[start:end], axis=0)
    return out
