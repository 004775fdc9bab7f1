"""Normal equations of a whole sequence: banded in the poses, with a dense border of shared parameters.

The unknowns are F pose steps of D numbers and K parameters of all frames. Rows couple a frame with its next few only,
so the matrix is an arrow: ``[[A, B], [Bᵀ, C]]`` with A banded. A is factored by LAPACK's banded Cholesky; the border is
eliminated by its Schur complement (Triggs et al., "Bundle Adjustment", 1999, section 6, DOI 10.1007/3-540-44480-7_21).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cho_solve_banded, cholesky_banded, solve_triangular

from twistcap.arrays import Float
from twistcap.errors import InputError


@dataclass(frozen=True)
class Marginals:
    """Marginal covariances of all unknowns: (F, D, D) of each pose, (K, K) of the shared parameters."""

    poses: Float
    shared: Float


class Arrow:
    """Sum of quadratics of F poses and K shared parameters; rows couple poses at most `reach` frames apart.

    Attributes:
        band: (F, reach + 1, D, D), block (t, j) is that of frames t + j (rows) and t (columns).
        border, corner: (F, D, K) and (K, K).
        pull, shared_pull: (F, D) and (K,) gradients.
        value: energy at the linearisation point.
        longest, shared_longest: largest entry (rad, m) of a step, a number or (D,) of a pose's, or (K,).
    """

    def __init__(self, frames: int, dof: int, shared: int, reach: int) -> None:
        self.reach = reach
        self.band = np.zeros((frames, reach + 1, dof, dof))
        self.border, self.corner = np.zeros((frames, dof, shared)), np.zeros((shared, shared))
        self.pull, self.shared_pull = np.zeros((frames, dof)), np.zeros(shared)
        self.value = 0.0
        self.longest: Float | float = 1.0
        self.shared_longest: Float | float = 1.0

    def add_rows(
        self, frames: tuple[int, ...], J: tuple[Float, ...], S: Float | None, weight: Float, residual: Float
    ) -> None:
        """Add ½ Σ weight (residual + Σ_i J_i δ_i + S s)²; frames in ascending order, J_i (N, D), S (N, K) or None."""
        Wr, met = weight * residual, list(zip(frames, J, strict=True))
        for i, (t, first) in enumerate(met):
            weighted = weight[:, None] * first
            self.pull[t] += first.T @ Wr
            for u, second in met[i:]:
                self.band[t, u - t] += second.T @ weighted
            if S is not None:
                self.border[t] += weighted.T @ S
        if S is not None:
            self.corner += S.T @ (weight[:, None] * S)
            self.shared_pull += S.T @ Wr

    def add_pose(self, frame: int, gradient: Float, hessian: Float) -> None:
        """Add a quadratic of one pose."""
        self.pull[frame] += gradient
        self.band[frame, 0] += hessian

    def finite(self) -> bool:
        """Whether every number is finite."""
        sums = [float(x.sum()) for x in (self.band, self.border, self.corner, self.pull, self.shared_pull)]
        return math.isfinite(self.value + sum(sums))

    def step(self, damping: float = 0.0) -> Float | None:
        """(F D + K,) minimiser with the diagonal raised by the fraction `damping`, poses first; None if there is none.

        The step of each pose is shortened to `longest`, that of the shared parameters to `shared_longest`.
        """
        factor = self._factored(damping)
        if factor is None:
            return None
        F, D, _ = self.border.shape
        band, across, complement = factor
        free = np.asarray(cho_solve_banded((band, True), -self.pull.ravel()))
        shared = cho_solve(complement, -self.shared_pull - self._border.T @ free)
        poses = (free - across @ shared).reshape(F, D)
        poses /= np.maximum(1.0, np.abs(poses / self.longest).max(axis=1, initial=0.0, keepdims=True))
        shared /= max(1.0, float(np.abs(shared / self.shared_longest).max(initial=0.0)))
        return np.concatenate([poses.ravel(), shared])

    def marginals(self) -> Marginals:
        """Exact marginal covariances (of unit weight). Raises InputError where the equations do not determine them."""
        factor = self._factored(0.0)
        if factor is None:
            raise InputError("adjust: the data do not determine a pose or a length; give more frames or views.")
        (F, D, K), (band, across, complement) = self.border.shape, factor
        shared, lean = cho_solve(complement, np.eye(K)), across.reshape(F, D, K)
        return Marginals(diagonal_blocks(band, F, D) + lean @ shared @ lean.transpose(0, 2, 1), shared)

    @property
    def _border(self) -> Float:
        """(F D, K)."""
        return self.border.reshape(self.pull.size, len(self.corner))

    def _factored(self, damping: float) -> tuple[Float, Float, tuple[Float, bool]] | None:
        """Cholesky factor of the band, ``A⁻¹ B`` (F D, K), and factor of the Schur complement ``C − Bᵀ A⁻¹ B``."""
        _, D, K = self.border.shape
        diagonal = np.arange(D)
        band, corner = self.band.copy(), self.corner.copy()
        band[:, 0, diagonal, diagonal] *= 1.0 + damping
        corner[np.arange(K), np.arange(K)] *= 1.0 + damping
        try:
            factor = cholesky_banded(_lower_form(band), lower=True, overwrite_ab=True)
            across = np.asarray(cho_solve_banded((factor, True), self._border))
            return factor, across, cho_factor(corner - self._border.T @ across)
        except (LinAlgError, ValueError):
            return None


def _lower_form(band: Float) -> Float:
    """Blocks (F, p + 1, D, D) as LAPACK's lower band storage ((p + 1) D, F D): ``ab[i - j, j] = A[i, j]``."""
    F, p, D, _ = band.shape
    out = np.zeros((p * D, F * D))
    r, c = np.indices((D, D))
    for j in range(p):
        below = j * D + r - c >= 0
        rows, columns = (j * D + r - c)[below], c[below]
        for t in range(F - j):
            out[rows, t * D + columns] = band[t, j][below]
    return out


def _block(factor: Float, t: int, j: int, D: int) -> Float:
    """(D, D) block of frames t + j and t of a factor in lower band storage."""
    r, c = np.indices((D, D))
    offset = j * D + r - c
    return np.where(offset >= 0, factor[np.maximum(offset, 0), t * D + c], 0.0)


def diagonal_blocks(factor: Float, frames: int, D: int) -> Float:
    """(F, D, D) diagonal blocks of the inverse of a banded matrix, from its Cholesky factor L in lower band storage.

    From the last frame to the first: with ``G = L_wt L_tt⁻¹`` for the window w of frames coupled with t,
    ``Σ_wt = −Σ_ww G`` and ``Σ_tt = (L_tt L_ttᵀ)⁻¹ + Gᵀ Σ_ww G`` (Takahashi, Fagan and Chen 1973; Erisman and Tinney,
    DOI 10.1145/360680.360704). Exact, without the other blocks of the inverse.
    """
    reach = len(factor) // D - 1
    out = np.empty((frames, D, D))
    window = np.zeros((0, 0))
    for t in reversed(range(frames)):
        here = solve_triangular(_block(factor, t, 0, D), np.eye(D), lower=True)
        m = min(reach, frames - 1 - t)
        G = np.concatenate([np.zeros((0, D)), *(_block(factor, t, j, D) for j in range(1, m + 1))]) @ here
        S = window[: m * D, : m * D]
        beside = -S @ G
        block = here.T @ here - G.T @ beside
        out[t] = 0.5 * (block + block.T)  # rounding that is not symmetric would grow from frame to frame, without end
        window = np.block([[out[t], beside.T], [beside, S]])
    return out
