"""The state is all that a frame depends on: it is saved and restored, and what was tried in vain leaves no trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from reproduce.scenes.subjects import walks_of_another
from twistcap.body import Posed
from twistcap.build import build
from twistcap.differential.model import DifferentialModel
from twistcap.differential.settings import DifferentialConfig
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.io.state import from_bytes, to_bytes
from twistcap.motion import MotionLibrary
from twistcap.motion.library import unwrapped
from twistcap.priors import ParzenPrior
from twistcap.search.limb import LimbRule
from twistcap.search.lost import LostBody
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, Settings, step


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal to the last bit, all that is in them included."""
    if isinstance(one, np.ndarray):
        return (
            isinstance(other, np.ndarray)
            and one.dtype == other.dtype
            and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
        )
    if isinstance(one, Posed):
        return same(one.pose, other.pose)
    if is_dataclass(one) and not isinstance(one, type):
        names = [f.name for f in fields(one) if not f.name.startswith("_")]
        return type(one) is type(other) and all(same(getattr(one, n), getattr(other, n)) for n in names)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other) or (one != one and other != other)


@cache
def scene(views: int) -> tuple[Capture, tuple[Frame, ...]]:
    """A walk with frames that all cameras miss."""
    made = capture(StudioConfig(seed=6, views=views, size=(192, 140), frames=15, dropped=((5, 11),), fps=30.0))
    return made, tuple(made.frames())


@cache
def library() -> MotionLibrary:
    walk = capture(StudioConfig(seed=9, frames=150, fps=30.0))
    q = unwrapped(np.array([pose.q for pose in walk.true_poses]))
    roots = np.array([pose.root for pose in walk.true_poses])
    ends = np.array([0, len(q)], np.int32)
    return MotionLibrary(walk.true_body.coordinate_names, 30.0, ("walk",), ends, q.astype(np.float32), roots)


def model_of(kind: str, made: Capture) -> Any:
    """A tracker with every search on, of one kind."""
    if kind == "prior":
        samples = walks_of_another(made.body, 7)
        return build(made.body, made.rig, prior=ParzenPrior.trained(made.body.coordinate_names, samples))
    if kind in ("followed", "guarded"):
        return build(made.body, made.rig, Settings(predictor="motion", motion=kind), motions=library())  # type: ignore[arg-type]
    if kind == "differential":
        return DifferentialModel(made.body, DifferentialConfig(behind="dominant"), rig=made.rig)
    return build(
        made.body,
        made.rig,
        {"direct": None, "levelset": Settings(method="levelset"), "flow": Settings(predictor="flow")}[kind],
    )


def tracked(state: Any, frames: Sequence[Frame], model: Any) -> tuple[Any, list[Estimate]]:
    out: list[Estimate] = []
    for frame in frames:
        state, estimate = step(state, frame, model)
        out.append(estimate)
    return state, out


@pytest.mark.parametrize(
    ("kind", "views"),
    [
        ("direct", 4),
        ("direct", 2),
        ("levelset", 2),
        ("prior", 2),
        ("flow", 2),
        ("followed", 2),
        ("guarded", 2),
        ("differential", 2),
    ],
)
def test_a_track_that_goes_on_from_any_frame_is_the_undisturbed_one(kind: str, views: int) -> None:
    made, frames = scene(views)
    model, state = model_of(kind, made), None
    states = [model.start(made.first_pose)]
    whole: list[Estimate] = []
    for frame in frames:
        state, estimate = step(states[-1], frame, model)
        states.append(state)
        whole.append(estimate)
    again, (every, far) = model_of(kind, made), (1, 1) if (kind, views) == ("direct", 2) else (4, 2)
    for k in reversed(range(0, len(frames), every)):  # back in time: a model that remembers is found out
        restored, _ = from_bytes(to_bytes(states[k]), again)
        assert same(restored, states[k]), k
        end, rest = tracked(restored, frames[k : k + far], again)
        assert same(tuple(rest), tuple(whole[k : k + far])), k
        assert same(end, states[min(k + far, len(frames))]), k


@pytest.mark.parametrize("kind", ["direct", "differential"])
def test_a_step_changes_nothing_in_place(kind: str) -> None:
    made, frames = scene(2)
    model = model_of(kind, made)
    state, _ = tracked(model.start(made.first_pose), frames[:4], model)
    before = to_bytes(state)
    first, second = step(state, frames[4], model), step(state, frames[4], model)
    assert np.array_equal(before, to_bytes(state))
    assert same(first, second)


def test_a_rejected_hypothesis_leaves_no_trace() -> None:
    """The whole state is the same whether hypotheses were tried and rejected, or none was tried."""
    made, frames = scene(2)
    samples = walks_of_another(made.body, 7)
    prior = ParzenPrior.trained(made.body.coordinate_names, samples)
    plain = build(made.body, made.rig, prior=prior)

    def with_search(eager: bool) -> Model:
        # One looks for a limb in every frame; nothing can win. The other never looks.
        rule = LimbRule(every=1 if eager else 10**5, worth=0.0, gain=1e5)
        return replace(plain, searches=(LostBody(limb=rule),))

    ends = [tracked(m.start(made.first_pose), frames, m) for m in (with_search(True), with_search(False))]
    (tried, tried_estimates), (never, never_estimates) = ends
    assert same(tuple(tried_estimates), tuple(never_estimates))
    assert same(tried, never)


@pytest.mark.parametrize("harm", ["cut", "flip", "other model", "other method"])
def test_a_damaged_or_foreign_state_is_refused(harm: str) -> None:
    made, frames = scene(2)
    model = build(made.body, made.rig)
    data = to_bytes(tracked(model.start(made.first_pose), frames[:2], model)[0])
    if harm == "cut":
        data = data[: len(data) // 2]
    elif harm == "flip":
        data = data.copy()
        data[len(data) // 3] ^= 255
    elif harm == "other model":
        model = build(made.body, made.rig, Settings(brightness=False))
    else:
        model = model_of("differential", made)
    messages = {"other model": "differ in the cues photometric", "other method": "is of another method"}
    with pytest.raises(InputError, match=messages.get(harm, "stored state of the track .*damaged")):
        from_bytes(data, model)
