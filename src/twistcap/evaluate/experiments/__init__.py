"""The papers' experiments, run again: both arms of each comparison, over seeds. `twistcap reproduce C-3` and so on."""

from twistcap.evaluate.experiments.acquired import KEYVIEWS
from twistcap.evaluate.experiments.acrobatics import D7
from twistcap.evaluate.experiments.arms import Arm, Comparison, Experiment, Findings, Shot, Trace
from twistcap.evaluate.experiments.body_fit import B1
from twistcap.evaluate.experiments.body_models import B2
from twistcap.evaluate.experiments.clicks import CLICKS
from twistcap.evaluate.experiments.clutter import C5
from twistcap.evaluate.experiments.contours import C1, C2
from twistcap.evaluate.experiments.differential import T1, T2, T3, T_EM
from twistcap.evaluate.experiments.fast_motion import C3
from twistcap.evaluate.experiments.gaps import D1, D1_OTHER, D1_SPEED, D2, D3, D3_OTHERS, D4, D5
from twistcap.evaluate.experiments.hidden_leg import C4
from twistcap.evaluate.experiments.loose_cloth import T_CLOTH
from twistcap.evaluate.experiments.mixed import D6
from twistcap.evaluate.experiments.refinement import REFINE, REFINE_WALK
from twistcap.evaluate.experiments.running_time import C6

EXPERIMENTS: tuple[Experiment, ...] = (
    B1, B2, C1, C2, C3, C4, C5, C6, D1, D1_SPEED, D1_OTHER, D2, D3, D3_OTHERS, D4, D5, D6, D7, T1, T2, T3, T_EM,
    T_CLOTH, REFINE, REFINE_WALK, CLICKS, KEYVIEWS,
)  # fmt: skip

__all__ = ["EXPERIMENTS", "Arm", "Comparison", "Experiment", "Findings", "Shot", "Trace"]
