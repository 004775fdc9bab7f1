"""The scene of experiment C-2: colours that recur elsewhere, and that no global density tells apart."""

from __future__ import annotations

import numpy as np

from reproduce.scenes.elsewhere import HORIZON, elsewhere, tones_of
from twistcap.features.colour import grey
from twistcap.region.models import RegionModel
from twistcap.studio import StudioConfig


def test_the_floor_has_the_tone_of_the_skin_and_the_wall_that_of_nothing_worn() -> None:
    scene = elsewhere(StudioConfig(seed=1, views=2, frames=2))
    tones = tones_of(1)
    for room in scene.rooms:
        horizon = HORIZON * len(room)
        assert abs(room[int(horizon) + 10 :].mean() - tones[0]) < 0.06
        assert abs(room[: int(horizon) - 10].mean() - tones[3]) < 0.06
    assert len(np.unique(tones)) == 4


def test_a_local_density_tells_bare_arms_from_the_room_and_a_global_one_does_not() -> None:
    scene = elsewhere(StudioConfig(seed=1, views=2, frames=2))
    body, posed = scene.true_body, scene._moments(0)[0]
    image = scene.image(0, 0)
    assert image is not None
    window = np.s_[40:250, 100:300]  # the person and some room, as the tracker's crop
    features = np.ascontiguousarray(grey(image)[window][..., None])
    inside = np.ascontiguousarray(scene.masks(0)[0][window].astype(np.float32))
    bare = [s for s, name in enumerate(body.segment_names) if "radius" in name or "hand" in name]
    hands = np.isin(body.vertex_part, bare)
    pixels = np.round(scene.true_rig[0].project(posed.vertices[hands])[0]).astype(int) - (100, 40)
    keep = inside[pixels[:, 1], pixels[:, 0]] > 0
    ratios = [
        model.log_ratio(features, inside, np.float32(1.0) - inside, 110.0)[pixels[keep, 1], pixels[keep, 0]]
        for model in (RegionModel("parzen"), RegionModel("local"))
    ]
    assert np.median(ratios[0]) < 0.5  # nats: it cannot tell
    assert np.median(ratios[1]) > 1.5
