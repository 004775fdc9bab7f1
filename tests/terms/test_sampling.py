"""Brightness read between pixels, against its readable twin."""

from __future__ import annotations

import numpy as np

from support.twins import check_twin
from twistcap.terms.photometric import sampled


def test_brightness_between_pixels_is_that_of_the_twin() -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(size=(30, 40)).astype(np.float32)
    image[12, 17] = np.nan
    edges = np.array([[1.0, 1.0], [37.999, 27.999], [38.0, 5.0], [0.999, 5.0], [20.0, 28.0]])
    value, _ = check_twin(sampled, image, np.concatenate([rng.uniform(-2, 42, (300, 2)), edges]), rtol=1e-5, atol=1e-6)
    assert np.isfinite(value[-5:]).tolist() == [True, True, False, False, False]
