"""The Parzen density of joint angles, learnt from samples.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge: Cues for Capturing 3D Human Motion in Videos"
(Human Motion, ch. 11, Springer 2008, DOI 10.1007/978-1-4020-6693-1_11), eq. 11.29-11.32; method.md 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree  # type: ignore[attr-defined]
from scipy.special import logsumexp, softmax

from twistcap.arrays import Float
from twistcap.errors import InputError, check

_SAME = 4  # decimals, rad: samples that agree so far are one, as where a file was given twice


@dataclass(frozen=True)
class ParzenPrior:
    """A mixture of equal Gaussians, one around each training sample: ``p(Θ) ∝ Σ exp(−|(Θ_i − Θ)/s|² / (2σ²))``.

    The root is not in it: people do the same everywhere. Angles are compared as they are, without wrapping.

    Attributes:
        names: J joint coordinates.
        samples: (N, J) training samples, rad.
        sigma: kernel width σ, rad (of the scaled differences where there is a scale).
        scale: (J,) s, by which the differences are divided: a joint of a large scale may stray farther. None for 1.

    Raises InputError for shapes that do not fit, numbers that are not finite, or a width or scale that is not positive.
    """

    names: tuple[str, ...]
    samples: Float
    sigma: float
    scale: Float | None = None

    def __post_init__(self) -> None:
        J = len(self.names)
        check("prior", J > 0 and len(set(self.names)) == J, "its coordinate names must be given, each once")
        shape = self.samples.shape
        check("prior", len(shape) == 2 and shape[1] == J, f"its samples must be (N, {J}), as its names")
        check("prior", len(self.samples) > 0, "it has no samples; train it on a motion")
        check("prior", np.isfinite(self.samples).all(), "a sample is not finite; cut the frames without values")
        check("prior", 0 < self.sigma < np.inf, f"sigma is {self.sigma}; it must be positive and finite")
        if self.scale is not None:
            check("prior", self.scale.shape == (J,), f"its scale must be ({J},), one for each coordinate")
            check("prior", np.all((self.scale > 0) & (self.scale < np.inf)), "its scales must be positive and finite")

    @staticmethod
    def trained(
        names: Sequence[str], samples: Float, sigma: float | None = None, scale: Float | None = None
    ) -> ParzenPrior:
        """A prior of samples (N, J); σ by the paper's rule (`kernel_width`) where none is given. Raises InputError as
        the prior itself, and where the rule finds no two different samples.
        """
        given = ParzenPrior(tuple(names), np.asarray(samples, dtype=float), 1.0 if sigma is None else sigma, scale)
        return given if sigma is not None else replace(given, sigma=kernel_width(given._places))

    @property
    def _scales(self) -> Float:
        return np.ones(len(self.names)) if self.scale is None else self.scale

    @cached_property
    def _places(self) -> Float:
        """(N, J) scaled samples."""
        return self.samples / self._scales

    def _exponents(self, q: Float, known: Float | float = 1.0) -> Float:
        """(N,) logarithms of the weights w_i; a square difference counts as far as its joint is known."""
        d = self._places - q / self._scales
        return np.einsum("nj,nj->n", d * known, d) * (-0.5 / self.sigma**2)

    def energy(self, q: Float) -> float:
        """``−log p`` (eq. 11.30) at angles q (J,), less the kernel's own constant: 0 in the midst of equal samples."""
        return float(np.log(len(self.samples)) - logsumexp(self._exponents(q)))

    def weights(self, q: Float, known: Float | float = 1.0) -> Float:
        """(N,) ``w_i / Σ w_i`` (eq. 11.32), by log-sum-exp; `known` (J,) says how far each angle is believed, 0 … 1."""
        return softmax(self._exponents(q, known))

    def mean(self, q: Float, known: Float | float = 1.0) -> Float:
        """(J,) weighted mean of the samples, where the mean shift leads in one step; less q, times `information`, it is
        minus the derivative of `energy` (eq. 11.31). Angles that are not `known` are regressed on the others.
        """
        return self.weights(q, known) @ self.samples

    @property
    def median_distance(self) -> float:
        """Median distance between neighbouring samples, in the unit of `sigma`; 0 for a single one."""
        different = _different(self._places)
        return float(np.median(nearest_distances(different))) if len(different) > 1 else 0.0

    @property
    def information(self) -> Float:
        """(J,) curvature ``1/(σ s)²`` of each kernel; `energy` never curves more, so that it majorises."""
        return 1.0 / (self.sigma * self._scales) ** 2

    def spread(self, q: Float) -> Float:
        """(J, J) covariance of the kernels that count at q: their width, and how far their centres lie apart."""
        w = self.weights(q)
        d = self.samples - w @ self.samples
        return (d.T * w) @ d + np.diag(1.0 / self.information)

    def restricted(self, names: Sequence[str]) -> ParzenPrior:
        """The density of some of the coordinates alone: a Parzen density again, of the same width."""
        columns = [self.names.index(name) for name in names]
        scale = None if self.scale is None else self.scale[columns]
        return ParzenPrior(tuple(names), np.ascontiguousarray(self.samples[:, columns]), self.sigma, scale)


def kernel_width(samples: Float) -> float:
    """The paper's σ: the largest distance of a sample (N, J) from its nearest neighbour.

    It suits smooth sequences. Copies do not count as neighbours, or a file given twice would have the width 0; one
    stray sample makes all kernels wide, and then the width is better given. Raises InputError where all samples are the
    same.
    """
    different = _different(samples)
    if len(different) < 2:
        raise InputError("prior: all its samples are the same pose, which tells no sigma; give sigma, or a motion.")
    return float(nearest_distances(different).max())


def _different(samples: Float) -> Float:
    return np.unique(np.round(samples, _SAME), axis=0)


def nearest_distances(samples: Float) -> Float:
    """(N,) distance of each sample (N, J) from its nearest neighbour."""
    return np.asarray(cKDTree(samples).query(samples, k=2)[0])[:, 1]
