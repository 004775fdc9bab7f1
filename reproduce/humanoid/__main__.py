"""Writes `humanoid.npz` of `twistcap.body`: ``python -m reproduce.humanoid src/twistcap/body/humanoid.npz``."""

from __future__ import annotations

import sys

import numpy as np

from reproduce.humanoid.surface import modelled

if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], allow_pickle=False, **modelled("full"), **modelled("legs"))
