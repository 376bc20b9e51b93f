"""What the solver knows between two steps."""

from typing import Any

import equinox as eqx

from .._typing import Array, Bool, Float, Scalar

Linearised = tuple[Array, Any, Array, Array, Any]
"""Residual, Jacobian, R and Q^T r of its QR factorisation, and auxiliary output."""


class MarquardtState(eqx.Module):
    """State between two steps.

    Attributes:
        residual: at the accepted point.
        jacobian: there; whatever `linearise` gives.
        factor, projected: R and Q^T r of the Jacobian's QR factorisation.
        cost: half the squared norm of the residual; infinite before the first evaluation.
        scale: largest norm of each column so far, which scales the damping.
        damping: Marquardt's lambda; `growth` is what the next rejection multiplies it by.
        step: last accepted or rejected step.
        accepted: whether the last step was accepted.
        detour: the step to try next in place of a shorter one; 0 where there is none.
        sound: whether everything was finite where it led to.
        aux: auxiliary output at the accepted point.
        evaluations: how often value and Jacobian were computed.
    """

    residual: Float[Array, " residual"]
    jacobian: Any
    factor: Float[Array, "parameter parameter"]
    projected: Float[Array, " parameter"]
    cost: Scalar
    scale: Float[Array, " parameter"]
    damping: Scalar
    growth: Scalar
    step: Float[Array, " parameter"]
    accepted: Bool[Array, ""]
    detour: Float[Array, " parameter"]
    sound: Bool[Array, ""]
    aux: Any
    evaluations: Array


def shown_noise(state: MarquardtState) -> Any:
    """The root of the reduced chi-square: the noise that the residual itself shows."""
    size = state.residual.shape[0] - state.projected.shape[0]
    return (2 * state.cost / max(size, 1)) ** 0.5
