"""The angles of a result that a reference has too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float
from twistcap.io.coordinates import coordinates_of
from twistcap.io.isb import ISB
from twistcap.io.result import Result


@dataclass(frozen=True)
class Angles:
    """K coordinates over N frames: `values` (N, K) and `covariances` (N, K, K), rad; m where they slide."""

    names: tuple[str, ...]
    values: Float
    covariances: Float

    @property
    def isb(self) -> bool:
        """Whether they are the ISB's, and not the body's own."""
        return bool(self.names) and self.names[0].startswith(ISB)


def shared_angles(result: Result, names: Sequence[str]) -> Angles:
    """Those of some names that the body has as coordinates; where it has none, those that are the ISB's of its joints,
    whose covariances are diagonal."""
    own = tuple(name for name in result.body.coordinate_names if name in names)
    if own or not any(name.startswith(ISB) for name in names):
        columns = np.array([result.body.coordinate(name) for name in own], int)
        step = 6 + columns
        return Angles(own, result.q[:, columns], np.asarray(result.covariances, float)[:, step][:, :, step])
    known = ~np.asarray(result.lost, bool)
    table = coordinates_of(result.body, result.poses, result.covariances, "isb", known=known)
    columns = np.array([k for k, name in enumerate(table.names) if name.startswith(ISB) and name in names], int)
    covariances = np.eye(len(columns)) * table.sigmas[:, columns, None] ** 2
    return Angles(tuple(table.names[k] for k in columns), table.values[:, columns], covariances)
