"""Passes over a sequence that mend what was lost, two-sided in time, again and again while it grows.

A dozen exposures in a cycle leave an arm that is hidden, or as bright as what it crosses, to chance: once lost it is
not found again from frame to frame. Here each limb chooses among many postures in every frame, all frames together, by
dynamic programming: how well the layers of the picture explain it (`layers`), and how far it moves between frames.
Then the tracker goes over the frames once more, about what was chosen. Photographic plates, a fixed sequence, are
followed so (Bregler and Malik, CVPR 1998, section 5.2).

Layers are learnt from the track itself. Where legs were exchanged in most frames, they would show the wrong ones. So
the passes begin after a few frames, and tracking goes on from what they have mended.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product, zip_longest

import numpy as np

from reproduce.layers import Layers, LimbCost, learnt
from twistcap.arrays import AnyArray, Float, Float32, Int
from twistcap.body import Body
from twistcap.cues.view import Picture
from twistcap.differential.model import DifferentialModel
from twistcap.differential.state import State, Track
from twistcap.differential.step import followed
from twistcap.errors import InputError

_LEVEL = 1  # of the pyramid, at which postures are compared


@dataclass(frozen=True)
class Limb:
    """What is chosen together.

    Attributes:
        coordinates: names, sides left out.
        steps_deg: between the values tried of each.
        counts: of the values tried, odd: so many about the present one.
        stray_deg: standard deviation of each one's change from frame to frame.
    """

    coordinates: tuple[str, ...]
    steps_deg: tuple[float, ...]
    counts: tuple[int, ...]
    stray_deg: tuple[float, ...]

    def of(self, body: Body) -> list[Int]:
        """Its coordinates' numbers in a body, on each side that has them all."""
        sides = [[f"{name}_{side}" for name in self.coordinates] for side in "rl"]
        found = [names for names in sides if set(names) <= set(body.coordinate_names)]
        return [np.array([body.coordinate(name) for name in names], np.int32) for names in found]

    def offsets(self) -> Float:
        """(K, C) changes that are tried, rad."""
        ranges = [d * np.arange(-(n // 2), n // 2 + 1) for d, n in zip(self.steps_deg, self.counts, strict=True)]
        return np.deg2rad(np.array(list(product(*ranges))))


LIMBS = (
    Limb(
        ("hip_flexion", "knee_angle", "hip_adduction", "hip_rotation"), (15, 22, 12, 20), (5, 7, 3, 3), (12, 20, 8, 8)
    ),
    Limb(("arm_flex", "elbow_flex", "arm_add", "arm_rot"), (15, 22, 12, 20), (5, 7, 3, 3), (12, 20, 8, 8)),
)
"""What all angles of a limb do between two plates."""
SWINGS = (
    Limb(("hip_flexion", "knee_angle"), steps_deg=(10, 18), counts=(5, 9), stray_deg=(4, 7)),
    Limb(("arm_flex", "elbow_flex"), steps_deg=(8, 10), counts=(13, 13), stray_deg=(2.7, 4.5)),
)
"""What limbs that swing in a plane do between two frames of a video; arms are looked for over their whole swing."""


@dataclass(frozen=True)
class SequenceConfig:
    """Settings of the passes over a whole sequence.

    Attributes:
        every: so many frames are tracked between passes: a quarter of a cycle of walking, in which limbs cross once.
        limbs: what is chosen together.
        share: of the pixels' information that counts, since neighbours see the same.
        passes: over all frames so far; the second and later ones try values nearer together.
        stray_deg: how far the tracker's joints stray from what was chosen.
    """

    every: int
    limbs: tuple[Limb, ...]
    share: float
    passes: int = 2
    stray_deg: float = 6.0

    def __post_init__(self) -> None:
        if self.every < 1 or self.passes < 0 or not 0.0 < self.share <= 1.0 or self.stray_deg <= 0.0:
            raise InputError(
                "differential: every must be 1 or more, passes not negative, share above 0 and at most 1, "
                "stray_deg positive."
            )


PLATES = SequenceConfig(every=3, limbs=LIMBS, share=0.1)
"""Of a dozen exposures in a cycle."""
WALKING = SequenceConfig(every=15, limbs=SWINGS, share=0.03)
"""Of one view at some 60 frames per second."""


def track_sequence(
    model: DifferentialModel,
    start: State,
    frames: Sequence[Sequence[AnyArray | None]],
    sequence: SequenceConfig,
) -> list[State]:
    """The states of a body in all frames, the first of which is known; the cameras stand still.

    Args:
        model: body and settings of the tracker.
        start: state in the first frame.
        frames: one image per view each.
        sequence: of the passes.

    Raises:
        InputError: where a frame lacks an image, and as `differential.step.followed` does.
    """
    whole = [_whole(n, frame) for n, frame in enumerate(frames)]
    level = min(_LEVEL, model.rule.levels - 1)
    grey = [[Picture(image).level(level, colour=False)[0] for image in frame] for frame in whole]
    near = replace(model, config=replace(model.config, stray_deg=sequence.stray_deg))
    states = [start.sized(whole[0])]
    for end in _ends(len(whole), sequence.every):
        states = _followed(model, near, whole[:end], states)
        for n in range(sequence.passes):
            states = chosen(model.body, states, grey[:end], 0.5**level, sequence, closer=1.0 / (n + 1))
            states = _followed(model, near, whole[:end], states)
    return states


def _ends(frames: int, every: int) -> list[int]:
    """How many frames have been tracked when passes begin; the last stretch is between half and one and a half long."""
    return [*range(every, frames - every // 2, every), frames]


def _followed(
    model: DifferentialModel, near: DifferentialModel, frames: Sequence[Sequence[AnyArray]], states: Sequence[State]
) -> list[State]:
    """The states of all frames, those that have one tracked `near` it; the first one stays."""
    so_far, out = Track.of(states[0]), list[State]()
    for images, state in zip_longest(frames, states):
        so_far, found = followed(so_far, images, model if state is None else near, state)
        out.append(found.state)
    return out


def _whole(n: int, frame: Sequence[AnyArray | None]) -> list[AnyArray]:
    """The images of a frame that has them all."""
    images = [image for image in frame if image is not None]
    if len(images) < len(frame):
        raise InputError(f"differential: frame {n} lacks an image; passes over a sequence take those of every view.")
    return images


def chosen(
    body: Body,
    states: Sequence[State],
    grey: Sequence[Sequence[Float32]],
    factor: float,
    config: SequenceConfig,
    closer: float = 1.0,
) -> list[State]:
    """The states with one limb after the other where it suits all frames best; the first state stays.

    Args:
        body: that is seen.
        states: N, as they are believed to be.
        grey: N frames of V grey pictures (H, W).
        factor: their size against the states' pixels.
        config: settings.
        closer: by how much the values tried lie nearer together.
    """
    posed, V = [s.posed(body) for s in states], len(grey[0])
    seen = [[s.views[v].scaled(factor) for s in states] for v in range(V)]
    layers = [learnt(body, [frame[v] for frame in grey], posed, seen[v]) for v in range(V)]
    out = list(states)
    for limb in config.limbs:
        stray = np.deg2rad(np.array(limb.stray_deg))
        for which in limb.of(body):
            tried = [_tried(body, s, which, closer * limb.offsets() if n else None) for n, s in enumerate(out)]
            pairs = zip(out, tried, strict=True)
            costs = [config.share * _costs(body, layers, n, which, *pair, factor) for n, pair in enumerate(pairs)]
            path = cheapest_path(costs, [t / stray for t in tried])
            out = [_with(s, which, t[k]) for s, t, k in zip(out, tried, path, strict=True)]
    return out


def _tried(body: Body, state: State, which: Int, offsets: Float | None) -> Float:
    """(K, C) values of a limb's coordinates; the present ones alone where there is nothing to choose."""
    here = state.q[which][None]
    return here if offsets is None else np.clip(here + offsets, *body.limits[which].T)


def _with(state: State, which: Int, values: Float) -> State:
    q = state.q.copy()
    q[which] = values
    return State(state.views, q)


def _costs(
    body: Body, layers: Sequence[Layers], n: int, which: Int, state: State, tried: Float, factor: float
) -> Float:
    """(K,) of frame n with a limb at each of the values tried (K, C), all views together."""
    if len(tried) == 1:
        return np.zeros(1)
    posed, moved = state.posed(body), np.asarray(body.chain[:, which].any(axis=1), np.bool_)
    pairs = zip(layers, state.views, strict=True)
    limbs = [LimbCost.of(layer, n, posed, view.scaled(factor), moved) for layer, view in pairs]
    each = [_with(state, which, values).posed(body) for values in tried]
    return np.array([sum(limb(p) for limb in limbs) for p in each])


def cheapest_path(costs: Sequence[Float], places: Sequence[Float]) -> list[int]:
    """The choice in each frame that is cheapest in all: ``Σ cost + ½ |step|²`` (Viterbi's algorithm).

    Args:
        costs: of each candidate, (K_n,) in frame n.
        places: of each candidate, (K_n, C) in units of a step's standard deviation.
    """
    total, back = costs[0], list[AnyArray]()
    for n in range(1, len(costs)):
        step = np.sum((places[n][:, None] - places[n - 1][None]) ** 2, axis=2)
        reached = total[None] + 0.5 * step
        back.append(reached.argmin(axis=1))
        total = costs[n] + reached.min(axis=1)
    path = [int(total.argmin())]
    for before in reversed(back):
        path.append(int(before[path[-1]]))
    return path[::-1]
