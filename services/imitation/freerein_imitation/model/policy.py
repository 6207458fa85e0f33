"""The protocol of a policy: the spec that `GetSpec` returns, and one step."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.config import parse
from freerein.errors import InvalidInput, quoted
from freerein.learning.checkpoints import JSON
from freerein.types.common import ActionSpec, Camera
from freerein.types.imitation import GoalForm
from freerein_imitation.model.known_texts import KnownTexts

CameraFrames: TypeAlias = Mapping[str, npt.NDArray[np.uint8]]
"""By camera: uint8 (N, H, W, C), or (H, W, C) of one timestep."""

NEVER_REACHED = 1.0
"""Threshold of a policy that does not predict that a goal is reached; its probability is always 0."""

_CARD_KEY = "control"
RESTORE = "Fit the model again, or restore its folder from a copy."


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
                f"step; got {self.control_dt_s:g}, {self.reached_threshold:g} and {min(limits)}.",
                hint=RESTORE,
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
                f"A policy's card must hold `{_CARD_KEY}`: rate, threshold and step limit; reading it failed: "
                f"{quoted(repr(error))}.",
                hint=RESTORE,
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
        objects: Noun phrases that goals may relate beside those of the training texts.
        unseen_objects: Whether goals may relate any others.
        robot_state_size: S, numbers of the robot's own state; 0 for a policy that takes none.
        recurrent_size: R, numbers of recurrent state.
        recurrent_pixels: How many of the last of them are pixels of earlier frames, whole numbers of 0 to 255; `state`
            has a byte for each.
        predicts_reached: Whether it predicts that a goal is reached.
        draws: U, uniform numbers that its actions are sampled by; 0 for a policy whose actions are not.
    """

    cameras: tuple[Camera, ...]
    action: ActionSpec
    goal_form: GoalForm
    horizon: int = 1
    skills: tuple[str, ...] = ()
    goal_texts: tuple[str, ...] = ()
    training_texts: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    unseen_objects: bool = False
    robot_state_size: int = 0
    recurrent_size: int = 0
    recurrent_pixels: int = 0
    predicts_reached: bool = True
    draws: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.max_steps_per_skill) not in (0, len(self.skills)):
            raise InvalidInput(
                f"A policy must have as many step limits as skills, or none; got {len(self.max_steps_per_skill)} "
                f"limits and {len(self.skills)} skills.",
                hint=RESTORE,
            )

    @cached_property
    def known_texts(self) -> KnownTexts:
        """Reads goal texts as the policy's training has them."""
        texts = self.goal_texts or self.training_texts
        return KnownTexts(texts, objects=self.objects, any_object=self.unseen_objects)

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
        settled: Whether a goal that is probably reached has been so for long enough to count, bool (B,); None where one
            observation is enough.
    """

    actions: npt.NDArray[Any]
    reached: npt.NDArray[np.float32]
    recurrent: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]
    settled: npt.NDArray[np.bool_] | None = None


class Policy(ABC):
    """A trained policy: numpy in, numpy out.

    Attributes:
        spec: Inputs, outputs and limits.
    """

    spec: PolicySpec

    @abstractmethod
    def encode_goals(self, goals: Any) -> npt.NDArray[np.float32]:
        """Returns goal embeddings, float32 (N, G), of goal images (`CameraFrames`), or of skill names or texts."""

    @abstractmethod
    def step(
        self,
        frames: CameraFrames,
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
        robot_state: npt.NDArray[np.float32] | None = None,
        *,
        draws: npt.NDArray[np.float64] | None = None,
    ) -> PolicyOutput:
        """Returns actions, the probability that the goal is reached, and the in-distribution score.

        Args:
            frames: By camera, uint8 (B, H, W, C).
            goals: Goal embeddings, float32 (B, G).
            previous: Actions executed last, float32 (B, A) or int64 (B, 1); `ActionSpec.no_action` for none.
            recurrent: Recurrent state, float32 (B, R); zeros at the start of a goal, but for `reset_goal_state`.
            robot_state: The robot's own state, float32 (B, S); None where S is 0.
            draws: Uniform numbers in [0, 1) to sample actions by, float64 (B, U); None for the likeliest actions.
        """

    def skip_steps(self, recurrent: npt.NDArray[np.float32], _steps: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns recurrent states after control steps without an observation, float32 (B, R); by default as they are.

        `step` takes its observations for those of consecutive control steps.

        Args:
            recurrent: Recurrent states, float32 (B, R).
            _steps: Control steps without an observation, int64 (B,); with 0 a state stays as it is.
        """
        return recurrent

    def reset_goal_state(self, recurrent: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Returns recurrent states, float32 (B, R), for the start of the next goal; by default zeros."""
        return np.zeros_like(recurrent)
