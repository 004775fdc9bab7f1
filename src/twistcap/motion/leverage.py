"""How far a joint moves the body: what an error of its angle weighs, and how well images tell it.

A radian of the hip carries the whole leg along, one of the forearm about its own axis hardly the hand. Images tell
the first to a degree and the second to ten or twenty; compared alike, the second would decide. Kovar, Gleicher and
Pighin, "Motion Graphs" (DOI 10.1145/566654.566605), section 3, likewise compare poses by points of the body.
"""

from __future__ import annotations

import numpy as np

from twistcap._typing import Float
from twistcap.body import Body, Pose, Posed


def leverage(body: Body, q: Float) -> Float:
    """Root mean square way of the body's vertices by each coordinate at a pose, the pelvis held, m/rad (J,).

    Args:
        body: its vertices lie about evenly on its surface.
        q: (J,) rad.
    """
    posed = Posed(body, Pose(np.eye(4), q))
    by_step = posed.point_jacobian(body.skin_segments, body.skin_weights, body.vertices)
    return np.sqrt(np.square(by_step[:, :, 6:]).sum(axis=1).mean(axis=0))
