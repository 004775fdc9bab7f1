"""The world of a calibration: by a board on the floor or, said to be a guess, by what is up in the images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.calibrate.adjust import Guess
from twistcap.calibrate.board import Board


def lying(board: Board) -> Float:
    """(4, 4) board to world of a board that lies on the floor, face up: the origin is its lower left corner, x goes to
    its right, y to its upper edge, z up.
    """
    return se3.transform(np.diag([1.0, -1.0, -1.0]), [0.0, board.size[1], 0.0])


def moved(guess: Guess, world: Float) -> Guess:
    """The same cameras and boards in another world: `world` (4, 4) leads from the old one to it."""
    back = se3.inverse(world)
    places = tuple(place @ back for place in guess.places)
    return replace(guess, places=places, boards={m: world @ T for m, T in guess.boards.items()})


def upright(guess: Guess) -> Float:
    """(4, 4) to a world whose z is the mean of what is up in the images, and whose origin is amid the boards.

    Cameras that stand about the place and look down by the same angle have their tilts cancel.
    """
    up = -np.sum([place[1, :3] for place in guess.places], axis=0)
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    first = guess.places[0][2, :3]
    x = first - (first @ up) * up
    x = x / max(float(np.linalg.norm(x)), 1e-9)
    R = np.stack([x, np.cross(up, x), up])
    middle = np.mean([T[:3, 3] for T in guess.boards.values()], axis=0) if guess.boards else np.zeros(3)
    return se3.transform(R, -R @ middle)


def centre_covariance(place: Float, covariance: Float) -> Float:
    """(3, 3) covariance of the optical centre, world, m², of a camera at `place` whose left twist has `covariance`."""
    R = place[:3, :3]
    return R.T @ covariance[3:, 3:] @ R
