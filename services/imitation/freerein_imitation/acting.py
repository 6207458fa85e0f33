"""What policies do with a batch of observations: judge each against the goal it pursues, then act for the next one.

Each observation is judged once. Where it reaches its goal, or the goal's time is up, the goal is done with: the memory
is emptied, and a second pass acts for the goal that follows.
"""

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from freerein.errors import OutputNotFinite, ServiceError
from freerein.types.common import ActionSpec
from freerein_imitation.memory import Memory

Content = npt.NDArray[np.uint8] | str
"""One goal: an image (H, W, C), the name of a skill, or a sentence."""

_CODES_BYTES = 32 * 2**20


class Step(Protocol):
    """What a policy makes of B observations."""

    @property
    def actions(self) -> npt.NDArray[Any]:
        """The next K actions, float32 (B, K, A) in [-1, 1] or int64 (B, K, 1)."""

    @property
    def reached(self) -> npt.NDArray[np.float32]:
        """The probabilities that the goals are reached, float32 (B,)."""

    @property
    def memory(self) -> npt.NDArray[np.float32]:
        """What to bring along with the next observation, float32 (B, M)."""


class Policy(Protocol):
    """A trained policy, as the core knows it.

    Attributes:
        camera: Which camera it sees through.
        height: Of the frames it was trained on, in pixels.
        width: In pixels.
        channels: 1 or 3.
        action: What an action is.
        action_size: Numbers per action.
        action_choices: How many different actions there are when discrete, else 0.
        horizon: K, actions per answer.
        control_dt_s: Time between two actions, in seconds.
        skills: The skills that it can execute; none where goals are of another form.
        memory_size: M, numbers that it remembers.
        reached_threshold: A goal counts as reached from this probability on.
        max_steps_per_goal: Control steps after which a goal is given up, unless a request says otherwise.
    """

    camera: str
    height: int
    width: int
    channels: int
    action: ActionSpec
    action_size: int
    action_choices: int
    horizon: int
    control_dt_s: float
    skills: tuple[str, ...]
    memory_size: int
    reached_threshold: float
    max_steps_per_goal: int

    @property
    def kind(self) -> Literal["goal_conditioned", "skills", "language"]:
        """Whether its goals are images, skills or a sentence, of which it cannot tell when it is done."""

    def encode_goals(self, goals: Any) -> npt.NDArray[np.float32]:
        """Returns codes, float32 (N, G), of goal images, uint8 (N, H, W, C), or of a sequence of skills or texts."""

    def step(
        self,
        frames: npt.NDArray[np.uint8],
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        memory: npt.NDArray[np.float32],
    ) -> Step:
        """Judges observations, and acts.

        Args:
            frames: uint8 (B, H, W, C).
            goals: Codes, float32 (B, G).
            previous: The actions executed last, float32 (B, A), zeros for none, or int64 (B, 1), -1 for none.
            memory: float32 (B, M), zeros where a goal begins.
        """


@dataclass(frozen=True, eq=False)
class Target:
    """One goal of those that are to be reached one after the other.

    Attributes:
        digest: Tells its content from others.
        content: What it is.
    """

    digest: bytes
    content: Content


@dataclass(frozen=True, eq=False)
class Item:
    """One observation, and all that is needed to act on it.

    Attributes:
        policy: Who acts.
        version: The policy's.
        targets: The goals, at least one.
        frame: uint8 (H, W, C), what is seen.
        previous: float32 (A,) or int64 (1,), the action executed last.
        memory: What the policy has in mind.
        elapsed: Control steps since the observation that it remembers.
        max_steps: Control steps after which a goal is given up.
    """

    policy: Policy
    version: str
    targets: tuple[Target, ...]
    frame: npt.NDArray[np.uint8]
    previous: npt.NDArray[Any]
    memory: Memory
    elapsed: int
    max_steps: int

    @property
    def target(self) -> Target:
        """The goal that is pursued; the last one when all are done with."""
        return self.targets[min(self.memory.goal_index, len(self.targets) - 1)]


@dataclass(frozen=True, eq=False)
class Answer:
    """What to do next.

    Attributes:
        actions: float32 (K, A) or int64 (K, 1); K = 0 when all goals are done with.
        reached: Whether every goal is reached; None where the policy cannot tell.
        confidence: The probability that the observation reaches the goal that was pursued.
        memory: What to have in mind.
    """

    actions: npt.NDArray[Any]
    reached: bool | None
    confidence: float
    memory: Memory


class _Row(NamedTuple):
    """A policy's step for one item: actions (K, A), P(reached), hidden (M,)."""

    actions: npt.NDArray[Any]
    reached: float
    hidden: npt.NDArray[np.float32]


