"""Kernels of the cues against their readable twins."""

from __future__ import annotations

import numpy as np
import pytest

from support.twins import check_twin
from twistcap.cues.appearance import part_colours
from twistcap.cues.contour import tallied
from twistcap.cues.memory import first_in_cells, followed, still_alike, strongest_in_cells
from twistcap.differential.support_maps import robust_scale

N, S = 200, 5


def test_colours_of_parts_are_those_of_the_twin() -> None:
    rng = np.random.default_rng(0)
    part = np.kron(rng.integers(-1, S, (6, 7)), np.ones((5, 5))).astype(np.int32)
    features, wanted = rng.uniform(size=(*part.shape, 3)).astype(np.float32), np.arange(S) != 2
    found = check_twin(part_colours, features, part, wanted, rtol=1e-5)
    assert found[0, 0] > 0.0 and not found[2].any()
    assert not check_twin(part_colours, features[:2], part[:2], wanted).any()


def test_scales_are_those_of_the_twin() -> None:
    rng = np.random.default_rng(1)
    residual, part, weight = rng.normal(0, 0.05, N), rng.integers(0, S - 1, N).astype(np.int32), rng.uniform(size=N)
    residual[::7], weight[::5] = np.nan, 0.0
    part[part == 1] = 0
    part[:19] = 1  # too few for a scale of its own, and the last part has none at all
    residual[part == 2] *= 100.0
    scales = check_twin(robust_scale, residual, part, S, weight)
    assert scales[2] == 0.15 and scales[1] == scales[S - 1] != scales[0]
    check_twin(robust_scale, np.full(N, np.nan), part, S, weight)
    check_twin(robust_scale, 1e-6 * residual, part, S, weight)


@pytest.mark.parametrize("count", [0, N])
def test_tallies_are_those_of_the_twin(count: int) -> None:
    rng = np.random.default_rng(2)
    part, outer = rng.integers(0, S - 1, count).astype(np.int32), rng.uniform(size=count) < 0.7
    displacement, contrast = rng.normal(0, 2.0, count), rng.uniform(0, 6, count)
    contrast[::9], displacement[::8] = np.nan, np.nan  # what is not known does not agree
    tolerance = 6.0 * rng.uniform(0.2, 0.5, count)
    points, telling, agreeing = check_twin(tallied, part, outer, tolerance, displacement, contrast, S)
    assert agreeing.sum() < telling.sum() < points.sum() or count == 0


@pytest.mark.parametrize("shape", [(N, 1, 1), (N, 3, 2), (0, 1, 1)])
def test_what_is_remembered_of_points_is_that_of_the_twins(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    was, now = rng.uniform(size=shape), rng.uniform(size=shape)
    now[::9] = np.nan  # off the image
    candidates = rng.uniform(size=len(was)) < 0.8
    which = check_twin(still_alike, was, now, candidates, 0.6)
    assert 0 < len(which) < candidates.sum() or not len(was)
    check_twin(followed, was, now, which[::-1], 0.2)
    check_twin(followed, np.stack([was, was], axis=-1), np.stack([now, was], axis=-1), which, 0.2)


@pytest.mark.parametrize("cell", [1, 7])
def test_points_in_cells_are_those_of_the_twins(cell: int) -> None:
    rng = np.random.default_rng(3)
    pixels, occupied = rng.uniform(0, 60, (300, 2)), np.zeros((60 // cell + 1, 60 // cell + 1), np.bool_)
    occupied[3] = True
    check_twin(first_in_cells, pixels, rng.permutation(300)[:200].astype(np.int32), cell, 2, occupied)
    grey = rng.uniform(size=(60, 60)).astype(np.float32)
    nearness = np.where(rng.uniform(size=(60, 60)) < 0.9, 0.3, 0.0).astype(np.float32)
    nearness[30:] *= 2.0
    for inverse in (True, False):
        rows, _ = check_twin(strongest_in_cells, grey, nearness, inverse, cell, occupied)
        assert len(rows) > 5
