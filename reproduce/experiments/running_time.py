"""C-6: what a stereo frame of 384×280 takes now; the paper took 50 s on a 2 GHz laptop of 2007.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", section 11.6. Run it on an idle machine.

    python -m reproduce C-6 --seeds 0-2
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.bench import TOTAL, Bench, timed
from reproduce.running import Tell, one_thread_processes
from twistcap.evaluate.metrics import Row, row
from twistcap.studio import StudioConfig
from twistcap.track import Settings

PAPER_MS = 50_000.0  # Brox, Rosenhahn and Cremers, section 11.6
MOST_TIMES = 2.5  # that direct with 5 channels may take of direct with 1

_SCENE = StudioConfig(views=2, frames=24)
_BENCHES = (
    Bench("direct, 1 channel", "", _SCENE, Settings(channels="grey")),
    Bench("direct, 5 channels", "", _SCENE, Settings(channels="grey+texture")),
    Bench("level set, 1 channel", "", _SCENE, Settings(method="levelset", channels="grey")),
    Bench("level set, 5 channels", "", _SCENE, Settings(method="levelset", channels="grey+texture")),
)


@dataclass(frozen=True)
class RunningTime:
    """Median ms per frame, one thread, decoding apart; both methods, with grey and with grey and texture.

    Over seeds medians as well: a clock that changes its gear within a run spoils a mean.
    """

    id: str = "C-6"
    says: str = "the paper's 50 s per stereo frame beside ours: both methods, 1 and 5 channels"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """The table; one process at a time: clocks do not share."""
        medians: dict[str, list[float]] = {bench.id: [] for bench in _BENCHES}
        with one_thread_processes(1) as pool:
            jobs = [(bench, seed) for seed in seeds for bench in _BENCHES]
            for done, (bench, seed) in enumerate(jobs, 1):
                medians[bench.id].append(float(np.median(pool.submit(timed, bench, seed).result()[TOTAL])))
                progress(f"{bench.id}, seed {seed}", done, len(jobs))
        return Findings(self._rows(medians), "ms per frame", ())

    def _rows(self, medians: dict[str, list[float]]) -> list[Row]:
        rows = [row(self.id, "the paper, 2007", PAPER_MS, "ms")]
        rows += [row(self.id, name, float(np.median(ms)), "ms", seeds=ms) for name, ms in medians.items()]
        one, five = np.array(medians["direct, 1 channel"]), np.array(medians["direct, 5 channels"])
        ratios = (five / one).tolist()
        rows.append(
            row(self.id, "direct, 5 channels to 1", float(np.median(ratios)), "times", at_most=MOST_TIMES, seeds=ratios)
        )
        return rows


C6 = RunningTime()
