"""Predicates and measures of a task on true states, by the sim service in a privileged session. For evaluation only."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import InvalidInput
from freerein.types.sim import CheckRequest, CreateSessionRequest, Task
from freerein_orchestrator.envs.episodes import open_session

States = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_MAX_ROWS = 1_000_000
"""Limit of the sim service for one request."""
_MAX_MEASURED_ROWS = 16
"""Rows of a measure in one request: half of what the sim service takes, which is seconds of work."""
_MAX_VALUES = 4_000_000
"""Numbers per request: 32 MB, half of what a message may hold."""


@dataclass(frozen=True)
class TruthSession:
    """A privileged session that judges true states."""

    sim: SyncClient
    id: str

    def holds(self, predicate: str, sequences: Sequence[States], references: Sequence[States] = ()) -> list[Flags]:
        """Returns where a predicate holds in sequences of states.

        Args:
            predicate: Its name.
            sequences: float64 (T, S) each; T may differ.
            references: The states to compare with, float64 (T, S) each; empty for a predicate without a reference.

        Returns:
            bool (T,) per sequence: whether it holds at each timestep, given the sequence up to there.
        """
        found: list[Flags] = []
        for part in _parts(sequences, paired=bool(references)):
            states = sequences[part]
            request = CheckRequest(self.id, predicate, _pad(states), _pad(references[part]) if references else None)
            holds = cast(Flags, self.sim.check(request).holds)
            found += [row[: len(each)] for row, each in zip(holds, states, strict=True)]
        return found

    def values(self, measure: str, states: States, references: States) -> npt.NDArray[np.float64]:
        """Returns a measure of states by references, in its unit, float64 (T,); both are float64 (T, S)."""
        parts = []
        for first in range(0, len(states), _MAX_MEASURED_ROWS):
            rows = slice(first, first + _MAX_MEASURED_ROWS)
            request = CheckRequest(self.id, measure, states[rows][None], references[rows][None])
            parts.append(cast(npt.NDArray[np.float64], self.sim.check(request).values)[0])
        return np.concatenate(parts)


@contextmanager
def truth_session(sim: SyncClient, task: str) -> Iterator[TruthSession]:
    """Yields a privileged session of a task."""
    with open_session(sim, CreateSessionRequest(task, seed=0, privileged=True)) as session:
        yield TruthSession(sim, session)


def check_predicates(task: Task, names: Iterable[str], *, form: str) -> None:
    """Checks that a task offers predicates.

    Raises:
        InvalidInput: It lacks one.
    """
    offered = {predicate.name for predicate in task.predicates}
    if missing := [name for name in names if name not in offered]:
        raise InvalidInput(
            f"An evaluation of the form {form} needs the predicates {', '.join(missing)}; {task.name} offers "
            f"{', '.join(sorted(offered)[:20]) or 'none'}.",
            field="config.task",
            hint="Choose a task of a world that offers them, or another form.",
        )


def _parts(sequences: Sequence[States], *, paired: bool) -> Iterator[slice]:
    """Yields the sequences of each request, so that padded ones, with references if `paired`, exceed no limit."""
    first, length = 0, 0
    for place, states in enumerate(sequences):
        length = max(length, len(states))
        rows = (place + 1 - first) * length
        values = rows * states.shape[1] * (2 if paired else 1)
        if place > first and (rows > _MAX_ROWS or values > _MAX_VALUES):
            yield slice(first, place)
            first, length = place, len(states)
    if len(sequences):
        yield slice(first, len(sequences))


def _pad(sequences: Sequence[States]) -> States:
    """Returns sequences as float64 (N, T, S), each with its last state repeated up to the longest one's length."""
    length = max(map(len, sequences))
    return np.stack([states[np.minimum(np.arange(length), len(states) - 1)] for states in sequences])
