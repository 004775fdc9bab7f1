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
from twistcap.body import Posed
from twistcap.cues.observation import Evidence, Fit
from twistcap.predict.inertia import INFLATION
from twistcap.terms import PointTerm, SegmentSums

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
    points = [e.term for e in evidence if isinstance(e.term, PointTerm)]
    judging = [e.term for e in evidence if isinstance(e.term, PointTerm) and e.agreement is not None]
    factor = variance_factor(judging, fit.posed)
    if factor is None:
        return posterior
    # Gradients enter the posterior times trust / INFLATION²; their variance is taken out, and the true one put in.
    true = factor / INFLATION**2 * (images + OFFSET**2 * offset_variance(points, fit.before))
    found = posterior + posterior @ (true - images) @ posterior * (trust / INFLATION**2)
    return 0.5 * (found + found.T)


def variance_factor(terms: Sequence[PointTerm], posed: Posed) -> float | None:
    """Mean square residual in units of its claimed variance: 1 where the noise is as large as it is said to be.

    None where there is no residual.
    """
    squares, count = 0.0, 0
    for term in terms:
        _, _, rows = term.rows(posed)
        squares += float(rows.weight @ rows.residual**2)
        count += int(np.count_nonzero(rows.weight))
    return squares / count if count else None


def offset_variance(terms: Sequence[PointTerm], posed: Posed) -> Float:
    """Variance (6 + J, 6 + J) of the gradient of terms in which segments lie off.

    Each segment has an offset of its own in each term, of 1 m standard deviation in all directions.
    """
    by_pose, out = posed.projector.T, np.zeros((posed.body.dof, posed.body.dof))
    for term in terms:
        sums = SegmentSums(posed)
        sums.add_rows(*term.rows(posed))
        by_offset = by_pose @ sums.by_shift()
        out += by_offset @ by_offset.T
    return out
