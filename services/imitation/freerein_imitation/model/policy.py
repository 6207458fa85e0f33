"""What all policies share: the spec that `GetSpec` returns, one step's output, and the base of the torch policies."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Generic, Protocol, Self, TypeAlias, TypeGuard, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.config import parse
from freerein.errors import InvalidInput
from freerein.learning.checkpoints import JSON
from freerein.learning.encoders import FrameTensors
from freerein.learning.inputs import InputSpec
from freerein.types.common import ActionSpec, Camera
from freerein.types.imitation import GoalForm
from freerein_imitation.model.known_texts import KnownTexts

CameraFrames: TypeAlias = Mapping[str, npt.NDArray[np.uint8]]
"""By camera: uint8 (N, H, W, C), or (H, W, C) of one timestep."""

LSTMState: TypeAlias = tuple[Tensor, Tensor]
"""Hidden state and cell, float32 (1, B, units) each."""

NEVER_REACHED = 1.0
"""Threshold of a policy that does not predict that a goal is reached; its probability is always 0."""

_CARD_KEY = "control"
_ENCODE_BATCH = 256
_RESTORE = "Fit the model again, or restore its folder from a copy."


@dataclass(frozen=True)
class ControlSpec:
    """The part of a policy's spec that its card holds beside the network's: control rate and goal limits.

    Attributes:
        control_dt_s: Time between two actions, in seconds.
        reached_threshold: A goal counts as reached from this probability on, in [0, 1].
        max_steps_per_goal: Control steps after which a goal is abandoned, unless a request says otherwise.
        max_steps_per_skill: The same for each skill, where they differ; empty otherwise.

    Raises:
        InvalidInput: A number is out of its range.
    """

    control_dt_s: float
    reached_threshold: float
    max_steps_per_goal: int
    max_steps_per_skill: tuple[int, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        limits = (self.max_steps_per_goal, *self.max_steps_per_skill)
        times_are_positive = 0 < self.control_dt_s < math.inf and min(limits) >= 1
        if not (times_are_positive and 0 <= self.reached_threshold <= 1):
            raise InvalidInput(
                "A policy must have `control_dt_s` above 0, `reached_threshold` in [0, 1] and limits of at least 1 "
                "step; it does not.",
                hint=_RESTORE,
            )

    def to_card(self) -> dict[str, JSON]:
        """Returns the entry of a card that `from_card` reads."""
        return {_CARD_KEY: asdict(self)}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> Self:
        """Returns the spec in a card, which is read as untrusted.

        Raises:
            InvalidInput: The card's entry is missing or malformed.
        """
        try:
            return parse(cls, card[_CARD_KEY])
        except (InvalidInput, KeyError, TypeError) as error:
            raise InvalidInput(
                f"A policy's card must hold `{_CARD_KEY}`: rate, threshold and step limit; it does not.", hint=_RESTORE
            ) from error


@dataclass(frozen=True)
class PolicySpec(ControlSpec):
    """Inputs, outputs and limits of a policy.

    Attributes:
        cameras: Cameras of an observation, and of a goal given by images.
        action: The action space.
        goal_form: Form of its goals.
        horizon: K, actions per output.
        skills: Skills that a recipe may name; empty for other goal forms.
        goal_texts: The only texts that a goal may be; empty for others, too.
        training_texts: Texts that it was fitted to, where it follows others, too; empty where that is unknown.
        robot_state_size: S, numbers of the robot's own state; 0 for a policy that takes none.
        recurrent_size: R, numbers of recurrent state.
        predicts_reached: Whether it predicts that a goal is reached.
    """

    cameras: tuple[Camera, ...]
    action: ActionSpec
    goal_form: GoalForm
    horizon: int = 1
    skills: tuple[str, ...] = ()
    goal_texts: tuple[str, ...] = ()
    training_texts: tuple[str, ...] = ()
    robot_state_size: int = 0
    recurrent_size: int = 0
    predicts_reached: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.max_steps_per_skill) not in (0, len(self.skills)):
            raise InvalidInput(
                f"A policy must have as many step limits as skills, or none; got {len(self.max_steps_per_skill)} "
                f"limits and {len(self.skills)} skills.",
                hint=_RESTORE,
            )

    @cached_property
    def known_texts(self) -> KnownTexts:
        """Reads goal texts as the policy's training has them."""
        return KnownTexts(self.goal_texts or self.training_texts)

    def step_limit(self, goal: object) -> int:
        """Returns the control steps after which a goal, such as the name of a skill, is abandoned."""
        limited = self.max_steps_per_skill and goal in self.skills
        return self.max_steps_per_skill[self.skills.index(str(goal))] if limited else self.max_steps_per_goal


@dataclass(frozen=True, eq=False)
class PolicyOutput:
    """Output of a policy for B observations.

    Attributes:
        actions: The next actions, float32 (B, K, A) in [-1, 1], or int64 (B, K, 1) when discrete.
        reached: Probability that each observation is at its goal, float32 (B,).
        recurrent: Recurrent state after this step, float32 (B, R).
        in_distribution: How much each observation is like held-out ones, float32 (B,) in [0, 1]; see
            `freerein.learning.in_distribution`.
    """

    actions: npt.NDArray[Any]
    reached: npt.NDArray[np.float32]
    recurrent: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]


