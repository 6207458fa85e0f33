"""The RPC `Check`: judges true states by a predicate of a task."""

import numpy as np

from freerein.errors import must_be
from freerein.types.sim import CheckRequest, CheckResponse
from freerein_sim.worlds.predicates import StatePredicate, States
from freerein_sim.worlds.world import TaskDefinition

MAX_ROWS = 1_000_000


def check(task: TaskDefinition, request: CheckRequest) -> CheckResponse:
    """Returns where a predicate of the task holds. Raises InvalidInput where the request does not fit it."""
    predicate = _predicate(task, request.predicate)
    _check_states(task, request.states, field="states")
    if not predicate.needs_reference:
        if request.references is not None:
            raise must_be("references", f"empty: {predicate.name} compares with none", "some", hint="Leave it out.")
        return CheckResponse(predicate.holds(request.states))
    if request.references is None or request.references.shape != request.states.shape:
        got = "none" if request.references is None else request.references.shape
        hint = f"{predicate.name} compares each state with its reference."
        raise must_be("references", f"of the shape of `states`, {request.states.shape}", got, hint=hint)
    _check_states(task, request.references, field="references")
    return CheckResponse(predicate.holds(request.states, request.references))


def _predicate(task: TaskDefinition, name: str) -> StatePredicate:
    for predicate in task.predicates:
        if predicate.name == name:
            return predicate
    hint = f"There are {', '.join(each.name for each in task.predicates) or 'none'}."
    raise must_be("predicate", f"one of the task's {len(task.predicates)}", "another name", hint=hint)


def _check_states(task: TaskDefinition, states: States, *, field: str) -> None:
    size = len(task.spec.state_names)
    if states.dtype != np.float64 or states.ndim != 3 or states.shape[2] != size:
        got = f"{states.dtype} {states.shape}"
    elif not 1 <= states.shape[0] * states.shape[1] <= MAX_ROWS:
        got = f"{states.shape[0] * states.shape[1]} rows"
    elif not np.isfinite(states).all():
        got = "numbers that are not finite"
    else:
        return
    rule = f"finite float64 (N, T, {size}) with 1 to {MAX_ROWS} rows N * T"
    raise must_be(field, rule, got, hint="Send true states as they are in `truth`.")
