"""How probable it is that a part, or the body, is lost: signs in the images, weighed as captures with known truth say.

`benchmarks/fit_flag.py` fits the weights on captures of the fault bench; other captures judge them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import erfc

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import limb_parts, limbs
from twistcap.cues.observation import Agreement
from twistcap.ranges import Checked, Share, Signed
from twistcap.search.recollection import Check, Recollection

FEWEST = 8.0  # contour points or covered pixels below which nothing is said of a limb
SIGNS = 11
LACKING, IN_VIEW, DISAGREEING, LATE, SILENT, UNSEEN, FEW = 0, 1, 3, 4, 5, 6, 7  # some of them, see `image_signs`
FOUND, JUMPED = 8, 9  # whether a search has put it there; how far it is from where it was expected, m
USUAL = (0.05, 0.1, 0.15)
"""What `contour_signs` say of a limb before a recording has taught what is usual."""
MOST_USUAL = (0.2, 0.35, 0.4)
"""The most of each that may pass for usual."""

LOST = 0.15
"""m by which a joint is off that is lost."""
_CONTRAST = 0.4  # of a limb's contour points that tell it from what is behind it; with fewer nothing says it is right
_AT_LIMIT = 0.02  # rad from a limit
_MEANS = [0, 1, 2, 3, 5, 6]  # signs whose running means count as well; that of `late` is one
_OF = {
    "clear": (-0.1, 0.1, 0.25, 0.4, 0.6, 1.0), "in_view": (0.0, 0.3, 0.6, 1.0, 1.5), "bare": (0.0, 0.1, 0.3, 1.0),
    "against": (0.0, 0.1, 0.25, 0.4, 0.6), "late": (0.0, 0.1, 0.2, 0.35, 0.5, 0.7),
    "silent": (0.0, 0.1, 0.25, 0.4, 0.6, 0.8), "unseen": (0.0, 0.2, 0.4, 0.6, 0.8, 1.0), "few": (0.0, 1.0, 2.0, 3.0),
    "found": (0.0, 0.2, 0.5, 1.0), "jumped": (0.0, 0.03, 0.06, 0.12, 0.25, 0.6), "at_limit": (0.0, 0.1, 0.2, 0.4, 0.7),
}  # fmt: skip
_SIGNS = tuple(_OF.values())
KNOTS = (*_SIGNS, *(_SIGNS[k] for k in _MEANS), (-12.0, -8.0, -5.0, -2.5, 0.0, 2.0), _OF["clear"], _OF["late"])
"""Of all signs, of their running means, of `beyond`, and of the most and the mean of all limbs."""
_WHICH = np.repeat(np.arange(len(KNOTS)), [len(knots) - 1 for knots in KNOTS])
_FROM = np.concatenate([knots[:-1] for knots in KNOTS])
_SLOPE = 1.0 / np.concatenate([np.diff(knots) for knots in KNOTS])

# By benchmarks/fit_flag.py --seeds 1000-1131.
LIMB = (
    -9.675, 0, 0, 0, 0, 2.43, 0.8572, 0, 0.3742, 0.9345, 0, 0, 0, 0.7571, 1.22, 0, 0, 0, 0, 0.175, 0, 0.4584, 0.2789,
    0.3181, 0, 0, 0.9943, 0.505, 0, 0, 0, 0, 0.8557, 0, 0, 0, 0.1702, 0.3136, 0.1645, 0.7976, 1.215, 0.1268, 0.262, 0,
    0.8408, 0.4094, 0.001988, 0.0858, 0.2837, 0, 0, 0.3154, 0, 0, 0.9345, 0.5214, 0, 0, 0, 1.267, 0, 0, 0, 0, 0.3537,
    0, 0, 0.84, 0, 0, 0, 0, 0, 1.5, 0.1559, 0.5418, 0.7581, 0.07663, 0.3148, 0.4369, 0, 0, 0, 0, 0, 0, 0, 0,
)  # fmt: skip
BODY = (0.4214, 0.0558, 0.9478)
BLIND = (1.127, 2.446, 0.1612)
AGAIN = 1.806


def flag_groups(body: Body) -> Bool:
    """(G, S) the segments of each limb; the last group is all others."""
    own = [limb_parts(body, limb) for limb in limbs(body)]
    rest = ~np.any(own, axis=0) if own else np.ones(len(body.segment_names), np.bool_)
    return np.array([*own, rest])


def outer_segments(groups: Bool, body: Body) -> Bool:
    """(G, S) the segments in the outer half of each group, counted from the root: of an arm the forearm and the hand,
    of the trunk the torso.
    """
    joints = body.chain.sum(axis=1)
    return groups & (joints >= np.array([np.median(joints[own]) if own.any() else 0 for own in groups])[:, None])


def judged(groups: Bool, body: Body, agreement: Agreement, shown: Bool, lost: Bool) -> Bool:
    """(G,) groups of segments (G, S) that are judged: all of them are `shown` (S,) and `lost` (G,), or all have contour
    points, of which enough tell them from what is behind them, also of those of the outer half: a thigh says nothing of
    the shin. All where that is none.
    """
    parts = groups, outer_segments(groups, body)
    telling = np.all([p @ agreement.telling >= _CONTRAST * (p @ agreement.points) for p in parts], axis=0)
    hidden, without_contour = ((groups & ~of).any(axis=1) for of in (shown, agreement.points > 0))
    known = (lost & ~hidden) | (telling & ~without_contour)
    return np.asarray(known if known.any() else ~known, np.bool_)


def image_signs(
    groups: Bool, known: Recollection, check: Check, agreement: Agreement, support: Float, usual: Float
) -> Float:
    """(G, 8) signs of loss of each group of segments (G, S) in the images, 0 where all is as it usually is.

    They are: evidence that is lacking, over what is usual; the same in the camera in which most is; evidence that
    nothing covers, over the same; what `contour_signs` say, beyond what is `usual` (G, 3); how much of the
    limb is not seen at all; and cameras that see it, short of three.
    """
    weights = groups.T.astype(float)
    taught = known.pixels.sum(axis=0) @ weights > FEWEST  # before, evidence says nothing of a limb
    clear, in_view = lacking(groups, known, check)
    more = np.maximum((check.uncovered - known.uncovered).sum(axis=0) @ weights, 0.0)
    bare = np.where(taught, more / np.maximum(known.nats.sum(axis=0) @ weights, 1.0), 0.0)
    contour = contour_signs(groups, agreement, support) - usual
    unseen = np.where(taught, hidden(groups, known, check), 0.0)
    few = np.where(taught, np.maximum(3 - (check.pixels @ weights > FEWEST).sum(axis=0), 0), 0)
    return np.column_stack([clear, in_view, bare, contour, unseen, few])


def contour_signs(groups: Bool, agreement: Agreement, support: Float) -> Float:
    """(G, 3) fraction of the contour points of each group of segments (G, S) that tell something and do not agree;
    those of late that do not, in the segment with most; and fraction of those that tell nothing.
    """
    points, agreeing, telling = (groups @ a for a in (agreement.points, agreement.agreeing, agreement.telling))
    many, total = points >= FEWEST, np.maximum(points, 1.0)
    late = [(1.0 - support[group]).max() for group in groups]
    against, silent = (telling - agreeing) / total, 1.0 - telling / total
    return np.column_stack([np.where(many, against, 0.0), late, np.where(many, silent, 1.0)])


def at_limits(groups: Bool, body: Body, q: Float) -> Float:
    """(G,) fraction of the coordinates (J,) of each group of segments (G, S) that are at their limits: a limb that has
    gone astray is often bent as far as it goes.
    """
    stopped = (q < body.limits[:, 0] + _AT_LIMIT) | (q > body.limits[:, 1] - _AT_LIMIT)
    moved = np.array([body.chain[group].any(axis=0) for group in groups])
    own = np.concatenate([moved[:-1] & ~moved[-1], moved[-1:]])
    return own @ stopped.astype(float) / np.maximum(own.sum(axis=1), 1)


def displaced(groups: Bool, posed: Posed, expected: Pose) -> Float:
    """(G,) m, how far the farthest segment of each group of segments (G, S) is from where it was expected."""
    far = np.linalg.norm(posed.segment_middles - Posed(posed.body, expected).segment_middles, axis=1)
    return np.where(groups, far, 0.0).max(axis=1)


def lacking(groups: Bool, known: Recollection, check: Check) -> tuple[Float, Float]:
    """(G,) evidence that lacks of each group of segments (G, S), over what is usual; and in the camera in which most
    does.
    """
    usual = (known.usual * check.pixels) @ groups.T.astype(float)
    less, total = usual - check.nats @ groups.T.astype(float), usual.sum(axis=0)
    all_views = np.where(total > FEWEST, less.sum(axis=0) / np.maximum(total, 1e-9), 0.0)
    return all_views, np.where(usual > FEWEST, less / np.maximum(usual, 1e-9), 0.0).max(axis=0)


def shortfall(signs: Float) -> Float:
    """(G,) evidence that lacks, or that a hidden limb does not give, over what is usual; of `image_signs`."""
    clear, unseen = signs[:, LACKING], signs[:, UNSEEN]
    return unseen + (1.0 - unseen) * clear


def hidden(groups: Bool, known: Recollection, check: Check) -> Float:
    """(G,) fraction of the pixels that each group of segments (G, S) usually covers, and does not cover now."""
    weights = groups.T.astype(float)
    usual = np.maximum(known.pixels.sum(axis=0) @ weights, 1.0)
    return np.clip(1.0 - check.pixels.sum(axis=0) @ weights / usual, 0.0, 1.0)


def support_signs(groups: Bool, support: Float) -> Float:
    """(G, SIGNS) signs where only the running support (S,) is known."""
    signs = np.zeros((len(groups), SIGNS))
    signs[:, LATE] = [(1.0 - support[group]).max() - USUAL[1] for group in groups]
    return signs


@dataclass(frozen=True)
class FlagRule(Checked):
    """Weights of the ramps by which signs raise the odds of loss.

    They are those of a limb, of the body by its two most doubtful limbs, and of a body that no image shows.

    Attributes:
        limb: constant, then the weights of `ramps`.
        body: constant, weights of the log odds of the second most and the most doubtful limb.
        unseen: constant, weights of log₁₀ of the seconds since images last showed the body and of `beyond`.
        again: added to the log odds of each limb in frames that are tracked again in hindsight: such a track has no
            history of doubts.
        gone: least probability where there are images, and none shows the body: it is elsewhere, or hardly in sight.
        hardly: mean fraction of each limb that is not seen, from which on the body is hardly in sight.
        lost: probability from which on it counts as lost.
    """

    limb: tuple[Signed, ...] = LIMB
    body: tuple[Signed, Signed, Signed] = BODY
    unseen: tuple[Signed, Signed, Signed] = BLIND
    again: Signed = AGAIN
    gone: Share = 0.8
    hardly: Share = 0.9
    lost: Share = 0.5

    @property
    def in_hindsight(self) -> Self:
        """The rule for a second track, through frames that have passed."""
        constant, *weights = self.limb
        return replace(self, limb=(constant + self.again, *weights))

    def limbs(self, signs: Float, lately: Float, deviation: Float) -> Float:
        """(G,) probability that each limb is lost, from its signs (G, SIGNS) now and lately, and from the standard
        deviation (G,) m of its place.
        """
        return _logistic(self.limb[0] + ramps(signs, lately, deviation) @ np.array(self.limb[1:]))

    def whole(self, limbs: Float, signs: Float | None = None) -> float:
        """Probability that any joint is lost, from that of each limb that is judged, and from the signs (G, SIGNS)."""
        odds = np.sort(np.concatenate([[-20.0], log_odds(limbs)]))[-2:]
        hardly = signs is not None and signs[:, UNSEEN].mean() >= self.hardly
        return max(float(_logistic(self.body[0] + odds @ np.array(self.body[1:]))), self.gone if hardly else 0.0)

    def blind(self, seconds: float, deviation: float, gone: bool) -> float:
        """Probability that a body is lost that no image has shown for some time, and of whose farthest part a standard
        deviation (m) is claimed; `gone` where it was looked for in images.
        """
        unsure = np.array([np.log10(max(seconds, 1e-3)), beyond(np.array(deviation))])
        return max(float(_logistic(self.unseen[0] + unsure @ np.array(self.unseen[1:]))), self.gone if gone else 0.0)


def segment_deviations(posed: Posed, covariance: Float) -> Float:
    """(S,) m, standard deviation of the middle of each segment along its least certain direction."""
    middles = posed.segment_middles
    by_twist = np.concatenate([-se3.hat(middles), np.broadcast_to(np.eye(3), (len(middles), 3, 3))], axis=-1)
    J = by_twist @ posed.projector.reshape(-1, 6, posed.body.dof)
    values = np.linalg.eigvalsh(J @ covariance @ J.transpose(0, 2, 1))
    return np.sqrt(np.maximum(values[:, -1], 1e-12))


def ramps(signs: Float, lately: Float, deviation: Float) -> Float:
    """(G, R) features in [0, 1]: each value rises from 0 to 1 between two neighbours of its knots."""
    clear, late = signs[:, LACKING], signs[:, LATE]
    others = np.full((2, len(signs)), [[clear.max()], [late.mean()]])
    values = np.column_stack([signs, lately[:, _MEANS], beyond(deviation), *others])
    return np.clip((values[:, _WHICH] - _FROM) * _SLOPE, 0.0, 1.0)


def beyond(deviation: Float) -> Float:
    """Log odds that a normal error of so many m in each direction is longer than 150 mm (Maxwell's law)."""
    ratio = LOST / np.clip(deviation, 1e-3, 10.0)
    return log_odds(erfc(ratio / np.sqrt(2.0)) + ratio * np.sqrt(2.0 / np.pi) * np.exp(-0.5 * ratio**2))


def log_odds(probability: Float) -> Float:
    """ln p / (1 − p), within ± 20."""
    p = np.clip(probability, 1e-9, 1.0 - 1e-9)
    return np.log(p / (1.0 - p))


def _logistic(value: Float) -> Float:
    return 1.0 / (1.0 + np.exp(-value))
