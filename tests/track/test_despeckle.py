"""The median filter of the images."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twistcap.build import build
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.hindsight import tracked
from twistcap.studio import StudioConfig, capture
from twistcap.track import Settings

SMALL = StudioConfig(seed=3, views=2, size=(192, 140), frames=4)


def test_despeckled_images_are_tracked_as_if_they_had_been_filtered_before() -> None:
    scene = capture(replace(SMALL, uniform_noise=0.1))
    frames = list(scene.frames())
    filtered = [
        Frame(f.index, f.time, tuple(None if i is None else cv2.medianBlur(i, 3) for i in f.images)) for f in frames
    ]
    model = build(scene.body, scene.rig)
    own = list(tracked(frames, build(scene.body, scene.rig, Settings(despeckle=3)), scene.first_pose))
    given, plain = (list(tracked(shown, model, scene.first_pose)) for shown in (filtered, frames))
    np.testing.assert_array_equal(own[-1].pose.q, given[-1].pose.q)
    assert np.abs(own[-1].pose.q - plain[-1].pose.q).max() > 1e-6
    with pytest.raises(InputError, match="despeckle is 2"):
        Settings(despeckle=2)
