"""Evidence in images, made into terms. One file for each cue; this is what a cue is."""

from __future__ import annotations

from typing import Any, Protocol

from twistcap.body import Body
from twistcap.camera import Rig
from twistcap.cues.observation import Agreement, Alternation, Evidence, Fit, Level, Measured, Sight, Visibility

__all__ = ["Agreement", "Alternation", "Cue", "Evidence", "Fit", "Level", "Measured", "Sight", "Visibility"]


class Cue(Protocol):
    """Evidence of one kind: what it remembers, what it measures in a view, and what it learns from a settled frame.

    A memory is a frozen value (a dataclass, a mapping, a tuple, an array or a number, nested as you like). It belongs
    to the tracker's state: it is saved in the result file and restored from it. A cue holds settings only.
    """

    @property
    def name(self) -> str:
        """Its name in the state, in the result file and in reports."""
        ...

    def start(self, body: Body, rig: Rig) -> Any:
        """The memory before the first frame."""
        ...

    def measure(self, sight: Sight, memory: Any, level: Level) -> Evidence | None:
        """Evidence of one view; None where there is none. Called from one thread for each camera."""
        ...

    def learn(self, memory: Any, fit: Fit, lesson: int) -> Any:
        """The memory after a settled frame.

        Args:
            memory: before it.
            fit: the frame; `fit.of(name)` gives each view and this cue's evidence there.
            lesson: how many frames this one stands for; 0 where only what must follow every frame is renewed.
        """
        ...
