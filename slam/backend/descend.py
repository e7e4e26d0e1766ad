"""The damped descent of every batch: Levenberg and Marquardt's steps on whatever can be damped."""

from __future__ import annotations

from typing import Protocol, TypeVar

from slam.backend.config import BundleConfig

_FIRST_DAMPING = 1e-4
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e6

S = TypeVar("S")


class LeastSquares(Protocol[S]):
    """A robust least-squares problem over states S."""

    def objective(self, state: S) -> float:
        """What a state costs."""
        ...

    def take_over(self) -> None:
        """Linearise where the objective was asked for last."""
        ...

    def stepped(self, state: S, damping: float) -> S | None:
        """The state one damped step on from where it is linearised; None where it is singular."""
        ...


def levenberg_marquardt(problem: LeastSquares[S], state: S, config: BundleConfig,
                        cost: float | None = None) -> S:
    """Damped steps; one that raises the objective, or leaves the numbers, is not taken.

    The problem is left linearised at the state returned.

    Args:
        cost: the objective, where the problem is linearised at `state` already.
    """
    if cost is None:
        cost = problem.objective(state)
        problem.take_over()
    damping = _FIRST_DAMPING
    for _ in range(config.iterations):
        tried = problem.stepped(state, damping)
        cost_tried = float("inf") if tried is None else problem.objective(tried)
        if tried is None or not cost_tried < cost:
            damping *= 30.0
            if damping > _MOST_DAMPING:
                break
            continue
        ended = cost - cost_tried < config.tolerance * cost
        state, cost = tried, cost_tried
        problem.take_over()
        damping = max(damping * 0.1, _LEAST_DAMPING)
        if ended:
            break
    return state
