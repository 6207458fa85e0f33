"""One step of a policy as a function of tensors, with all that the service does to frames before the network.

Inputs and outputs are named as the fields of `ActRequest` and `ActResponse`; a batch is their first dimension.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from freerein.learning.encoders import FrameTensors
from freerein_imitation.model.torch_policy import StepInputs, TorchPolicy

_FRAME, _GOAL_FRAME = "observation.images.", "goal.images."


@dataclass(frozen=True)
class Port:
    """An input or output of a graph.

    Attributes:
        name: Its name.
        dtype: Its type, as numpy names it.
        shape: Its shape without the batch.
        meaning: Its contents.
        start: Each number of an input at the first step, where the caller has none.
    """

    name: str
    dtype: str
    shape: tuple[int, ...]
    meaning: str
    start: int = 0


class PolicyGraph(nn.Module):
    """A step of a policy.

    Args:
        policy: The policy, on the CPU.
        goals: Texts, or names of skills, that may be goals, whose codes are part of the graph; empty for goal images.

    Attributes:
        goals: The goals.
        inputs: Inputs, in order.
        outputs: Outputs, in order.
    """

    codes: Tensor

    def __init__(self, policy: TorchPolicy[Any], goals: Sequence[str]) -> None:
        super().__init__()
        self.goals = tuple(goals)
        self._policy, self.network = policy, policy.network
        if goals:
            self.register_buffer("codes", torch.tensor(policy.encode_goals(self.goals)))  # (goals, G)
        self.inputs, self.outputs = tuple(self._inputs()), tuple(self._outputs())

    def forward(self, *values: Tensor) -> tuple[Tensor, ...]:
        """Returns the outputs, in order, for the inputs in order."""
        spec, given = self._policy.spec, dict(zip((each.name for each in self.inputs), values, strict=True))
        executed = given["executed_actions"]
        state = given.get("state", torch.zeros(executed.shape[0], 0))
        inputs = StepInputs(
            self._frames(given, _FRAME),
            self._goals(given),
            executed,
            state,
            given.get("observation.state"),
            given.get("draws"),
        )
        step, in_distribution = self._policy.step_tensors(inputs)
        reached = step.reached >= spec.reached_threshold
        found = {
            "actions": step.actions,
            "in_distribution": in_distribution,
            "goal_confidence": step.reached,
            "goal_reached": reached if step.settled is None else reached & step.settled,
            "next_state": step.recurrent,
        }
        return tuple(found[each.name] for each in self.outputs)

    def _frames(self, given: dict[str, Tensor], kind: str) -> FrameTensors:
        return {camera.name: given[kind + camera.name] for camera in self._policy.spec.cameras}

    def _goals(self, given: dict[str, Tensor]) -> Tensor:
        """Returns goal embeddings, float32 (B, G)."""
        if not self.goals:
            return self._policy.encode_images(self._frames(given, _GOAL_FRAME))
        if "goal" in given:
            return self.codes[given["goal"]]
        return self.codes.expand(given["executed_actions"].shape[0], -1)

    def _inputs(self) -> Iterator[Port]:
        spec, action = self._policy.spec, self._policy.spec.action
        for kind, what in ((_FRAME, "frame"), (_GOAL_FRAME, "goal image"))[: 1 if self.goals else 2]:
            for camera in spec.cameras:
                shape = (camera.height, camera.width, camera.channels)
                yield Port(kind + camera.name, "uint8", shape, f"{what} of the camera, RGB or gray, 0 to 255")
        if len(self.goals) > 1:
            yield Port("goal", "int64", (), "index of the goal in `goals`")
        if spec.robot_state_size:
            meaning = "the robot's own state, as in the dataset"
            yield Port("observation.state", "float32", (spec.robot_state_size,), meaning)
        none = int(action.no_action()[0])
        meaning = f"the action executed last, whatever was proposed; {none} for none"
        yield Port("executed_actions", str(action.dtype), (action.size,), meaning, none)
        if spec.recurrent_size:
            meaning = "`next_state` of the step before; 0 where a goal begins"
            yield Port("state", "float32", (spec.recurrent_size,), meaning)
        if spec.draws:
            meaning = "random numbers in [0, 1) by which actions are drawn; the service takes them from a hash"
            yield Port("draws", "float64", (spec.draws,), meaning)

    def _outputs(self) -> Iterator[Port]:
        spec, action = self._policy.spec, self._policy.spec.action
        meaning = f"actions of the next control steps, {'a choice each' if action.choices else 'in [-1, 1]'}"
        yield Port("actions", str(action.dtype), (spec.horizon, action.size), meaning)
        yield Port("in_distribution", "float32", (), "how much the observation is like held-out ones, in [0, 1]")
        if spec.predicts_reached:
            yield Port("goal_confidence", "float32", (), "probability that the observation reaches the goal")
            yield Port("goal_reached", "bool", (), "whether the goal is reached: do not execute the actions")
        if spec.recurrent_size:
            yield Port("next_state", "float32", (spec.recurrent_size,), "`state` of the next step")
