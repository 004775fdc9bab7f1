"""One linear system for the motion of a view and of the joints, from brightness constancy.

Each pixel of the body gives a row ``[H_i | J_i] (φ; θ̇) = −I_t``: H_i is the image gradient times the image motion of
the view's φ = (s', v₁, v₂, ω_x, ω_y, ω_z), J_i times that of every joint above the pixel's segment, by the twists
``ξ'_k = Ad ξ_k`` (Bregler and Malik, DOI 10.1109/CVPR.1998.698581, eqs. 13 and 19). Two more columns take up a change
of the exposure, ``I' = (1 + a) I + b``. Views have φ, a and b of their own and share the joints' columns.

Rows and sums are those of `terms`: the view's turn and shift are linear in the twist of the body's root, and only the
scale and the exposure are unknowns beside the pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Float32
from twistcap.body import Posed
from twistcap.camera import pinhole
from twistcap.camera.scaled import ROOT, ScaledView
from twistcap.render import SurfacePoints
from twistcap.terms import accumulate
from twistcap.terms.photometric import EXPOSURE, Samples
from twistcap.terms.protocols import Place, Sums

if TYPE_CHECKING:
    from twistcap.solve.blocks import Variables


def image_motion(posed: Posed, view: ScaledView, points: SurfacePoints) -> Float:
    """(N, 2, 6 + J) derivative of the pixels of surface points by the view's motion and the joints."""
    pixels, _, by_point = pinhole(view.P, points.at(posed))
    out = by_point @ posed.point_jacobian(points.segments, points.weights, points.local)
    out[:, :, :ROOT] = out[:, :, :ROOT] @ view.root_step()
    if view.K is None:  # growth is no motion of the body's
        out[:, :, 0] = pixels - view.shift
    return out


def normal_equations(
    posed: Posed, view: ScaledView, samples: Samples, image: Float32, exposure: Float, weight: Float
) -> tuple[Float, Float]:
    """Gradient (D,) and Gauss-Newton matrix (D, D) of ``½ Σ w r²`` by (φ, θ̇, a, b), D = 6 + J + 2."""
    rows = samples.rows(posed, view.P, image, exposure, weight)
    growth = np.einsum("ni,ni->n", rows.gradient, samples.points.at(posed))  # of scaled orthography
    beside = np.stack([growth, -samples.value, np.full(len(samples), -1.0)], axis=1)
    g, H = accumulate.normal_equations(posed, samples.points, rows, beside)
    step = _pose_step(view, posed.body.dof - ROOT)
    return step.T @ g, step.T @ H @ step


def _pose_step(view: ScaledView, joints: int) -> Float:
    """(6 + J + 3, 6 + J + 2) step of root, joints, growth and exposure that (φ, θ̇, a, b) makes."""
    out = np.zeros((ROOT + joints + 1 + EXPOSURE, ROOT + joints + EXPOSURE))
    out[:ROOT, :ROOT] = view.root_step()
    out[ROOT + joints, 0] = 1.0 if view.K is None else 0.0
    own = np.r_[ROOT : ROOT + joints]
    out[own, own] = 1.0
    out[own[-1] + 2 :, own[-1] + 1 :] = np.eye(EXPOSURE)
    return out


@dataclass(frozen=True)
class ViewGaussian:
    """Independent Gaussians about the scale, place and turn of the view in a block.

    `sigma` (6,) is of the step from the mean (relative scale, px, rad), infinite where nothing is expected.
    """

    view: str
    mean: ScaledView
    sigma: Float
    name: str = "view"

    def energy(self, x: Variables) -> float:
        return 0.5 * float(np.sum((x[self.view].minus(self.mean) / self.sigma) ** 2))

    def add_to(self, sums: Sums, x: Variables) -> None:
        step = x[self.view].minus(self.mean)
        D = np.eye(ROOT)
        D[3:, 3:] = se3.inverse_left_jacobian(np.append(step[3:], np.zeros(3)))[:3, :3]
        D, off = D / self.sigma[:, None], step / self.sigma
        sums.add_quadratic([Place(self.view, ROOT)], 0.5 * float(off @ off), D.T @ off, D.T @ D)
