"""Kernels of the refinement against their readable twins."""

from __future__ import annotations

import numpy as np

from support.twins import check_twin
from twistcap import se3
from twistcap.adjust.refine.sums import WIDTH, add_products, add_pulls, segment_rows


def test_rows_by_segments_are_those_of_the_twin() -> None:
    rng = np.random.default_rng(0)
    segments = rng.integers(0, 4, (30, 3)).astype(np.int32)
    weights = rng.dirichlet(np.ones(3), 30)
    weights[::4, 1] = 0.0
    transforms, origins, axes = se3.exp(rng.normal(size=(4, 6))), rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    local, gradient = rng.normal(size=(30, 3)), rng.normal(size=(60, 3))  # two rows of each point
    check_twin(segment_rows, transforms, segments, weights, local, origins, axes, gradient)


def test_sums_of_products_are_those_of_the_twins() -> None:
    rng = np.random.default_rng(1)
    segments, others = (rng.integers(-1, 4, (30, 3)).astype(np.int32) for _ in range(2))
    one, other, weight = rng.normal(size=(30, 3, WIDTH)), rng.normal(size=(30, 3, WIDTH)), rng.uniform(size=30)
    weight[::5] = 0.0
    check_twin(add_products, segments, one, others, other, weight, rng.normal(size=(4, 4, WIDTH, WIDTH)))
    check_twin(add_pulls, segments, one, weight, rng.normal(size=(4, WIDTH)))
