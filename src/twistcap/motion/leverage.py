"""How far a joint moves the body, which is the weight of its angle when poses are compared.

A radian of the hip moves the whole leg, one of the forearm's rotation hardly the hand. Images determine the first to a
degree and the second to ten or twenty; with equal weights the second would decide. Kovar, Gleicher and Pighin,
"Motion Graphs" (DOI 10.1145/566654.566605), section 3, likewise compare poses by points of the body.
"""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed


def leverage(body: Body, q: Float) -> Float:
    """(J,) root mean square motion of the body's vertices by each coordinate at a pose, m/rad; the pelvis is fixed.

    Args:
        body: with vertices about evenly on its surface.
        q: (J,) rad.
    """
    posed = Posed(body, Pose(np.eye(4), q))
    by_step = posed.point_jacobian(body.skin_segments, body.skin_weights, body.vertices)
    return np.sqrt(np.square(by_step[:, :, 6:]).sum(axis=1).mean(axis=0))
