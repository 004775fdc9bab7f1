"""The table of the bench: how honest the flag is, and how soon the body is found again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from reproduce.faults.runs import PARTS, Run
from twistcap.arrays import Bool, Float, runs
from twistcap.cues.support import SupportRule
from twistcap.evaluate.metrics import LOST_FRAME_MM, Row, row

FOUND_MM = 20.0  # a body is found again when all joints are as near
SOON = 10  # frames within which it should be
BINS = 10


@dataclass(frozen=True)
class Summary:
    """Some runs together. Frames in which the person is in no image count only where that is said.

    Attributes:
        runs, frames: how many.
        lost: frames truly lost, with the person in an image.
        judged: those of them in which a part is lost that some image shows, as far as the tracker says.
        flagged: frames flagged, with the person in an image.
        right, judged_right: of both.
        unflagged: frames lost and not flagged, those without the person included.
        silent_frames: those of them in which a part is lost that some image shows, as far as the tracker says.
        absent, absent_flagged: frames without the person, and those of them that are flagged.
        delays: frames from the beginning of each lost stretch to the first flag; infinite where none comes in it.
        recoveries: frames from the end of each fault until all joints are within 20 mm; infinite where that never is.
        mean_recoveries: the same until they are so on average.
    """

    runs: int
    frames: int
    lost: int
    judged: int
    flagged: int
    right: int
    judged_right: int
    unflagged: int
    silent_frames: int
    absent: int
    absent_flagged: int
    delays: Float
    recoveries: Float
    mean_recoveries: Float

    @property
    def precision(self) -> float:
        """Fraction of the flagged frames that are lost; NaN where none is flagged."""
        return self.right / self.flagged if self.flagged else np.nan

    @property
    def recall(self) -> float:
        """Fraction of the lost frames that are flagged, of those that can be judged; NaN where none is lost."""
        return self.judged_right / self.judged if self.judged else np.nan

    @property
    def silent(self) -> float:
        """Fraction of all frames that are lost and not flagged, but for parts that are said to be in no image."""
        return self.silent_frames / self.frames

    @property
    def found_soon(self) -> float:
        """Fraction of the faults that end after which the body is found within ten frames; NaN where none ends."""
        return soon(self.recoveries)


def summary(runs: Sequence[Run]) -> Summary:
    """Some runs together."""
    lost, judged, flagged, absent = (np.concatenate(list(a)) for a in zip(*map(_flags, runs), strict=True))
    here = ~absent
    return Summary(
        len(runs), len(lost), _count(lost & here), _count(judged & here), _count(flagged & here),
        _count(lost & flagged & here), _count(judged & flagged & here), _count(lost & ~flagged),
        _count(judged & ~flagged), _count(absent), _count(absent & flagged),
        np.array([d for r in runs for d in delays(r.truly_judged_lost & ~r.absent, r.flagged)], float),
        *(np.array([recovery(r, mean) for r in runs if r.span[1] is not None], float) for mean in (False, True)),
    )  # fmt: skip


def _flags(run: Run) -> tuple[Bool, Bool, Bool, Bool]:
    return run.truly_lost, run.truly_judged_lost, run.flagged, run.absent


def _count(which: Bool) -> int:
    return int(np.count_nonzero(which))


def delays(lost: Bool, flagged: Bool) -> list[float]:
    """Frames from the beginning of each stretch of lost frames (N,) to its first flagged one; infinite without."""
    out: list[float] = []
    for first, end in runs(lost):
        said = np.flatnonzero(flagged[first:end])
        out.append(float(said[0]) if len(said) else np.inf)
    return out


def recovery(run: Run, mean: bool = False) -> float:
    """Frames from the end of the fault until all joints are within 20 mm, or are so on average.

    They count from when every part is in two pictures: who comes back walks in.
    """
    assert run.span[1] is not None
    error = (run.mean_mm if mean else run.error_mm)[run.span[1] + 1 :]
    in_view = np.flatnonzero(run.in_images[run.span[1] + 1 :].min(axis=1) >= 2)
    found = np.flatnonzero(error <= FOUND_MM)
    if not len(found):
        return np.inf if len(in_view) else 0.0
    return max(0.0, float(found[0] - in_view[0])) if len(in_view) else 0.0


def tables(runs: Sequence[Run]) -> str:
    """The tables by kind and by part, for people."""
    return f"{table(runs)}\n\n{parts_table(runs)}"


def table(runs: Sequence[Run]) -> str:
    """By kind and over all."""
    head = ("kind", "runs", "frames", "lost", "flagged", "prec.", "recall", "silent", "delay", "p95", "absent", "said",
            "found≤10", "mean≤10")  # fmt: skip
    named = [(kind, [r for r in runs if r.kind == kind]) for kind in dict.fromkeys(r.kind for r in runs)]
    lines = [head, *(_cells(kind, summary(some)) for kind, some in [*named, ("all", list(runs))])]
    return _aligned(lines)


def parts_table(runs: Sequence[Run]) -> str:
    """Lost frames of each part, how many of them the body's flag tells, and its own support as a flag, for people."""
    here = ~np.concatenate([r.absent for r in runs])
    flag, errors = np.concatenate([r.flagged for r in runs])[here], np.concatenate([r.parts_mm for r in runs])[here]
    low = np.concatenate([r.parts_support for r in runs])[here] < SupportRule().least
    lines: list[tuple[str, ...]] = [("part", "lost", "recall", "own prec.", "own recall")]
    for k, part in enumerate(PARTS):
        lost, own = errors[:, k] > LOST_FRAME_MM, low[:, k]
        shares = _fraction(lost & flag, lost), _fraction(lost & own, own), _fraction(lost & own, lost)
        lines.append((part, str(_count(lost)), *map(_decimal, shares)))
    return _aligned(lines)


