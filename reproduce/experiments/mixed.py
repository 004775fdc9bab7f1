"""D-6: what a library holds of other motion does no harm.

Each frame of a run is matched twice: in a library of running alone, and in one that holds cartwheels and flips as well.

    TWISTCAP_DATA=... python -m reproduce D-6 --seeds 0-7 --out out/D-6
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reproduce.arms import Findings
from reproduce.experiments.gaps import MIMIC, RATE, RUN
from reproduce.recorded import Recording
from reproduce.running import Tell
from twistcap.body import Body
from twistcap.evaluate.metrics import row
from twistcap.motion import FollowedMotion, FollowRule, Match, MotionClip, MotionLibrary, PaperMotion, RecurrenceRule
from twistcap.motion.openloop import OpenLoop, PoseSequence
from twistcap.studio import StudioConfig
from twistcap.studio.config import stream
from twistcap.studio.scene import default_body

TRACKED, RUNNING = Recording(RUN, first=280), Recording(RUN, last=260)
ACROBATICS = tuple(Recording(f"{MIMIC}_{name}.txt") for name in ("cartwheel", "backflip", "sideflip"))
SAMPLES = 500  # of acrobatics, mirrored ones after the others
ALIKE = 0.99  # fraction of frames whose match stays the same

_NOISE = (0.5, 1.0)  # deg, of joint angles as a tracker gives them, from the first of eight seeds to the last
_LASTS = 0.8  # correlation of this noise from frame to frame
_FIRST = 40  # frame that is matched first: the longest history that is looked at lies before it


@dataclass(frozen=True)
class Matched:
    """Where the frames of one seed's run are found.

    Attributes:
        mixed: the larger library; its first clip is the whole smaller one.
        places: by predictor, each frame's match in the smaller library and in the larger.
    """

    mixed: MotionLibrary
    places: dict[str, list[tuple[Match, Match]]]

    @staticmethod
    def of(seed: int) -> Matched:
        """Each seed is another person, whose joint angles carry another tracker's noise."""
        body = default_body(StudioConfig(seed=seed))
        run, acrobatics = RUNNING.clip(body, RATE), [clip.clip(body, RATE) for clip in ACROBATICS]
        alone = MotionLibrary.of([run], RATE)
        mixed = MotionLibrary.of([run, *_first(acrobatics + [clip.mirrored() for clip in acrobatics], SAMPLES)], RATE)
        tracked = noisy(TRACKED.clip(body, RATE), seed)
        kinds = {"paper's, m = 5": PaperMotion, "followed": _by_the_library}
        return Matched(
            mixed,
            {
                name: list(zip(*(_matches(kind(library, body), tracked) for library in (alone, mixed)), strict=True))
                for name, kind in kinds.items()
            },
        )


@dataclass(frozen=True)
class SameMatches:
    """The experiment; see `Experiment`."""

    id: str = "D-6"
    says: str = "running matched in 260 samples of running, and with 500 of cartwheels and flips beside them"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Shares of frames with the same match; the picture shows where those of the first seed lie."""
        fractions: dict[str, list[float]] = {}
        for done, seed in enumerate(seeds, 1):
            found = Matched.of(seed)
            for name, pairs in found.places.items():
                fractions.setdefault(name, []).append(float(np.mean([same(a, b) for a, b in pairs])))
            if done == 1 and out is not None:
                _picture(out / f"{self.id}-matches.png", found, seed)
            progress(f"{self.id}, seed {seed}", done, len(seeds))
        rows = [row(self.id, k, float(np.mean(v)), "share", at_least=ALIKE, seeds=v) for k, v in fractions.items()]
        return Findings(rows, "share of frames with the same match", ())


def same(a: Match, b: Match) -> bool:
    """Whether two matches are one sample at one speed: to half a sample, and half a step of the paper's scales.

    The paper's matches are samples. A followed one lies between them.
    """
    return a.clip == b.clip and abs(a.position - b.position) < 0.5 and abs(a.scale - b.scale) < 0.05


def noisy(clip: MotionClip, seed: int) -> MotionClip:
    """Joint angles with a tracker's noise, which lasts for some frames."""
    sigma = np.radians(np.interp(seed % 8, (0, 7), _NOISE))
    fresh = stream(seed, "noise of angles").normal(0.0, sigma, clip.q.shape)
    noise = [fresh[0]]
    for step in fresh[1:]:
        noise.append(_LASTS * noise[-1] + np.sqrt(1.0 - _LASTS**2) * step)
    return replace(clip, q=clip.q + np.array(noise))


def _by_the_library(library: MotionLibrary, body: Body) -> FollowedMotion:
    """Never by the person's own past."""
    return FollowedMotion(library, body, FollowRule(recurrence=RecurrenceRule(lead=0.0)))


def _matches(predictor: OpenLoop, tracked: MotionClip) -> list[Match]:
    """Of each frame from `_FIRST` on, all poses before it being known."""
    return list(_matched(predictor, tracked))


def _matched(predictor: OpenLoop, tracked: MotionClip) -> Iterator[Match]:
    last: Match | None = None
    for end in range(_FIRST, len(tracked)):
        past = PoseSequence(tracked.q[:end], tracked.roots[:end], last)
        last = predictor.next_poses(past.since(max(0, end - predictor.history)), 1).match
        assert last is not None  # each clip is longer than what is matched
        yield last


def _first(clips: Sequence[MotionClip], count: int) -> list[MotionClip]:
    """The first so many poses of clips, the last of which is cut."""
    out: list[MotionClip] = []
    for clip in clips:
        left = count - sum(map(len, out))
        if left > 1:
            out.append(replace(clip, roots=clip.roots[:left], q=clip.q[:left]))
    return out


def _picture(path: Path, found: Matched, seed: int) -> None:
    """Which sample each frame matches, in both libraries."""
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    starts = found.mixed.starts
    for axis, (name, pairs) in zip(figure.subplots(len(found.places), sharex=True), found.places.items(), strict=True):
        frames = _FIRST + np.arange(len(pairs))
        alone, mixed = (np.array([starts[m.clip] + m.position for m in way]) for way in zip(*pairs, strict=True))
        fraction = float(np.mean([same(a, b) for a, b in pairs]))
        axis.plot(frames, alone, "o", ms=5, mfc="none", color="#1780d6", label="running alone")
        axis.plot(frames, mixed, ".", ms=4, color="#e8790c", label="with cartwheels and flips")
        for clip, label in enumerate(found.mixed.clip_names):
            axis.axhline(starts[clip], color="#9aa3ad", lw=0.8)
            axis.text(frames[-1], 0.5 * (starts[clip] + starts[clip + 1]), label, ha="right", va="center", fontsize=8)
        axis.set_title(f"{name}: the same in {100 * fraction:.1f} % of the frames, seed {seed}", loc="left", fontsize=9)
        axis.set(xlabel="frame of the tracked run", ylabel="sample of the library", ylim=(0, len(found.mixed)))
        axis.legend(loc="center left", fontsize=8)
    figure.savefig(path, dpi=110)


D6 = SameMatches()
