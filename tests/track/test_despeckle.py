"""The median filter of noisy images."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twistcap.build import build
from twistcap.cues.view import despeckled, speckles
from twistcap.hindsight import tracked
from twistcap.studio import StudioConfig, capture

SMALL = StudioConfig(seed=3, views=2, size=(192, 140), frames=4)


@pytest.mark.parametrize(("noise", "size"), [(0.0, 1), (0.2, 3), (0.6, 5), (1.0, 1)])
def test_images_with_single_wrong_pixels_are_filtered_and_mere_noise_is_not(noise: float, size: int) -> None:
    frame = next(iter(capture(replace(SMALL, uniform_noise=noise)).frames()))
    for image, found in zip(frame.images, despeckled(frame).images, strict=True):
        assert image is not None
        np.testing.assert_array_equal(found, cv2.medianBlur(image, size))


def test_speckles_are_counted_in_bytes_and_fractions_alike() -> None:
    image = np.full((60, 80, 3), 128, np.uint8)
    image[::4, ::4] = 250  # one of sixteen
    assert speckles(image) == pytest.approx(1 / 16, abs=0.01)
    assert speckles((image / 255.0).astype(np.float32)) == speckles(image)
    assert speckles(image[:1]) < 1.0  # fewer rows than are looked at


def test_noisy_images_are_tracked_as_if_they_had_been_filtered_before() -> None:
    scene = capture(replace(SMALL, uniform_noise=0.2))
    frames = list(scene.frames())
    filtered = [replace(f, images=tuple(None if i is None else cv2.medianBlur(i, 3) for i in f.images)) for f in frames]
    model = build(scene.body, scene.rig)
    own, given = (list(tracked(shown, model, scene.first_pose)) for shown in (frames, filtered))
    np.testing.assert_array_equal(own[-1].pose.q, given[-1].pose.q)
