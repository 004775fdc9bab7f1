"""What is claimed of a fit: how far samples that err together put it off.

The gain of a frame is that of independent samples. Its error is not: what a view shows of a segment lies off as a
whole, where a girth, a joint or a camera is wrong, an edge is blurred, or a template has drifted. So the claim is a
cluster-robust covariance (Liang and Zeger, DOI 10.1093/biomet/73.1.13), with one cluster for each segment, view and
cue, whose shared error is a random offset of the segment. Nothing in here is read by the tracker.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap.arrays import Float
from twistcap.cues.observation import Evidence, Fit
from twistcap.predict.inertia import INFLATION
from twistcap.terms import PointTerm
from twistcap.terms.offsets import add_offset_variance

OFFSET = 0.007
"""m, standard deviation of the offset of each segment in each view and cue, where residuals are as large as the noise
says. The one factor on what is claimed; derived in docs/concepts/covariance.md."""


def claimed(posterior: Float, images: Float, fit: Fit, evidence: Sequence[Evidence], trust: float = 1.0) -> Float:
    """Covariance (6 + J, 6 + J) of a fit whose samples err together.

    What does not come from cues (the prediction, keypoints, priors) counts as in `posterior`.

    Args:
        posterior: (6 + J, 6 + J) as if samples were independent, times the square of `INFLATION`.
        images: (6 + J, 6 + J) information of the evidence, as of independent samples.
        fit: that it is of.
        evidence: of all views and cues, as it entered the fit.
        trust: how far the images were believed, 0 … 1.
    """
    squares, count, together = 0.0, 0, np.zeros_like(images)
    for one in evidence:
        if isinstance(one.term, PointTerm):
            _, points, rows = one.term.rows(fit.posed)
            add_offset_variance(points.bound_to(fit.posed), rows.gradient, rows.weight, fit.posed.projector, together)
            if one.agreement is not None:
                used = rows.weight != 0.0
                squares += float(rows.weight[used] @ rows.residual[used] ** 2)
                count += np.count_nonzero(used)
    if not count:
        return posterior
    factor = squares / count  # of the noise; 1 where it is as large as it is said to be
    # Gradients enter the posterior times trust / INFLATION²; their variance is taken out, and the true one put in.
    true = factor / INFLATION**2 * (images + OFFSET**2 * together)
    found = posterior + posterior @ (true - images) @ posterior * (trust / INFLATION**2)
    return 0.5 * (found + found.T)
