"""The compiled inner loops of :mod:`.energy_process`: covariances of torques."""

from __future__ import annotations

import numpy as np

from tel_ros.core.learning.tree_kernels import compiled
from tel_ros.core.types import BoolArray, FloatArray


@compiled("void(f8[::1], f8[::1], b1[::1], f8[::1], f8[:, ::1])")
def _correlate(
    here: FloatArray, there: FloatArray, slides: BoolArray, shapes: FloatArray, form: FloatArray
) -> None:
    """Fill ``form`` (4, n_joints) with a correlation f of each joint's positions and how it changes.

    f = (1 + b cos(q - q')) / (1 + b) of a joint that turns, (1 + b q q') / (1 + b) of one that slides. Then
    ∂ log f/∂q, ∂ log f/∂q' and ∂² log f/∂q∂q'.
    """
    n_joints = len(slides)
    for j in range(n_joints):
        shape = shapes[j]
        if slides[j]:
            f = 1.0 + shape * here[j] * there[j]
            f = f if abs(f) > 1e-6 else 1e-6
            form[1, j], form[2, j] = shape * there[j] / f, shape * here[j] / f
            form[3, j] = shape / (f * f)
        else:
            cos, cos_ = here[4 * n_joints + j], there[4 * n_joints + j]
            sin, sin_ = here[5 * n_joints + j], there[5 * n_joints + j]
            cosine = cos * cos_ + sin * sin_
            f = 1.0 + shape * cosine
            form[1, j] = -shape * (sin * cos_ - cos * sin_) / f
            form[2, j] = -form[1, j]
            form[3, j] = shape * (cosine + shape) / (f * f)
        form[0, j] = f / (1.0 + shape)


@compiled(
    "f8[:, :, ::1](f8[:, ::1], f8[:, ::1], f8[:, ::1], b1[::1], f8[::1], f8[:, ::1], f8[::1], f8[::1], "
    "f8[::1], b1)"
)
def covariance(
    states: FloatArray,
    others: FloatArray,
    weights: FloatArray,
    slides: BoolArray,
    shape: FloatArray,
    inertia: FloatArray,
    potential: FloatArray,
    viscous: FloatArray,
    coulomb: FloatArray,
    apart: bool,
) -> FloatArray:
    """Return covariances of all torques in n states with a weighted sum of those in each of m others.

    A state is as of :meth:`~.energy_process.EnergyKernel.states`; the weights w are (m, n_joints). Variances
    are as in :class:`~.energy_process.Prior`, but ``inertia`` of each M_pk, (n_joints, n_joints).

    For T = M_pk(q) q̇_p q̇_k, or half of it if p = k, Lagrange's equation gives τ_i = a_i M_pk + b_iᵀ ∇M_pk
    with a_i = δ_ip q̈_k + δ_ik q̈_p and b_i = (δ_ip q̇_k + δ_ik q̇_p) q̇ - q̇_p q̇_k e_i. So the covariance of two
    torques is κ ((a_i + b_iᵀ r)(a'_o + b'_oᵀ r') + Σ_j b_ij b'_oj ∂² log κ/∂q_j∂q'_j). κ is that of M_pk, a
    product over the joints j > p, and r, r' are the gradients of log κ.

    Shape (n_parts, n * n_joints, m). Summed up it is one part; ``apart`` returns that of each p, k ≥ p, then
    of each link's potential, of each viscous and each Coulomb friction.
    """
    n, n_joints, m = len(states), len(slides), len(others)
    n_pairs = n_joints * (n_joints + 1) // 2
    result = np.zeros((n_pairs + 3 * n_joints if apart else 1, n * n_joints, m))
    form, found = np.empty((4, n_joints)), np.empty(n_joints)
    for row in range(n):
        here, first = states[row], row * n_joints
        v, a = here[n_joints : 2 * n_joints], here[2 * n_joints : 3 * n_joints]
        for column in range(m):
            there, w = others[column], weights[column]
            v_, a_ = there[n_joints : 2 * n_joints], there[2 * n_joints : 3 * n_joints]
            _correlate(here, there, slides, shape, form)
            f, d, d_, dd = form
            last = n_joints
            while w[last - 1] == 0.0:
                last -= 1
            part = 0
            found[:] = 0.0
            for p in range(n_joints):
                if p >= last:
                    part += apart * (n_joints - p)
                    continue
                kappa, rate, rate_, rates, slope_w, rate_w = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for j in range(p + 1, n_joints):
                    kappa *= f[j] * f[j]
                    rate += d[j] * v[j]
                    rate_ += d_[j] * v_[j]
                    rates += dd[j] * v[j] * v_[j]
                    slope_w += d_[j] * w[j]
                    rate_w += dd[j] * v[j] * w[j]
                for k in range(p, n_joints):
                    weight, half = inertia[p, k] * kappa, 0.5 if p == k else 1.0
                    product, product_ = 2.0 * half * v[p] * v[k], half * v_[p] * v_[k]
                    own_, push_ = half * (w[p] * v_[k] + w[k] * v_[p]), half * (w[p] * a_[k] + w[k] * a_[p])
                    slope_ = push_ + 2.0 * (own_ * rate_ - product_ * slope_w)
                    across = 2.0 * (own_ * rates - product_ * rate_w)
                    turn = weight * (2.0 * rate * slope_ + across)
                    found[p] += half * (weight * a[k] * slope_ + turn * v[k])
                    found[k] += half * (weight * a[p] * slope_ + turn * v[p])
                    for i in range(p + 1, n_joints):
                        found[i] += (
                            weight * product * (dd[i] * (product_ * w[i] - own_ * v_[i]) - d[i] * slope_)
                        )
                    if apart:
                        result[part, first : first + n_joints, column] = found
                        found[:] = 0.0
                        part += 1
            kappa = 1.0
            slope_w = 0.0
            for link in range(n_joints):
                kappa *= f[link]
                slope_w += d_[link] * w[link]
                weight = potential[link] * kappa
                for i in range(link + 1):
                    found[i] += weight * (d[i] * slope_w + dd[i] * w[i])
                if apart:
                    result[part, first : first + n_joints, column] = found
                    found[:] = 0.0
                    part += 1
            for j in range(n_joints):
                friction = viscous[j] * v[j] * v_[j] * w[j]
                dry = coulomb[j] * here[3 * n_joints + j] * there[3 * n_joints + j] * w[j]
                if apart:
                    result[part + j, first + j, column] = friction
                    result[part + n_joints + j, first + j, column] = dry
                else:
                    found[j] += friction + dry
            if not apart:
                result[0, first : first + n_joints, column] = found
    return result
