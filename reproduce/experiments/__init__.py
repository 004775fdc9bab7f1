"""The papers' experiments, run again: every arm of each comparison, over seeds; ``python -m reproduce C-3``."""

from reproduce.arms import Arm, Comparison, Experiment, Findings, Shot, Trace
from reproduce.experiments.acrobatics import D7
from reproduce.experiments.another_renderer import RENDERER, RENDERER_PAIRS, RENDERER_STARTS
from reproduce.experiments.body_fit import B1
from reproduce.experiments.body_models import B2
from reproduce.experiments.brightness_walks import T1, T2, T3, T_EM
from reproduce.experiments.clicks import CLICKS
from reproduce.experiments.clutter import C5
from reproduce.experiments.coupled_contour import C1
from reproduce.experiments.fast_motion import C3
from reproduce.experiments.faults import FAULTS
from reproduce.experiments.gaps import D1, D1_OTHER, D1_SPEED, D2, D3, D3_OTHERS, D4, D5
from reproduce.experiments.hidden_forearms import HIDDEN_FOREARMS
from reproduce.experiments.hidden_leg import C4
from reproduce.experiments.key_views import KEYVIEWS
from reproduce.experiments.local_densities import C2
from reproduce.experiments.mixed import D6
from reproduce.experiments.motion_prediction import MOTION_PREDICTION
from reproduce.experiments.optic_flow import FLOW
from reproduce.experiments.real_faults import REAL_FAULTS
from reproduce.experiments.real_gap import REAL_GAP
from reproduce.experiments.real_recording import CHAPTER, RECORDING
from reproduce.experiments.refinement import REFINE, REFINE_WALK
from reproduce.experiments.running_time import C6
from reproduce.experiments.sagittal_walk import SAGITTAL
from reproduce.experiments.texture import TEXTURE
from reproduce.experiments.unaided import UNAIDED

EXPERIMENTS: tuple[Experiment, ...] = (
    B1, B2, C1, C2, C3, C4, C5, C6, D1, D1_SPEED, D1_OTHER, D2, D3, D3_OTHERS, D4, D5, D6, D7, T1, T2, T3, T_EM,
    REFINE, REFINE_WALK, CLICKS, KEYVIEWS, FLOW, HIDDEN_FOREARMS, TEXTURE, MOTION_PREDICTION,
    RECORDING, CHAPTER, REAL_GAP, REAL_FAULTS, SAGITTAL, UNAIDED, RENDERER, RENDERER_PAIRS,
    RENDERER_STARTS, FAULTS,
)  # fmt: skip

__all__ = ["EXPERIMENTS", "FAULTS", "Arm", "Comparison", "Experiment", "Findings", "Shot", "Trace"]
