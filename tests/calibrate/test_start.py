"""Where an adjustment starts: a lens by itself, and the places of boards that it shows."""

from __future__ import annotations

import numpy as np
import pytest

from support.boards import BIG, SIZE, numbers_of, ring_rig, seen_by
from twistcap import se3
from twistcap.calibrate.sightings import Sighting
from twistcap.calibrate.start import fitted_lens, placed
from twistcap.calibrate.terms import flat


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_point_does_not_tilt_a_board_the_other_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = ring_rig(1, rng)[0]
    lens, numbers = numbers_of(camera)
    turn = se3.exp_rotation(np.deg2rad([12.0, -9.0, 20.0]))
    board = se3.transform(turn, np.array([-0.4, -0.3, 2.6]))
    ids, pixels = seen_by(camera, se3.inverse(camera.T_cam_world) @ board, BIG)
    pixels = pixels + 0.2 * rng.normal(size=pixels.shape)
    pixels[rng.integers(len(pixels))] += 30.0 * rng.normal(size=2)
    found = placed(lens, numbers, Sighting(0, 0, ids, pixels), flat(BIG.points))[0]
    assert np.linalg.norm(se3.log_rotation(found[:3, :3] @ turn.T)) < np.deg2rad(1.5)


@pytest.mark.parametrize("seed", [4, 8])
def test_a_plain_lens_is_no_fisheye_for_a_few_wrong_points(seed: int) -> None:
    """With boards that are turned to the camera, which two in a hundred wrong points may tilt either way."""
    rng = np.random.default_rng(seed)
    camera = ring_rig(1, rng)[0]
    own = list[Sighting]()
    for m in range(40):
        turn = se3.exp_rotation(0.25 * rng.normal(size=3))
        board = se3.transform(turn, rng.uniform([-1.2, -0.8, 2.4], [0.4, 0.2, 3.6]))
        ids, pixels = seen_by(camera, se3.inverse(camera.T_cam_world) @ board, BIG)
        wrong = 30.0 * (rng.uniform(size=(len(ids), 1)) < 0.02)
        pixels = pixels + (0.2 + wrong) * rng.normal(size=pixels.shape)
        own += [Sighting(0, m, ids, pixels, 2.0)] if len(ids) else []
    fit = fitted_lens(own, flat(BIG.points), SIZE, "cam0", ("brown", "fisheye"))
    assert fit.lens.kind == "brown"
    assert fit.adjustment.sigmas[0] == pytest.approx(0.2, rel=0.1)
    kept = [k.mean() for k in fit.adjustment.kept]
    assert len(kept) == min(len(own), 30) and min(kept) > 0.8
