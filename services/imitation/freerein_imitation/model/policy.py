"""What all policies share: the spec that `GetSpec` returns, one step's output, and the base of the torch policies."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.errors import InvalidInput
from freerein.learning.checkpoints import JSON
from freerein.learning.config import bounded
from freerein.types.common import ActionSpec
from freerein.types.imitation import GoalForm

_CARD_KEY = "control"


@dataclass(frozen=True, kw_only=True)
class PolicyNetworkSpec:
    """Frame and action sizes of a policy network; each network's spec adds its layer sizes.

    Attributes:
        camera: Name of the camera whose frames are the input.
        action_size: Numbers per action.
        action_choices: Number of discrete actions; 0 for continuous ones.
        height: Frame height in pixels.
        width: Frame width in pixels.
        channels: 1 or 3.

    Raises:
        InvalidInput: There are 2 channels.
    """

    camera: str
    action_size: int = bounded(1, least=1, most=256)
    action_choices: int = bounded(0, least=0, most=4096)
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    channels: int = bounded(3, least=1, most=3)

    def __post_init__(self) -> None:
        if self.channels == 2:
            raise InvalidInput("Frames must have 1 or 3 channels; got 2.", hint="Store frames as gray or RGB.")

    @property
    def flat_action_size(self) -> int:
        """Numbers of an action as a network takes it: its one-hot code when discrete, else its values."""
        return self.action_choices or self.action_size


@dataclass(frozen=True)
class ControlSpec:
    """The part of a policy's spec that its card holds beside the network's: actions, control rate, goal limits.

    Attributes:
        action: Meaning of an action.
        control_dt_s: Time between two actions, in seconds.
        reached_threshold: A goal counts as reached from this probability on, in [0, 1].
        max_steps_per_goal: Control steps after which a goal is abandoned, unless a request says otherwise.

    Raises:
        InvalidInput: A number is out of its range.
    """

    action: ActionSpec
    control_dt_s: float
    reached_threshold: float
    max_steps_per_goal: int

    def __post_init__(self) -> None:
        times_are_positive = 0 < self.control_dt_s < math.inf and self.max_steps_per_goal >= 1
        if not (times_are_positive and 0 <= self.reached_threshold <= 1 and self.action.size >= 1):
            raise InvalidInput(
                "A policy must have actions of at least 1 number, `control_dt_s` above 0, `reached_threshold` in "
                "[0, 1] and `max_steps_per_goal` of at least 1; it does not.",
                hint="Fit the model again, or restore its folder from a copy.",
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
            values = card[_CARD_KEY]
            action = values["action"]
            return cls(
                action=ActionSpec(
                    size=int(action["size"]),
                    choices=int(action["choices"]),
                    names=tuple(str(name) for name in action["names"]),
                    unit=str(action["unit"]),
                    scale=tuple(float(number) for number in action["scale"]),
                ),
                control_dt_s=float(values["control_dt_s"]),
                reached_threshold=float(values["reached_threshold"]),
                max_steps_per_goal=int(values["max_steps_per_goal"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(
                f"A policy's card must hold `{_CARD_KEY}`: action, rate and threshold; it does not.",
                hint="Fit the model again, or restore its folder from a copy.",
            ) from error


@dataclass(frozen=True)
class PolicySpec(ControlSpec):
    """Inputs, outputs and limits of a policy.

    Attributes:
        goal_form: Form of its goals.
        camera: Name of the camera it was trained on.
        height: Frame height in pixels.
        width: Frame width in pixels.
        channels: 1 or 3.
        horizon: K, actions per output.
        skills: Skills that a recipe may name; empty for other goal forms.
        recurrent_size: R, numbers of recurrent state.
        predicts_reached: Whether it predicts that a goal is reached.
    """

    goal_form: GoalForm
    camera: str
    height: int
    width: int
    channels: int
    horizon: int = 1
    skills: tuple[str, ...] = ()
    recurrent_size: int = 0
    predicts_reached: bool = True

    def no_action(self) -> npt.NDArray[Any]:
        """Returns the previous action at the start: zeros, float32 (A,), or for discrete actions -1, int64 (1,)."""
        if self.action.choices:
            return np.full(self.action.size, -1, np.int64)
        return np.zeros(self.action.size, np.float32)


@dataclass(frozen=True, eq=False)
class PolicyOutput:
    """Output of a policy for B observations.

    Attributes:
        actions: The next actions, float32 (B, K, A) in [-1, 1], or int64 (B, K, 1) when discrete.
        reached: Probability that each observation is at its goal, float32 (B,).
        recurrent: Recurrent state after this step, float32 (B, R).
    """

    actions: npt.NDArray[Any]
    reached: npt.NDArray[np.float32]
    recurrent: npt.NDArray[np.float32]


class Policy(Protocol):
    """A trained policy: numpy in, numpy out."""

    @property
    def spec(self) -> PolicySpec:
        """Inputs, outputs and limits."""

    def encode_goals(self, goals: Any) -> npt.NDArray[np.float32]:
        """Returns goal embeddings, float32 (N, G), of goal images, uint8 (N, H, W, C), or of skill names or texts."""

    def step(
        self,
        frames: npt.NDArray[np.uint8],
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
    ) -> PolicyOutput:
        """Returns actions and the probability that the goal is reached.

        Args:
            frames: uint8 (B, H, W, C).
            goals: Goal embeddings, float32 (B, G).
            previous: Actions executed last, float32 (B, A) or int64 (B, 1); `PolicySpec.no_action` for none.
            recurrent: Recurrent state, float32 (B, R); zeros at the start of a goal.
        """


N = TypeVar("N", bound=nn.Module)


class TorchPolicy(Generic[N]):
    """Base of policies that are torch networks.

    Args:
        network: Trained; its device is where the policy computes.
        sizes: The network's spec.
        control: Actions, rate and limits, as on the card.
        goal_form: Form of its goals.
        fields: Further fields of the policy's spec.

    Attributes:
        spec: Inputs, outputs and limits.

    Raises:
        InvalidInput: Network and card have different actions.
    """

    def __init__(
        self, network: N, sizes: PolicyNetworkSpec, control: ControlSpec, *, goal_form: GoalForm, **fields: Any
    ) -> None:
        action = control.action
        if (action.size, action.choices) != (sizes.action_size, sizes.action_choices):
            raise InvalidInput(
                f"A policy's card must describe its network's actions, size {sizes.action_size} and "
                f"{sizes.action_choices} choices; got size {action.size} and {action.choices} choices.",
                hint="Fit the model again, or restore its folder from a copy.",
            )
        frame: dict[str, Any] = {
            "camera": sizes.camera,
            "height": sizes.height,
            "width": sizes.width,
            "channels": sizes.channels,
        }
        self.spec = PolicySpec(**vars(control), **frame, goal_form=goal_form, **fields)
        self._network = network.eval()
        self._device = next(network.parameters()).device

    def _tensor(self, array: npt.NDArray[Any]) -> Tensor:
        """Returns a copy on the network's device; arrays from the wire are read-only."""
        return torch.tensor(array, device=self._device)

    def _lstm_state(self, recurrent: npt.NDArray[np.float32]) -> tuple[Tensor, Tensor]:
        """Returns hidden state and cell, (1, B, R / 2) each, of recurrent states (B, R)."""
        hidden, cell = self._tensor(recurrent)[None].chunk(2, dim=2)
        return hidden.contiguous(), cell.contiguous()


def flat_lstm_state(state: tuple[Tensor, Tensor]) -> npt.NDArray[np.float32]:
    """Returns an LSTM's hidden state and cell as recurrent states, float32 (B, R)."""
    flat: npt.NDArray[np.float32] = torch.cat(state, dim=2)[0].cpu().numpy()
    return flat
