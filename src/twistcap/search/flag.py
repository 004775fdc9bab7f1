"""How probable it is that a part, or the body, is lost: signs in the images, weighed as captures with known truth say.

`benchmarks/fit_flag.py` fits the weights on captures of the fault bench; other captures judge them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body
from twistcap.body.limbs import limb_parts, limbs
from twistcap.cues.observation import Agreement
from twistcap.ranges import Checked, Share, Signed
from twistcap.search.recollection import Check, Recollection

_FEWEST = 8.0  # contour points or covered pixels below which nothing is said of a limb
SIGNS = 7

# Fitted by benchmarks/fit_flag.py on 50 captures of the fault bench and 16 inexact walks.
LIMB = (
    -4.235, 2.316, -0.8786, -0.9053, 5.976, 8.712, -0.7883, 0.8541, 3.906, -2.357, -0.8192, -3.014, -4.605, -2.68,
    1.573, 0.02768, 1.526, -0.5955, 0.2876, 0.506, 0.6978,
)  # fmt: skip
BODY = (0.5881, 0.1112, 0.9345)
UNSEEN = (4.085, 3.521)


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
    clear, in_view = lacking(groups, known, check)
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


def lacking(groups: Bool, known: Recollection, check: Check) -> tuple[Float, Float]:
    """(G,) evidence that lacks of each group of segments (G, S), over what is usual; and in the camera in which most
    does.
    """
    usual = (known.usual * check.pixels) @ groups.T.astype(float)
    less, total = usual - check.nats @ groups.T.astype(float), usual.sum(axis=0)
    all_views = np.where(total > _FEWEST, less.sum(axis=0) / np.maximum(total, 1e-9), 0.0)
    return all_views, np.where(usual > _FEWEST, less / np.maximum(usual, 1e-9), 0.0).max(axis=0)


def support_signs(groups: Bool, support: Float) -> Float:
    """(G, SIGNS) signs where only the running support (S,) is known."""
    signs = np.zeros((len(groups), SIGNS))
    signs[:, 4] = [(1.0 - support[group]).max() for group in groups]
    return signs


@dataclass(frozen=True)
class FlagRule(Checked):
    """Logistic weights: of a limb's features, of the two most doubtful limbs for the body, and of the time unseen.

    Attributes:
        limb: constant, then a weight of each of `features`.
        body: constant, weights of the logits of the second most and the most doubtful limb.
        unseen: constant and weight of log₁₀ of the seconds since images last showed the body.
        lost: probability from which on it counts as lost. Real pictures of bodies that are not exact look more doubtful
            than they are: at 0.5 a third of a good track (balance_4view) would be flagged.
    """

    limb: tuple[Signed, ...] = LIMB
    body: tuple[Signed, Signed, Signed] = BODY
    unseen: tuple[Signed, Signed] = UNSEEN
    lost: Share = 0.75

    def limbs(self, signs: Float, deviation: Float) -> Float:
        """(G,) probability that each limb is lost, from its signs (G, SIGNS) and the standard deviation (G,) m that is
        claimed of its place.
        """
        return _logistic(self.limb[0] + features(signs, deviation) @ np.array(self.limb[1:]))

    def whole(self, limbs: Float) -> float:
        """Probability that any joint is lost, from that of each limb (G,)."""
        clipped = np.clip(limbs, 1e-9, 1.0 - 1e-9)
        most = np.sort(np.concatenate([[1e-9], clipped]))[-2:]
        return float(_logistic(self.body[0] + np.log(most / (1.0 - most)) @ np.array(self.body[1:])))

    def blind(self, seconds: float) -> float:
        """Probability that a body is lost that no image has shown for some time."""
        return float(_logistic(self.unseen[0] + self.unseen[1] * np.log10(max(seconds, 1e-3))))


def features(signs: Float, deviation: Float) -> Float:
    """(G, F) features of the logistic model: the signs, what is claimed, products, and how the other limbs are."""
    clear, in_view, bare = np.clip(signs[:, :3], 0.0, 1.0).T
    off, late, silent, unseen = signs[:, 3:].T
    spread = np.log10(np.clip(deviation, 1e-3, 10.0) / 0.05)
    own = [
        clear, in_view, bare, off, late, silent, unseen, spread, np.maximum(spread, 0.0),
        off * late, silent * late, late * late, spread * late, spread * silent, clear * late,
    ]  # fmt: skip
    others = [late.mean(), late.max(), spread.max(), clear.max(), silent.mean()]
    return np.stack([*own, *(np.full(len(signs), value) for value in others)], axis=1)


def _logistic(value: Float) -> Float:
    return 1.0 / (1.0 + np.exp(-value))
