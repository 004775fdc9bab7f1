"""What is claimed of a fit: how far samples that err together put it off.

The gain of a frame is that of independent samples. Its error is not: what a view shows of a segment lies off as a
whole, where a girth, a joint or a camera is wrong, an edge is blurred, or a template has drifted. So the claim is a
cluster-robust covariance (Liang and Zeger, DOI 10.1093/biomet/73.1.13), with clusters for each view and cue, and in it
for each segment. What a view shares is an offset; what a segment shares is an offset too, and a displacement that is
linear in the place: a wrong girth, a turn, a stretch. Nothing in here is read by the tracker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float
from twistcap.cues.observation import Fit
from twistcap.predict.inertia import INFLATION
from twistcap.solve import covariance, inverse
from twistcap.terms import Quadratic
from twistcap.terms.shared import add_shared_variance

OFFSET = 0.005
"""m, standard deviation of each shared error, where residuals are as large as the noise says; derived in
docs/concepts/covariance.md."""
MOST = 0.02
"""m, the largest: residuals grow without end where pictures are worse than their noise says, and a body that is tracked
is no farther off."""


def claimed(posterior: Float, images: Float, fit: Fit, trust: float = 1.0) -> Float:
    """Covariance (6 + J, 6 + J) of a fit whose samples err together.

    What does not come from cues (the prediction, keypoints, priors) counts as in `posterior`.

    `posterior` (6 + J, 6 + J) is as if samples were independent, times the square of `INFLATION`, `images` the
    information of the fit's evidence, as of independent samples, `trust` how far the images were believed, 0 … 1.
    """
    judging = [(e.term.name, len(points), rows) for e, points, rows in fit.entered if e.agreement is not None]
    count = sum(np.count_nonzero(rows.weight[:points]) for _, points, rows in judging)
    if not count:
        return posterior
    # Mean square residual in units of its claimed variance: 1 where the noise is as large as it is said to be.
    factor = 2.0 * sum(fit.energies[name] for name in {name for name, *_ in judging}) / count
    together, posed = np.zeros_like(images), fit.before
    for _, points, rows in fit.entered:
        add_shared_variance(points.bound_to(posed), rows.gradient, rows.weight, posed.projector, together)
    # Shared errors grow with it: it is of robust energies, which grow less than squares do where a body fits badly.
    shared = min(factor**1.5 * OFFSET, MOST)
    # Gradients enter the posterior times trust / INFLATION²; their variance is taken out, and the true one put in.
    true = (factor * images + shared**2 * together) / INFLATION**2
    found = posterior + posterior @ (true - images) @ posterior * (trust / INFLATION**2)
    return 0.5 * (found + found.T)


@dataclass(frozen=True)
class Uncertainty:
    """What is known of a pose before its images.

    Attributes:
        covariance: (6 + J, 6 + J) of the last pose's step, of what images and motion say.
        claimed: the same as it is claimed, of samples that err together.
        process_noise: (6 + J, 6 + J) what the time since then adds to both.
    """

    covariance: Float
    claimed: Float
    process_noise: Float

    @property
    def spread(self) -> Float:
        """(6 + J, 6 + J) covariance of the step from the expected pose to the truth."""
        return self.covariance + self.process_noise

    def after(self, fit: Fit, trust: float) -> tuple[Float, Float]:
        """Covariance of a fit, and the one that is claimed; of images that are believed by `trust`, 0 … 1.

        The images add to what was known, as a Kalman filter would have it. A limb that nothing shows grows less certain
        from frame to frame. Where the solve failed, only that happens.
        """
        spread = self.spread
        if fit.status == "failed" or (known := inverse(spread)) is None:
            return spread, self.claimed + self.process_noise
        posterior = with_information(known, [fit.news / (INFLATION**2 / trust)])
        images = fit.news - sum(term.linearize(fit.before).hessian for term in fit.fresh)
        return posterior, claimed(posterior, images, fit, trust)


def with_information(known: Float, more: Sequence[Float]) -> Float:
    """Covariance (6 + J, 6 + J) of information that is known, and more (6 + J, 6 + J) that is independent of it."""
    return covariance(Quadratic(0.0, np.zeros(len(known)), sum(more, known)))