class Policy(Protocol):
    """A trained policy: numpy in, numpy out."""

    @property
    def spec(self) -> PolicySpec:
        """Inputs, outputs and limits."""

    def encode_goals(self, goals: Any) -> npt.NDArray[np.float32]:
        """Returns goal embeddings, float32 (N, G), of goal images (`CameraFrames`), or of skill names or texts."""

    def step(
        self,
        frames: CameraFrames,
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
    ) -> PolicyOutput:
        """Returns actions, the probability that the goal is reached, and the in-distribution score.

        Args:
            frames: By camera, uint8 (B, H, W, C).
            goals: Goal embeddings, float32 (B, G).
            previous: Actions executed last, float32 (B, A) or int64 (B, 1); `ActionSpec.no_action` for none.
            recurrent: Recurrent state, float32 (B, R); zeros at the start of a goal.
        """


@runtime_checkable
class TimedPolicy(Protocol):
    """A policy whose recurrent state depends on how many control steps there are between two observations."""

    def skip_steps(self, recurrent: npt.NDArray[np.float32], steps: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns recurrent states after control steps without an observation, float32 (B, R).

        `Policy.step` takes its observations for those of consecutive control steps.

        Args:
            recurrent: Recurrent states, float32 (B, R).
            steps: Control steps without an observation, int64 (B,); with 0 a state stays as it is.
        """


@runtime_checkable
class RememberingPolicy(Protocol):
    """A policy whose recurrent state tells of the robot, too, and outlasts a goal; that of others begins with zeros."""

    def forget_goal(self, recurrent: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Returns recurrent states, float32 (B, R), without what was of the goal: what the next one begins with."""


class RobotStatePolicy(Policy, Protocol):
    """A policy that also takes the robot's own state."""

    def step(
        self,
        frames: CameraFrames,
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
        robot_state: npt.NDArray[np.float32] | None = None,
    ) -> PolicyOutput:
        """Returns the output for B observations.

        Arguments are as in `Policy.step`, and `robot_state`, float32 (B, S), which is needed where S is not 0.
        """


def takes_robot_state(policy: Policy) -> TypeGuard[RobotStatePolicy]:
    """Returns whether a policy takes the robot's own state."""
    return policy.spec.robot_state_size > 0


N = TypeVar("N", bound=nn.Module)


class TorchPolicy(Generic[N]):
    """Base of policies that are torch networks.

    Args:
        network: Trained; its device is where the policy computes.
        inputs: The network's spec.
        control: Rate and limits, as on the card.
        goal_form: Form of its goals.
        fields: Further fields of the policy's spec.

    Attributes:
        spec: Inputs, outputs and limits.
    """

    def __init__(
        self, network: N, inputs: InputSpec, control: ControlSpec, *, goal_form: GoalForm, **fields: Any
    ) -> None:
        self.spec = PolicySpec(
            **vars(control), cameras=inputs.cameras, action=inputs.action, goal_form=goal_form, **fields
        )
        self._network = network.eval()
        self._device = next(network.parameters()).device

    def _tensor(self, array: npt.NDArray[Any]) -> Tensor:
        """Returns a copy on the network's device; arrays from the wire are read-only."""
        return torch.tensor(array, device=self._device)

    def _tensors(self, frames: CameraFrames) -> FrameTensors:
        return {camera: self._tensor(each) for camera, each in frames.items()}

    def _encode_images(self, encode: Callable[[FrameTensors], Tensor], images: CameraFrames) -> npt.NDArray[np.float32]:
        """Returns the codes of images by camera, uint8 (N, H, W, C), some at a time: float32 (N, code size)."""
        count = len(next(iter(images.values())))
        batches = [slice(start, start + _ENCODE_BATCH) for start in range(0, count, _ENCODE_BATCH)]
        parts = [encode(self._tensors({name: each[batch] for name, each in images.items()})) for batch in batches]
        codes: npt.NDArray[np.float32] = torch.cat(parts).cpu().numpy()
        return codes


def confidence(reached: Tensor) -> Tensor:
    """Returns the probability of the likelier of reached and not reached, float32 (N,), of that of reached (N,)."""
    return torch.maximum(reached, 1 - reached)


def one_hot_skills(skills: Sequence[str], names: Sequence[str]) -> npt.NDArray[np.float32]:
    """Returns one-hot codes of skill names, float32 (N, skills).

    Raises:
        InvalidInput: A name is not among `skills`.
    """
    unknown = sum(name not in skills for name in names)
    if unknown:
        raise InvalidInput(
            f"Skills must be among {', '.join(skills)}; {unknown} of {len(names)} are not.",
            field="goal",
            hint="GetSpec lists a model's skills.",
        )
    return np.eye(len(skills), dtype=np.float32)[[skills.index(name) for name in names]]


def lstm_state(recurrent: Tensor) -> LSTMState:
    """Returns hidden state and cell of recurrent states, float32 (B, R), R twice the units."""
    hidden, cell = recurrent[None].chunk(2, dim=2)
    return hidden.contiguous(), cell.contiguous()


def flat_lstm_state(state: LSTMState) -> Tensor:
    """Returns an LSTM's hidden state and cell as recurrent states, float32 (B, R)."""
    return torch.cat(state, dim=2)[0]
