"""How much two masks overlap."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import AnyArray


def iou(mask: AnyArray, reference: AnyArray) -> float:
    """Intersection over union of two masks (H, W); 1 for two empty masks."""
    a, b = np.asarray(mask, bool), np.asarray(reference, bool)
    union = int(np.count_nonzero(a | b))
    return float(np.count_nonzero(a & b)) / union if union else 1.0