def _fraction(some: Bool, of: Bool) -> float:
    return _count(some) / _count(of) if _count(of) else np.nan


def _aligned(lines: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(_padded(cell, w, k) for k, (cell, w) in enumerate(zip(line, widths, strict=True))) for line in lines
    )


def _padded(cell: str, width: int, column: int) -> str:
    return cell.rjust(width) if column else cell.ljust(width)


def _cells(name: str, s: Summary) -> tuple[str, ...]:
    return (
        name, *map(str, (s.runs, s.frames, s.lost, s.flagged)), _decimal(s.precision), _decimal(s.recall),
        f"{100 * s.silent:.1f}%", _frames(s.delays, 50), _frames(s.delays, 95), str(s.absent), str(s.absent_flagged),
        _decimal(s.found_soon), _decimal(soon(s.mean_recoveries)),
    )  # fmt: skip


def _decimal(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.2f}"


def _frames(values: Float, percent: float) -> str:
    value = percentile(values, percent)
    return "–" if np.isnan(value) else "never" if np.isinf(value) else f"{value:.0f}"


def percentile(values: Float, percent: float) -> float:
    """The least value that so many per cent of the values do not exceed; they may be infinite. NaN for none."""
    ordered = np.sort(values)
    return float(ordered[max(0, int(np.ceil(percent / 100 * len(ordered))) - 1)]) if len(ordered) else np.nan


def rows(runs: Sequence[Run]) -> list[Row]:
    """What is asked of all runs together, then each kind's."""
    s, out = summary(runs), list[Row]()
    out.append(row("faults", "lost and not flagged", s.silent, "of all frames", at_most=0.005))
    out.append(row("faults", "the same, with limbs that are said to be in no image", s.unflagged / s.frames, "of all"))
    out.append(row("faults", "precision", s.precision, "share", at_least=0.95))
    out.append(row("faults", "recall", s.recall, "share", at_least=0.97))
    out.append(row("faults", "delay of the flag, median", percentile(s.delays, 50), "frames", at_most=1.0))
    out.append(row("faults", "delay of the flag, p95", percentile(s.delays, 95), "frames", at_most=5.0))
    out.append(row("faults", "exceptions", sum(r.exception is not None for r in runs), "runs", at_most=0))
    for name, least, some in _by_views(runs):
        for mean, what in ((False, "all joints"), (True, "joints on average")):
            found = soon(np.array([recovery(r, mean) for r in some if r.span[1] is not None]))
            out.append(row("faults", f"{what} found within {SOON} frames, {name}", found, "share", at_least=least))
    for kind in dict.fromkeys(r.kind for r in runs):
        out += _kind_rows(kind, summary([r for r in runs if r.kind == kind]))
    return out


def _kind_rows(kind: str, s: Summary) -> Iterable[Row]:
    values = {
        "lost and not flagged": (s.silent, "of all frames"), "precision": (s.precision, "share"),
        "recall": (s.recall, "share"), f"found again within {SOON} frames": (s.found_soon, "share"),
    }  # fmt: skip
    return [row(f"faults {kind}", what, *value) for what, value in values.items() if not np.isnan(value[0])]


def _by_views(runs: Sequence[Run]) -> list[tuple[str, float, list[Run]]]:
    """Those with faults that end, by what is asked of them."""
    stereo = [r for r in runs if r.views == 2]
    return [("3 and 4 views", 0.95, [r for r in runs if r.views > 2]), ("2 views", 0.85, stereo)]


def soon(recoveries: Float) -> float:
    """Fraction of at most ten frames; NaN for none."""
    return float(np.mean(recoveries <= SOON)) if len(recoveries) else np.nan


def reliability(runs: Sequence[Run]) -> tuple[Float, Float, Float]:
    """For each of ten bins of the probability of being lost: its mean, how often it was so, and how many frames."""
    said = np.concatenate([r.probability for r in runs])
    known = np.isfinite(said) & ~np.concatenate([r.absent for r in runs])
    said, lost = said[known], np.concatenate([r.truly_lost for r in runs])[known]
    which = np.minimum((said * BINS).astype(int), BINS - 1)
    count = np.bincount(which, minlength=BINS).astype(float)
    with np.errstate(invalid="ignore"):
        return np.bincount(which, said, BINS) / count, np.bincount(which, lost, BINS) / count, count
