"""How probable it is that a part, or the body, is lost: signs in the images, weighed as captures with known truth say.

`benchmarks/fit_flag.py` fits the weights on captures of the fault bench; others judge them.
"""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body
from twistcap.body.limbs import limb_parts, limbs
from twistcap.cues.observation import Agreement
from twistcap.search.recollection import Check, Recollection

_FEWEST = 8.0  # contour points or covered pixels below which nothing is said of a limb
SIGNS = 7


def flag_groups(body: Body) -> Bool:
    """(G, S) the segments of each limb; the last group is all others."""
    own = [limb_parts(body, limb) for limb in limbs(body)]
    rest = ~np.any(own, axis=0) if own else np.ones(len(body.segment_names), np.bool_)
    return np.array([*own, rest])


def limb_signs(groups: Bool, known: Recollection, check: Check, agreement: Agreement, support: Float) -> Float:
    """(G, SIGNS) signs of loss of each group of segments (G, S), each 0 where all is as it usually is.

    They are: evidence that is lacking, over what is usual; the same in the camera in which most is; evidence that
    nothing covers, over the same; contour points that do not agree; the same of late, in the segment with most; contour
    points that tell nothing; and how much of the limb is not seen at all.
    """
    weights = groups.T.astype(float)
    usual = (known.usual * check.pixels) @ weights
    lacking, total = usual - check.nats @ weights, usual.sum(axis=0)
    judged = total > _FEWEST
    clear = np.where(judged, lacking.sum(axis=0) / np.maximum(total, 1e-9), 0.0)
    in_view = np.where(usual > _FEWEST, lacking / np.maximum(usual, 1e-9), 0.0).max(axis=0)
    more = np.maximum((check.uncovered - known.uncovered).sum(axis=0) @ weights, 0.0)
    bare = more / np.maximum(known.nats.sum(axis=0) @ weights, 1.0)
    points, agreeing, telling = (a @ weights for a in (agreement.points, agreement.agreeing, agreement.telling))
    many = points >= _FEWEST
    off = np.where(many, 1.0 - agreeing / np.maximum(points, 1.0), 0.0)
    silent = np.where(many, 1.0 - telling / np.maximum(points, 1.0), 1.0)
    late = np.array([(1.0 - support[group]).max() for group in groups])
    unseen = np.clip(
        1.0 - check.pixels.sum(axis=0) @ weights / np.maximum(known.pixels.sum(axis=0) @ weights, 1.0), 0, 1
    )
    return np.stack([clear, in_view, np.minimum(bare, 3.0), off, late, silent, unseen], axis=1)
