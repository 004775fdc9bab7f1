"""Kernels of the refinement against their readable twins."""

from __future__ import annotations

import numpy as np
from twistcap.refine.evidence import segment_rows

from support.twins import check_twin
from twistcap import se3


def test_rows_by_segments_are_those_of_the_twin() -> None:
    rng = np.random.default_rng(0)
    segments = rng.integers(0, 4, (30, 3)).astype(np.int32)  # a segment may come twice
    weights = rng.dirichlet(np.ones(3), 30)
    weights[::4, 1] = 0.0
    transforms = se3.exp(rng.normal(size=(4, 6)))
    check_twin(segment_rows, transforms, segments, weights, rng.normal(size=(30, 3)), rng.normal(size=(30, 3)))
