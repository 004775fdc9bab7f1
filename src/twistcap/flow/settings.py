"""Settings of the flow, its presets, and the published forms of the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from twistcap.ranges import Checked, Count, Positive, Share

Preset = Literal["accurate", "fast"]


@dataclass(frozen=True)
class SearchSettings(Checked):
    """The search for displacements that coarse-to-fine warping loses: `matching`, `expansion`.

    Attributes:
        radius: px that a point may move.
        step: px from node to node.
        half, spacing: a block has 2 half + 1 samples each way, `spacing` px apart.
        turn_deg: greatest turn of a block from its neighbour, or from one candidate to the next.
        ceiling: greatest difference of a sample, intensity.
        apart: cost of each px by which two neighbours disagree, in a block's mean difference.
        most_apart: px beyond which that cost no longer grows.
        rounds, polish: passes through all nodes before and after motions are proposed to whole limbs.
        draws: random candidates of a node in a pass, each half as far as the one before.
        loops: how often candidates are gathered and proposed.
        every: one node in `every` proposes its motion to those around it.
    """

    radius: Positive = 40.0
    step: int = 4
    half: int = 3
    spacing: int = 2
    turn_deg: float = 30.0
    ceiling: float = 0.25
    apart: float = 0.01
    most_apart: float = 10.0
    rounds: Count = 3
    polish: int = 2
    draws: Count = 8
    loops: Count = 4
    every: Count = 2


@dataclass(frozen=True)
class FlowSettings(Checked):
    """The model and its numerical scheme; the smoothness is flow-driven and isotropic (Brox et al. 2004).

    Attributes:
        alpha: weight of the smoothness. It goes with the data term's unit: px with `zeta`, intensity in [0, 1] without.
        gamma: weight of gradient against brightness constancy; 0 leaves the gradient out.
        zeta: noise floor (intensity per px) of the normalised constraints (Zimmer et al. 2011); 0 does not normalise.
        blend: fraction of the first image's derivatives in the constraints; 0 takes the warped image's alone (2004).
        factor: from one level's size to the next coarser one's.
        least_size: px of the coarsest level's shorter side, at least.
        finest: scale of the finest level; below 1 its flow is interpolated.
        warps, inner, sweeps: outer fixed points per level, lagged weights per warp, SOR sweeps for each.
        omega: over-relaxation of SOR, in (0, 2).
        median: 3 or 5: window (px) of the median filter after each warp (Sun, Roth and Black 2010,
            DOI 10.1109/CVPR.2010.5539939); 0 for none.
        search: of large displacements within the mask; None for none. Without a mask there is none.
    """

    alpha: Positive = 1.7
    gamma: float = 2.0
    zeta: float = 0.005
    blend: Share = 0.5
    factor: Positive = 0.8
    least_size: Count = 16
    finest: Positive = 1.0
    warps: Count = 5
    inner: Count = 3
    sweeps: Count = 8
    omega: float = 1.9
    median: int = 5
    search: SearchSettings | None = SearchSettings()


ACCURATE = FlowSettings()
FAST_PRESET = replace(
    ACCURATE, factor=0.5, least_size=12, finest=0.5, warps=2, inner=2, sweeps=6,
    search=SearchSettings(
        half=2, turn_deg=20.0, apart=0.003, most_apart=16.0, rounds=2, polish=0, draws=6, loops=2, every=3
    ),
)  # fmt: skip
PRESETS: dict[str, FlowSettings] = {"accurate": ACCURATE, "fast": FAST_PRESET}
# Brox, Bruhn, Papenberg and Weickert 2004, with a separate robust function for each constancy (eq. 11.24 of the
# chapter). The weights were set on the four Middlebury pairs of the benchmark.
BROX_2004 = replace(ACCURATE, alpha=0.08, gamma=5.0, zeta=0.0, blend=0.0, median=0, search=None)
