"""How a fit integrated its model, as a part of its result."""

import dataclasses

from ._state import FitState


@dataclasses.dataclass(frozen=True)
class IntegrationFit:
    """How a fit integrated its model.

    Attributes:
        solver: one of `giajax.SOLVERS`.
        tolerance: relative and absolute tolerance of a step, where the fit ended.
        chosen: whether the fit chose the tolerance; otherwise it was stated.
    """

    solver: str
    tolerance: float
    chosen: bool


def integration_of(state: FitState) -> IntegrationFit | None:
    """Solver and tolerance in use; None of a model without them."""
    integration = state.problem.model.integration()
    if integration is None or integration.tolerance is None:
        return None
    chosen = state.setup.chooses_tolerance
    return IntegrationFit(integration.solver, integration.tolerance, chosen)
