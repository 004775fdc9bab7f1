"""The one minimiser, its systems, and the blocks of variables that it moves."""

from twistcap.solve.arrow import Arrow, Marginals
from twistcap.solve.blocks import CameraBlock, PoseTrack, Variables, Vector
from twistcap.solve.dense import Dense, covariance, inverse
from twistcap.solve.minimise import Problem, Solution, Status, System, minimise
from twistcap.solve.problem import BlockProblem, PoseProblem

__all__ = [
    "Arrow", "BlockProblem", "CameraBlock", "Dense", "Marginals", "PoseProblem", "PoseTrack", "Problem", "Solution",
    "Status", "System", "Variables", "Vector", "covariance", "inverse", "minimise",
]  # fmt: skip
