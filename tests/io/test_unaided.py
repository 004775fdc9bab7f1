"""Who is looked for, where a session says it by a pixel in each camera."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError
from twistcap.io.unaided import asked_for

PLACE, ABOVE = np.array([0.3, -0.2, 1.0]), np.array([0.3, -0.2, 2.0])
RIG = Rig(
    tuple(
        Camera(f"cam{c}", np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), look_at(eye, [0, 0, 1]), (640, 480))
        for c, eye in enumerate(np.array([[3.0, 0.0, 1.5], [0.0, 3.0, 1.5], [-3.0, 0.0, 1.5]]))
    )
)


def _pixels(place: np.ndarray, *cameras: str) -> dict[str, tuple[float, float]]:
    found = {c.name: c.project(place)[0] for c in RIG if c.name in cameras}
    return {name: (float(x), float(y)) for name, (x, y) in found.items()}


def test_the_rays_of_all_cameras_meet_at_the_person() -> None:
    found = asked_for(_pixels(PLACE, "cam0", "cam1", "cam2"), RIG)
    assert found is not None
    np.testing.assert_allclose(found, PLACE, atol=1e-6)
    assert asked_for({}, RIG) is None


@pytest.mark.parametrize(
    ("pixels", "sentence"),
    [
        ({"left": (1.0, 2.0)}, r"at names left; the cameras are cam0, cam1, cam2"),
        (_pixels(PLACE, "cam0"), "at has only cam0; give the person's pixel in a second camera"),
        ({"cam0": (640.0, 3.0), "cam1": (3.0, 3.0)}, "is outside the image of cam0"),
        (_pixels(PLACE, "cam0") | _pixels(ABOVE, "cam1"), r"miss each other by 0\.[45]\d m"),
    ],
)
def test_pixels_of_no_person_are_refused(pixels: Mapping[str, tuple[float, float]], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        asked_for(pixels, RIG)