class BatchActor:
    """Acts on batches. It remembers the codes of the goals used last, whose images come with every unary call.

    Args:
        codes_bytes: How many bytes of codes to remember.
    """

    def __init__(self, *, codes_bytes: int = _CODES_BYTES) -> None:
        self._codes: OrderedDict[tuple[str, bytes], npt.NDArray[np.float32]] = OrderedDict()
        self._codes_bytes = codes_bytes
        self._held_bytes = 0

    def act_batch(self, items: Sequence[Item]) -> list[Answer | ServiceError]:
        """Returns for each observation what to do next, or why the policy has no answer. All have one policy."""
        judged = self._step(items)
        memories = [_judge(item, row) for item, row in zip(items, judged, strict=True)]
        acted = list(judged)
        if going_on := [i for i, item in enumerate(items) if _goes_on(item, memories[i])]:
            rows = self._step([replace(items[i], memory=memories[i]) for i in going_on])
            for i, row in zip(going_on, rows, strict=True):
                acted[i] = row
        return [_answer(*each) for each in zip(items, judged, acted, memories, strict=True)]

    def _step(self, items: Sequence[Item]) -> list[_Row | OutputNotFinite]:
        """Returns what the policy makes of each item's observation and the goal that it pursues."""
        policy = items[0].policy
        step = policy.step(
            _stack([item.frame for item in items]),
            self._codes_of(items),
            _stack([item.previous for item in items]),
            _stack([item.memory.hidden for item in items]),
        )
        _check_shapes(policy, step, len(items))
        finite = _finite(step)
        return [
            _Row(step.actions[i], float(step.reached[i]), step.memory[i]) if finite[i] else _not_finite()
            for i in range(len(items))
        ]

    def _codes_of(self, items: Sequence[Item]) -> npt.NDArray[np.float32]:
        """Returns the codes of the goals that items pursue, (B, G)."""
        keys = [(item.version, item.target.digest) for item in items]
        if missing := {
            key: item.target.content for key, item in zip(keys, items, strict=True) if key not in self._codes
        }:
            codes = items[0].policy.encode_goals(_together(list(missing.values())))
            self._codes.update({key: code.copy() for key, code in zip(missing, codes, strict=True)})
            self._held_bytes += codes.nbytes
        for key in keys:
            self._codes.move_to_end(key)
        found = [self._codes[key] for key in keys]
        while self._held_bytes > self._codes_bytes:
            self._held_bytes -= self._codes.popitem(last=False)[1].nbytes
        return _stack(found)


def _stack(arrays: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Returns arrays along a new first axis; a single one, as most often, is not copied."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def _together(contents: list[Content]) -> npt.NDArray[np.uint8] | list[str]:
    words = [content for content in contents if isinstance(content, str)]
    return words or np.stack([content for content in contents if not isinstance(content, str)])


def _check_shapes(policy: Policy, step: Step, items: int) -> None:
    expected = ((items, policy.horizon, policy.action_size), (items,), (items, policy.memory_size))
    got = (step.actions.shape, step.reached.shape, step.memory.shape)
    if got != expected:
        raise ValueError(f"the policy answered {got} where {expected} is due")


def _finite(step: Step) -> Sequence[bool]:
    """Tells of each item whether all that the policy made of it is finite."""
    actions, reached, memory = step.actions, step.reached, step.memory
    if math.isfinite(np.vdot(actions, actions) + np.vdot(reached, reached) + np.vdot(memory, memory)):
        return [True] * len(reached)  # all are: a sum of squares takes a third of the time of looking at each number
    finite = np.isfinite(actions).all(axis=(1, 2)) & np.isfinite(reached) & np.isfinite(memory).all(axis=1)
    return [bool(each) for each in finite]


def _not_finite() -> OutputNotFinite:
    return OutputNotFinite(
        "The policy's output must be finite; it overflowed on this observation.",
        field="observation",
        hint="Begin anew without a state; if it stays so, report it.",
    )


def _judge(item: Item, row: _Row | OutputNotFinite) -> Memory:
    """Returns what to have in mind after an observation was judged: a new goal begins with an empty memory."""
    memory = item.memory
    if isinstance(row, OutputNotFinite):
        return memory
    if memory.goal_index == len(item.targets):
        return replace(memory, hidden=row.hidden)
    steps = memory.steps + item.elapsed
    reached = row.reached >= item.policy.reached_threshold
    if reached or steps >= item.max_steps:
        return Memory(np.zeros_like(memory.hidden), memory.goal_index + 1, 0, memory.abandoned or not reached)
    return Memory(row.hidden, memory.goal_index, steps, memory.abandoned)


def _goes_on(item: Item, memory: Memory) -> bool:
    """Tells whether another goal follows the one that was just done with."""
    return item.memory.goal_index < memory.goal_index < len(item.targets)


def _answer(
    item: Item, judged: _Row | OutputNotFinite, acted: _Row | OutputNotFinite, memory: Memory
) -> Answer | ServiceError:
    if isinstance(judged, OutputNotFinite) or isinstance(acted, OutputNotFinite):
        return _not_finite()
    is_done, can_tell = memory.goal_index == len(item.targets), item.policy.kind != "language"
    reached = is_done and not memory.abandoned if can_tell else None
    if is_done:
        return Answer(acted.actions[:0], reached, judged.reached, memory)
    if acted is not judged:
        memory = replace(memory, hidden=acted.hidden)
    return Answer(acted.actions, reached, judged.reached, memory)
