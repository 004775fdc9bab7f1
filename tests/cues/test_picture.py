"""The one image of a view: blurs, and the levels of a pyramid."""

from __future__ import annotations

import numpy as np

from support.shapes import camera_at
from twistcap.cues.view import Picture, View
from twistcap.features import grey, opponent

RNG = np.random.default_rng(0)
BYTES = RNG.integers(0, 256, (41, 54, 3)).astype(np.uint8)


def test_opponent_channels_are_grey_and_two_colours() -> None:
    found = opponent(BYTES)
    np.testing.assert_allclose(found[0], grey(BYTES), atol=3e-3)
    plain = np.full((4, 5, 3), 0.4)
    np.testing.assert_allclose(
        opponent(plain), np.array([0.4, 0.0, 0.0])[:, None, None] + np.zeros((3, 4, 5)), atol=1e-6
    )
    red, yellow, blue = (opponent(np.full((1, 1, 3), c))[:, 0, 0] for c in ([1, 0, 0], [1, 1, 0], [0, 0, 1]))
    assert red[1] > 0 and yellow[2] > 0 > blue[2]
    assert opponent(BYTES, colour=False).shape == (1, 41, 54) == opponent(BYTES[..., 0]).shape


def test_levels_keep_a_planes_values_at_their_pixels() -> None:
    y, x = np.mgrid[:80, :120]
    picture = Picture((0.002 * x + 0.003 * y).astype(np.float32))
    for k, level in enumerate(picture.levels(3)):
        assert level.shape == (1, 80 // 2**k, 120 // 2**k)
        rows, columns = np.mgrid[5 : level.shape[1] - 5, 5 : level.shape[2] - 5]
        at = [2**k * i + 0.5 * (2**k - 1) for i in (columns, rows)]
        np.testing.assert_allclose(level[0, 5:-5, 5:-5], 0.002 * at[0] + 0.003 * at[1], atol=2e-3)


def test_blurs_and_levels_are_computed_once() -> None:
    picture = View(camera_at((3.0, 0.4, 0.5)), BYTES).picture
    assert picture.blurred(2.0) is picture.blurred(2.04)
    assert picture.level(1) is picture.level(1) and picture.level(1).shape == (3, 20, 27)
    assert picture.level(1, colour=False).shape == (1, 20, 27)
    np.testing.assert_allclose(picture.level(1)[:1], picture.level(1, colour=False), atol=1e-6)
