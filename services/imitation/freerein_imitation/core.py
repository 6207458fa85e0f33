"""`Actor`: an observation and a goal in, actions and a goal-reached flag out. Nothing is kept between calls."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.serving.batcher import Batcher, BatchResult
from freerein.serving.model_cache import ModelCache
from freerein.types.common import Camera, Goal, ModelRef, Observation, Timing
from freerein.types.imitation import ActRequest, ActResponse, GetSpecRequest, GetSpecResponse
from freerein_imitation import memory as memories
from freerein_imitation.acting import Answer, Item, Policy, Target
from freerein_imitation.memory import Memory
from freerein_imitation.observing import GOAL_FORMS, digest_of, elapsed_steps, read_frame, read_goal, read_previous

Models = ModelCache[Policy]
Acting = Batcher[Item, Answer]


class Actor:
    """The core of the imitation service, but for its control streams.

    Args:
        models: The policies.
        batcher: Runs `BatchActor.act_batch` on the model's thread.
        timeout_s: How long an observation may wait for the model, in seconds.
    """

    def __init__(self, models: Models, batcher: Acting, *, timeout_s: float) -> None:
        self._models = models
        self._batcher = batcher
        self._timeout_s = timeout_s

    async def get_spec(self, request: GetSpecRequest) -> GetSpecResponse:
        """Returns what a model wants to see and what its actions mean.

        Raises:
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        return spec_of(*await self._models.resolve(request.model))

    async def act(self, request: ActRequest) -> ActResponse:
        """Judges an observation against the goal that is pursued, and returns the next actions.

        Raises:
            InvalidInput: The observation, the goal, what was executed or the state is not what the model knows.
            NotFound: There is no such model.
            FailedPrecondition: None is active, or the state is of another model or goal.
        """
        begun_ns = time.perf_counter_ns()
        model, policy = await self._models.resolve(request.model)
        pursuit = await pursue(model, policy, request.goal, max_steps=request.max_steps_per_goal)
        memory = pursuit.recall(request.state)
        elapsed = elapsed_steps(request.executed_actions) if request.state else 0
        item = await pursuit.item(request.observation, request.executed_actions, memory, elapsed=elapsed)
        decode_ns = time.perf_counter_ns() - begun_ns
        done = await self._batcher.submit(item, key=model, timeout_s=self._timeout_s)
        answer = done.output
        return ActResponse(
            actions=answer.actions,
            goal_reached=answer.reached,
            goal_confidence=answer.confidence,
            goal_index=answer.memory.goal_index,
            goal_abandoned=answer.memory.abandoned,
            state=pursuit.state(answer.memory),
            model=model,
            timing=timing(begun_ns, decode_ns, done),
        )


@dataclass(frozen=True, eq=False)
class Pursuit:
    """Who pursues what, from the first observation to the last.

    Attributes:
        model: The policy's name and version.
        policy: Who acts.
        targets: The goals, in the order in which they are to be reached.
        digest: Tells them from others.
        max_steps: Control steps after which a goal is given up.
    """

    model: ModelRef
    policy: Policy
    targets: tuple[Target, ...]
    digest: bytes
    max_steps: int

    def recall(self, state: bytes) -> Memory:
        """Returns what a `state` remembers; of an empty one, nothing.

        Raises:
            InvalidInput: It is none of ours, or damaged.
            FailedPrecondition: It is of another model or goal.
        """
        size = self.policy.memory_size
        if not state:
            return Memory(np.zeros(size, np.float32))
        return memories.load(state, version=self.model.version, goal=self.digest, goals=len(self.targets), size=size)

    def state(self, memory: Memory) -> bytes:
        """Returns a memory as the `state` that brings it back."""
        return memories.save(memory, version=self.model.version, goal=self.digest)

    async def item(
        self, observation: Observation, executed: npt.NDArray[Any] | None, memory: Memory, *, elapsed: int
    ) -> Item:
        """Returns an observation for the batcher.

        Args:
            observation: What the robot sees.
            executed: What it executed since the observation before, (N, A), or None.
            memory: What the policy has in mind.
            elapsed: Control steps since the observation that it remembers.

        Raises:
            InvalidInput: One of the two is not what the policy knows.
            UnsupportedMedia: An image is not in the encoding that it names.
        """
        return Item(
            policy=self.policy,
            version=self.model.version,
            targets=self.targets,
            frame=await read_frame(self.policy, observation),
            previous=read_previous(self.policy, executed),
            memory=memory,
            elapsed=elapsed,
            max_steps=self.max_steps,
        )


async def pursue(model: ModelRef, policy: Policy, goal: Goal, *, max_steps: int) -> Pursuit:
    """Returns the pursuit of a goal.

    Args:
        model: The policy's name and version.
        policy: Who acts.
        goal: What is to be achieved.
        max_steps: Control steps after which a goal is given up; 0 for the model's own number.

    Raises:
        InvalidInput: The goal is not one that the policy knows.
        UnsupportedMedia: An image is not in the encoding that it names.
    """
    targets = await read_goal(policy, goal)
    return Pursuit(model, policy, targets, digest_of(targets), max_steps or policy.max_steps_per_goal)


def spec_of(model: ModelRef, policy: Policy) -> GetSpecResponse:
    """Returns what a policy wants to see and what its actions mean."""
    return GetSpecResponse(
        model=model,
        cameras=(Camera(policy.camera, policy.height, policy.width, policy.channels),),
        action=policy.action,
        horizon=policy.horizon,
        control_dt_s=policy.control_dt_s,
        goal_form=GOAL_FORMS[policy.kind],
        skills=policy.skills,
        max_steps_per_goal=policy.max_steps_per_goal,
        reached_threshold=policy.reached_threshold,
    )


def timing(begun_ns: int, decode_ns: int, done: BatchResult[Answer]) -> Timing:
    """Returns where the time of an answer went, now that it is there.

    Args:
        begun_ns: When its observation came, on the clock of `time.perf_counter_ns`.
        decode_ns: How long it took to make arrays of it.
        done: What the batcher returned for it.
    """
    total_ns = time.perf_counter_ns() - begun_ns
    return Timing(
        queue_ns=total_ns - decode_ns - done.infer_ns,
        decode_ns=decode_ns,
        infer_ns=done.infer_ns,
        total_ns=total_ns,
        batch_size=done.batch_size,
    )
