"""The RPC `Check`: judges true states by a predicate of a task, or measures them."""

import numpy as np

from freerein.errors import must_be
from freerein.types.sim import CheckRequest, CheckResponse
from freerein_sim.worlds.measures import StateMeasure
from freerein_sim.worlds.predicates import StatePredicate, States
from freerein_sim.worlds.world import TaskDefinition

MAX_ROWS = 1_000_000
MAX_MEASURED_ROWS = 32
"""Rows of a measure, which may take half a second each."""


def check(task: TaskDefinition, request: CheckRequest) -> CheckResponse:
    """Returns where a predicate of the task holds, or what a measure is.

    Raises:
        InvalidInput: The request does not fit it.
    """
    asked = _asked(task, request.predicate)
    most_rows = MAX_MEASURED_ROWS if isinstance(asked, StateMeasure) else MAX_ROWS
    _check_states(task, request.states, field="states", most_rows=most_rows)
    if not asked.needs_reference:
        if request.references is not None:
            raise must_be("references", f"empty: {asked.name} compares with none", "some", hint="Leave it out.")
        return _answer(asked, request.states)
    if request.references is None or request.references.shape != request.states.shape:
        got = "none" if request.references is None else request.references.shape
        hint = f"{asked.name} compares each state with its reference."
        raise must_be("references", f"of the shape of `states`, {request.states.shape}", got, hint=hint)
    _check_states(task, request.references, field="references", most_rows=most_rows)
    return _answer(asked, request.states, request.references)


def _asked(task: TaskDefinition, name: str) -> StatePredicate | StateMeasure:
    offered: tuple[StatePredicate | StateMeasure, ...] = (*task.predicates, *task.measures)
    for each in offered:
        if each.name == name:
            return each
    hint = f"There are {', '.join(each.name for each in offered) or 'none'}."
    raise must_be("predicate", f"one of the task's {len(offered)}", "another name", hint=hint)


def _answer(asked: StatePredicate | StateMeasure, *states: States) -> CheckResponse:
    if isinstance(asked, StateMeasure):
        return CheckResponse(values=asked.values(*states))
    return CheckResponse(holds=asked.holds(*states))


def _check_states(task: TaskDefinition, states: States, *, field: str, most_rows: int) -> None:
    size = len(task.spec.state_names)
    if states.dtype != np.float64 or states.ndim != 3 or states.shape[2] != size:
        got = f"{states.dtype} {states.shape}"
    elif not 1 <= states.shape[0] * states.shape[1] <= most_rows:
        got = f"{states.shape[0] * states.shape[1]} rows"
    elif not np.isfinite(states).all():
        got = "numbers that are not finite"
    else:
        return
    rule = f"finite float64 (N, T, {size}) with 1 to {most_rows} rows N * T"
    raise must_be(field, rule, got, hint="Send true states as they are in `truth`.")
