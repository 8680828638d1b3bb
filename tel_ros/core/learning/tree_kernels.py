"""The compiled inner loops of the LMS tree.

Shapes: inputs (n, D) in 0 … 1; ``parents`` (K - 1, 3) as subtree, input, Gaussian; weights (K, D, G) with K
subtrees, the root counted. Compiled when this module is imported first, and kept on disk.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from tel_ros.core.types import FloatArray, IntArray

_TINY = 1e-9


def compiled(signature: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compile a function; keep the code unless the installation and the home folder are both read-only."""

    def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
        try:
            return njit(signature, cache=True)(function)
        except RuntimeError:
            return njit(signature)(function)

    return compiled


@compiled("f8[:, ::1](f8[:, :], f8[:], f8[:])")
def scale(inputs: FloatArray, low: FloatArray, width: FloatArray) -> FloatArray:
    """Return inputs with ``low`` … ``low + width`` mapped to 0 … 1, clipped beyond. Shape (n, D)."""
    n, n_inputs = inputs.shape
    result = np.empty((n, n_inputs))
    for row in range(n):
        for d in range(n_inputs):
            share = (inputs[row, d] - low[d]) / width[d]
            result[row, d] = min(max(share, 0.0), 1.0)
    return result


@compiled("void(f8[::1], f8, b1, f8[:, ::1])")
def _activate(x: FloatArray, sigma: float, normalised: bool, phi: FloatArray) -> None:
    """Fill ``phi`` (D, G) with the Gaussians of one input vector."""
    n_inputs, n_gaussians = phi.shape
    spacing = 1.0 / (n_gaussians - 1)
    for d in range(n_inputs):
        total = 0.0
        for i in range(n_gaussians):
            distance = (x[d] - i * spacing) / sigma
            phi[d, i] = math.exp(-0.5 * distance * distance)
            total += phi[d, i]
        if normalised:
            for i in range(n_gaussians):
                phi[d, i] /= total


@compiled("void(f8[:, ::1], i8[:, ::1], f8[::1])")
def _open_gates(phi: FloatArray, parents: IntArray, gates: FloatArray) -> None:
    """Fill ``gates`` (K,): how far each subtree is switched on."""
    gates[0] = 1.0
    for k in range(len(parents)):
        gates[k + 1] = gates[parents[k, 0]] * phi[parents[k, 1], parents[k, 2]]


@compiled("f8[:, ::1](f8[:, ::1], i8[:, ::1], i8, f8, b1)")
def features(
    inputs: FloatArray, parents: IntArray, n_gaussians: int, sigma: float, normalised: bool
) -> FloatArray:
    """Return ψ, all g_k φ_d,i. Shape (n, K * D * G)."""
    n, n_inputs = inputs.shape
    n_subtrees = len(parents) + 1
    phi, gates = np.empty((n_inputs, n_gaussians)), np.empty(n_subtrees)
    block = n_inputs * n_gaussians
    psi = np.empty((n, n_subtrees * block))
    for row in range(n):
        _activate(inputs[row], sigma, normalised, phi)
        _open_gates(phi, parents, gates)
        flat = phi.ravel()
        for k in range(n_subtrees):
            gate = gates[k]
            for m in range(block):
                psi[row, k * block + m] = gate * flat[m]
    return psi


@compiled("f8(f8[:, :, ::1], f8[:, ::1], f8[::1])")
def _output(weights: FloatArray, phi: FloatArray, gates: FloatArray) -> float:
    """Return N(x) = Σ_k g_k Σ_d,i w_k,d,i φ_d,i."""
    n_subtrees, n_inputs, n_gaussians = weights.shape
    output = 0.0
    for k in range(n_subtrees):
        within = 0.0
        for d in range(n_inputs):
            for i in range(n_gaussians):
                within += weights[k, d, i] * phi[d, i]
        output += gates[k] * within
    return output


@compiled("f8[::1](f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8, b1)")
def predict(
    inputs: FloatArray, parents: IntArray, weights: FloatArray, sigma: float, normalised: bool
) -> FloatArray:
    """Return N(x). Shape (n,)."""
    n, n_inputs = inputs.shape
    n_subtrees, _, n_gaussians = weights.shape
    phi, gates = np.empty((n_inputs, n_gaussians)), np.empty(n_subtrees)
    result = np.empty(n)
    for row in range(n):
        _activate(inputs[row], sigma, normalised, phi)
        _open_gates(phi, parents, gates)
        result[row] = _output(weights, phi, gates)
    return result


@compiled("f8[:, :, ::1](f8[:, ::1], f8[::1], i8[::1], i8[:, ::1], f8[:, :, ::1], f8, b1, f8)")
def lms_pass(
    inputs: FloatArray,
    target: FloatArray,
    order: IntArray,
    parents: IntArray,
    weights: FloatArray,
    sigma: float,
    normalised: bool,
    rate: float,
) -> FloatArray:
    """Go once through samples with the normalised LMS rule, changing ``weights`` in place.

    Δw = γ e ψ / (ε + |ψ|²), e = target - N(x). Returns the variance of each weight's changes (K, D, G).
    """
    n_subtrees, n_inputs, n_gaussians = weights.shape
    phi, gates = np.empty((n_inputs, n_gaussians)), np.empty(n_subtrees)
    total, squares = np.zeros_like(weights), np.zeros_like(weights)
    for row in order:
        _activate(inputs[row], sigma, normalised, phi)
        _open_gates(phi, parents, gates)
        power = 0.0
        for d in range(n_inputs):
            for i in range(n_gaussians):
                power += phi[d, i] * phi[d, i]
        opened = 0.0
        for k in range(n_subtrees):
            opened += gates[k] * gates[k]
        step = rate * (target[row] - _output(weights, phi, gates)) / (_TINY + opened * power)
        for k in range(n_subtrees):
            for d in range(n_inputs):
                for i in range(n_gaussians):
                    change = step * gates[k] * phi[d, i]
                    weights[k, d, i] += change
                    total[k, d, i] += change
                    squares[k, d, i] += change * change
    n = max(len(order), 1)
    return squares / n - (total / n) ** 2
