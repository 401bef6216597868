"""A smooth flight through the rows of a truth, for all the moments between them."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.records import Truth


@dataclass(frozen=True, slots=True, eq=False)
class TruthSpline:
    """Cubic splines in seconds since the truth's first row: position [m], quaternion wxyz."""

    p: BSpline
    q: BSpline

    def pose(self, t_s: Array) -> tuple[Array, Array]:
        """R_WI (k, 3, 3), p_WI (k, 3) [m] at times (k,)."""
        return geo.matrix_from_quat(self.q(t_s)), np.asarray(self.p(t_s))


def spline_of(truth: Truth) -> TruthSpline:
    """The splines through every row; the quaternion's is normalised where it is asked."""
    t_s = (truth.t_ns - truth.t_ns[0]) * 1e-9
    turns = np.einsum("ij,ij->i", truth.q_WI[1:], truth.q_WI[:-1]) < 0.0
    sign = np.cumprod(np.where(np.concatenate([[False], turns]), -1.0, 1.0))
    return TruthSpline(
        make_interp_spline(t_s, truth.p_WI, k=3),
        make_interp_spline(t_s, sign[:, None] * truth.q_WI, k=3),
    )


def left_out(truth: Truth) -> tuple[Array, Array]:
    """How far a spline through every other row is from the rows between: [m], [rad]; (m,) each."""
    t_s = (truth.t_ns - truth.t_ns[0]) * 1e-9
    odd = np.arange(1, len(truth) - 1, 2)
    half = Truth(truth.t_ns[::2], truth.p_WI[::2], truth.q_WI[::2])
    R_WI, p_WI = spline_of(half).pose(t_s[odd[t_s[odd] < t_s[::2][-1]]])
    odd = odd[: len(p_WI)]
    turned = np.swapaxes(geo.matrix_from_quat(truth.q_WI[odd]), -1, -2) @ R_WI
    return np.linalg.norm(p_WI - truth.p_WI[odd], axis=-1), geo.angle(turned)


def velocity_misfit(truth: Truth, spline: TruthSpline) -> float | None:
    """Median distance [m/s] of the spline's slope to the truth's velocities; None: it has none."""
    if truth.v_WI is None or not np.isfinite(truth.v_WI).any():
        return None
    slope = spline.p.derivative()((truth.t_ns - truth.t_ns[0]) * 1e-9)
    return float(np.nanmedian(np.linalg.norm(slope - truth.v_WI, axis=-1)))
