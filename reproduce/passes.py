"""A whole sequence at once: passes over all frames that mend what the first lost, two-sided in time.

A dozen exposures in a cycle leave an arm that is hidden, or as bright as what it crosses, to chance: once lost it is
not found again from frame to frame. Here each limb chooses among many postures in every frame, all frames together, by
dynamic programming: how well the layers of the picture explain it (`layers`), and how far it moves between frames.
Then the tracker goes over the frames once more, about what was chosen. Photographic plates, a fixed sequence, are
followed so (Bregler and Malik, CVPR 1998, section 5.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from reproduce.layers import Layers, LimbCost, learnt
from twistcap.arrays import AnyArray, Float, Float32, Int
from twistcap.body import Body
from twistcap.cues.view import Picture
from twistcap.differential.model import DifferentialModel
from twistcap.differential.state import State
from twistcap.differential.step import track
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


@dataclass(frozen=True)
class SequenceConfig:
    """Settings of the passes over a whole sequence.

    Attributes:
        passes: over all frames after the first; the second and later ones try values nearer together.
        limbs: what is chosen together.
        share: of the pixels' information that counts, since neighbours see the same.
        stray_deg: how far the tracker's joints stray from what was chosen.
        apart: whether of a limb's two sides the one nearer to the cameras is chosen first, as if the other were not
            there: that one may stand in its place. Its steps must cost enough then, lest it take the other's.
    """

    passes: int = 2
    limbs: tuple[Limb, ...] = LIMBS
    share: float = 0.1
    stray_deg: float = 6.0
    apart: bool = False

    def __post_init__(self) -> None:
        if self.passes < 0 or not 0.0 < self.share <= 1.0 or self.stray_deg <= 0.0:
            raise InputError(
                "differential: passes must not be negative, share above 0 and at most 1, stray_deg positive."
            )


def track_sequence(
    model: DifferentialModel,
    start: State,
    frames: Sequence[Sequence[AnyArray | None]],
    sequence: SequenceConfig | None = None,
) -> list[State]:
    """The states of a body in all frames, the first of which is known; the cameras stand still.

    Args:
        model: body and settings of the tracker.
        start: state in the first frame.
        frames: one image per view each.
        sequence: of the passes after its first.

    Raises:
        InputError: where a frame lacks an image, and as `differential.step.followed` does.
    """
    sequence, config, rule = sequence or SequenceConfig(), model.config, model.rule
    whole = [_whole(n, frame) for n, frame in enumerate(frames)]
    start = start.sized(whole[0])
    states = [start, *(e.state for e in track(model, start, whole))]
    level = min(_LEVEL, rule.levels - 1)
    grey = [[Picture(image).level(level, colour=False)[0] for image in frame] for frame in whole]
    few = replace(rule, levels=min(2, rule.levels))
    near = replace(model, config=replace(config, stray_deg=sequence.stray_deg), rule=few)
    for n in range(sequence.passes):
        states = chosen(model.body, states, grey, 0.5**level, sequence, closer=1.0 / (n + 1))
        states = [start, *(e.state for e in track(near, start, whole, states))]
    return states


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
        sides = nearest_first(body, out, limb.of(body)) if config.apart else limb.of(body)
        for place, which in enumerate(sides):
            later = np.concatenate([np.zeros(0, np.int32), *(sides[place + 1 :] if config.apart else [])])
            tried = [_tried(body, s, which, closer * limb.offsets() if n else None) for n, s in enumerate(out)]
            pairs = zip(out, tried, strict=True)
            costs = [
                config.share * _costs(body, layers, n, which, later, *pair, factor) for n, pair in enumerate(pairs)
            ]
            path = cheapest_path(costs, [t / stray for t in tried])
            out = [_with(s, which, t[k]) for s, t, k in zip(out, tried, path, strict=True)]
    return out


def nearest_first(body: Body, states: Sequence[State], sides: Sequence[Int]) -> list[Int]:
    """The coordinates of the limbs of both sides, the limb first that is nearer to the cameras in the mean."""

    def depth(which: Int) -> float:
        moved = body.chain[:, which].any(axis=1)
        posed = [(s, s.posed(body).segment_middles[moved]) for s in states]
        return float(np.mean([view.depth(at).mean() for s, at in posed for view in s.views]))

    return sorted(sides, key=depth)


def _tried(body: Body, state: State, which: Int, offsets: Float | None) -> Float:
    """(K, C) values of a limb's coordinates; the present ones alone where there is nothing to choose."""
    here = state.q[which][None]
    return here if offsets is None else np.clip(here + offsets, *body.limits[which].T)


def _with(state: State, which: Int, values: Float) -> State:
    q = state.q.copy()
    q[which] = values
    return State(state.views, q)


def _costs(
    body: Body,
    layers: Sequence[Layers],
    n: int,
    which: Int,
    later: Int,
    state: State,
    tried: Float,
    factor: float,
) -> Float:
    """(K,) of frame n with a limb at each of the values tried (K, C), all views together.

    A limb that is still to be chosen, of coordinates `later`, is left out: it may stand where this one belongs.
    """
    if len(tried) == 1:
        return np.zeros(1)
    posed = state.posed(body)
    moved, absent = (np.asarray(body.chain[:, c].any(axis=1), np.bool_) for c in (which, later))
    pairs = zip(layers, state.views, strict=True)
    limbs = [LimbCost.of(layer, n, posed, view.scaled(factor), moved, absent) for layer, view in pairs]
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
