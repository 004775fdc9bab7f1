"""Settings of the fit."""

from __future__ import annotations

from dataclasses import dataclass

from twistcap.errors import check_numbers


@dataclass(frozen=True)
class FitRule:
    """How much work a fit takes.

    Attributes:
        rounds: how often the recording is tracked with the body so far.
        steps: Gauss-Newton steps in each round.
        frames: greatest number of frames of each recording to which the shape is fitted, evenly spread.

    Raises:
        InputError: for a number below 1.
    """

    rounds: int = 3
    steps: int = 4
    frames: int = 20

    def __post_init__(self) -> None:
        check_numbers("body fit", self, ("rounds", "steps", "frames"))
