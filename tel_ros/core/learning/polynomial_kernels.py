"""The compiled inner loops of :mod:`.energy_process`: covariances of torques."""

from __future__ import annotations

import numpy as np

from tel_ros.core.learning.tree_kernels import compiled
from tel_ros.core.types import BoolArray, FloatArray, IntArray


@compiled("void(f8[:], f8[:], b1[::1], f8, f8[:, ::1])")
def _correlate(
    here: FloatArray, there: FloatArray, slides: BoolArray, shape: float, form: FloatArray
) -> None:
    """Fill ``form`` (4, n_joints) with a correlation f of each joint's positions and what f changes by.

    f = (1 + b cos(q - q')) / (1 + b) of a joint that turns, (1 + b q q') / (1 + b) of one that slides. Then
    ∂ log f/∂q, ∂ log f/∂q' and ∂² log f/∂q∂q'.
    """
    for j in range(len(here)):
        if slides[j]:
            f = 1.0 + shape * here[j] * there[j]
            f = f if abs(f) > 1e-6 else 1e-6
            form[1, j], form[2, j] = shape * there[j] / f, shape * here[j] / f
            form[3, j] = shape / (f * f)
        else:
            cosine = np.cos(here[j] - there[j])
            f = 1.0 + shape * cosine
            form[1, j] = -shape * np.sin(here[j] - there[j]) / f
            form[2, j] = -form[1, j]
            form[3, j] = shape * (cosine + shape) / (f * f)
        form[0, j] = f / (1.0 + shape)


@compiled(
    "f8[:, :, ::1](f8[:, ::1], f8[:, ::1], i8[::1], b1[::1], f8, f8[:, ::1], f8[::1], f8[::1], f8[::1], b1)"
)
def covariance(
    states: FloatArray,
    others: FloatArray,
    joints: IntArray,
    slides: BoolArray,
    shape: float,
    inertia: FloatArray,
    potential: FloatArray,
    viscous: FloatArray,
    coulomb: FloatArray,
    apart: bool,
) -> FloatArray:
    """Return covariances of all torques in n states with one torque in each of m others.

    A state is q, q̇, q̈ and the smoothed sign of q̇ (4 * n_joints values); ``joints`` (m,) is the joint whose
    torque is meant in each of the others. Variances as in :class:`~.energy_process.Prior`, but ``inertia`` of
    each M_pk (n_joints, n_joints).

    For T = M_pk(q) q̇_p q̇_k, or half of it if p = k, Lagrange's equation gives τ_i = a_i M_pk + b_iᵀ ∇M_pk
    with a_i = δ_ip q̈_k + δ_ik q̈_p and b_i = (δ_ip q̇_k + δ_ik q̇_p) q̇ - q̇_p q̇_k e_i. So the covariance of two
    torques is κ ((a_i + b_iᵀ r)(a'_o + b'_oᵀ r') + Σ_j b_ij b'_oj ∂² log κ/∂q_j∂q'_j). κ is that of M_pk, a
    product over the joints j > p, and r, r' are the gradients of log κ.

    Shape (n_parts, n * n_joints, m). Summed up it is one part; ``apart`` returns that of each p, k ≥ p, then
    of each link's potential, of each viscous and each Coulomb friction.
    """
    n, n_joints, m = len(states), len(slides), len(others)
    result = np.zeros((n_joints * (n_joints + 1) // 2 + 3 * n_joints if apart else 1, n * n_joints, m))
    form = np.empty((4, n_joints))
    for row in range(n):
        here, first = states[row], row * n_joints
        v, a = here[n_joints : 2 * n_joints], here[2 * n_joints : 3 * n_joints]
        for column in range(m):
            there, o = others[column], joints[column]
            v_, a_ = there[n_joints : 2 * n_joints], there[2 * n_joints : 3 * n_joints]
            _correlate(here[:n_joints], there[:n_joints], slides, shape, form)
            f, d, d_, dd = form
            part = 0
            for p in range(n_joints):
                kappa, rate, rate_, rates = 1.0, 0.0, 0.0, 0.0
                for j in range(p + 1, n_joints):
                    kappa *= f[j] * f[j]
                    rate += 2.0 * d[j] * v[j]
                    rate_ += 2.0 * d_[j] * v_[j]
                    rates += 2.0 * dd[j] * v[j] * v_[j]
                for k in range(p, n_joints):
                    weight, half = inertia[p, k] * kappa, 0.5 if p == k else 1.0
                    product, product_ = half * v[p] * v[k], half * v_[p] * v_[k]
                    own_, push_ = (v_[k], a_[k]) if o == p else (v_[p], a_[p]) if o == k else (0.0, 0.0)
                    slope_, across_ = push_ + own_ * rate_, 0.0
                    if o > p:
                        slope_ -= 2.0 * product_ * d_[o]
                        across_ = 2.0 * product_ * dd[o]
                    for i in range(p, n_joints):
                        own, push = (v[k], a[k]) if i == p else (v[p], a[p]) if i == k else (0.0, 0.0)
                        slope, rest = push + own * rate, own * (own_ * rates - across_ * v[o])
                        if i > p:
                            slope -= 2.0 * product * d[i]
                            rest -= 2.0 * product * dd[i] * own_ * v_[i]
                            if i == o:
                                rest += product * across_
                        result[part, first + i, column] += weight * (slope * slope_ + rest)
                    part += apart
            kappa = 1.0
            for link in range(n_joints):
                kappa *= f[link]
                if o <= link:
                    weight = potential[link] * kappa
                    for i in range(link + 1):
                        result[part, first + i, column] += weight * d[i] * d_[o]
                    result[part, first + o, column] += weight * dd[o]
                part += apart
            result[part + apart * o, first + o, column] += viscous[o] * v[o] * v_[o]
            signs = here[3 * n_joints + o] * there[3 * n_joints + o]
            result[part + apart * (n_joints + o), first + o, column] += coulomb[o] * signs
    return result
