"""A cue of one file and one line: it tracks, is masked, saved, restored and reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.mean_colour import LevelTerm, MeanColour
from twistcap.build import CUES, build
from twistcap.cues.visibility import OcclusionRule
from twistcap.errors import InputError
from twistcap.io.state import from_bytes, to_bytes
from twistcap.studio import StudioConfig, capture
from twistcap.track import Settings, step


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one line."""
    monkeypatch.setitem(CUES.own, "mean_colour", "support.mean_colour:MeanColour")  # type: ignore[arg-type]


def test_a_cue_of_one_line_tracks_is_reported_saved_and_restored() -> None:
    scene = capture(StudioConfig(seed=3, views=2, frames=6, size=(192, 140)))
    model = build(scene.body, scene.rig, Settings(plugins=("mean_colour",)))
    state = model.start(scene.first_pose)
    for k in range(3):
        state, estimate = step(state, scene.frame(k), model)
    assert estimate.energies["mean colour"] > 0.0
    assert state.cues["mean colour"].frames.max() > 0
    again, _ = from_bytes(to_bytes(state), build(scene.body, scene.rig, Settings(plugins=("mean_colour",))))
    np.testing.assert_array_equal(again.cues["mean colour"].mean, state.cues["mean colour"].mean)
    one, other = step(state, scene.frame(3), model)[1], step(again, scene.frame(3), model)[1]
    np.testing.assert_array_equal(one.pose.q, other.pose.q)


def test_any_cue_is_masked_where_a_part_is_not_in_sight(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = capture(StudioConfig(seed=3, views=2, frames=3, size=(192, 140)))
    plain = build(scene.body, scene.rig, Settings(plugins=("mean_colour",)))
    model = replace(plain, occlusion=OcclusionRule(), learn_every=1)
    state = model.start(scene.first_pose)
    for k in range(2):
        state, _ = step(state, scene.frame(k), model)
    hidden = scene.body.segment("radius_r")
    state = replace(state, occluded=np.arange(len(state.occluded)) == hidden)
    weights = list[float]()

    def rows(self: LevelTerm, posed: object) -> object:
        weights.extend(self.weight[self.points.part == hidden])
        return original(self, posed)

    original = LevelTerm.rows
    monkeypatch.setattr(LevelTerm, "rows", rows)
    monkeypatch.setattr(OcclusionRule, "after", lambda self, visibility, *_: visibility)  # it stays hidden
    step(state, scene.frame(2), model)
    assert weights and not any(weights)


def test_what_cannot_be_saved_or_told_apart_is_refused() -> None:
    scene = capture(StudioConfig(seed=3, views=2, frames=1, size=(96, 70)))

    class Untyped(MeanColour):
        def start(self, body, rig):  # type: ignore[no-untyped-def]
            return super().start(body, rig)

    model = build(scene.body, scene.rig)
    with pytest.raises(InputError, match="does not say what its start returns"):
        replace(model, cues=(*model.cues, Untyped()))
    with pytest.raises(InputError, match="two cues have the name 'mean colour'"):
        replace(model, cues=(MeanColour(), MeanColour()))
    for name in ("prädiktor", "a name that is longer than a file holds"):
        with pytest.raises(InputError, match="20 letters of ASCII at most"):
            replace(model, cues=(type("Named", (MeanColour,), {"name": name})(),))
    for wrong in ("mean_colour", ("mean_colour", "mean_colour")):
        with pytest.raises(InputError, match="give a list of names, each once"):
            Settings(plugins=wrong)  # type: ignore[arg-type]
