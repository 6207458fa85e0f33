"""The cameras of a ppo run: those that its policy observes, and those that its reward sees."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, cast

from freerein.clients.tasks import find_camera
from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein.learning.checkpoints import JSON
from freerein.types.common import Camera
from freerein.types.sim import Task
from freerein_orchestrator.kinds.ppo_config import PPORunConfig


@dataclass(frozen=True)
class ObservedCameras:
    """Cameras with the frame sizes of the run.

    Attributes:
        policy: Those that the policy observes, of one frame size.
        reward: Those that the reward sees.
    """

    policy: tuple[Camera, ...]
    reward: tuple[Camera, ...]

    @classmethod
    def find(cls, task: Task, config: PPORunConfig) -> "ObservedCameras":
        """Returns the cameras that a configuration names.

        Raises:
            InvalidInput: The task lacks one, or those of the policy have different frame sizes.
        """
        field = "config.cameras" if config.cameras else "config.camera"
        policy = _sized(task, config.cameras or (config.camera,), config, field=field)
        if len({(each.height, each.width, each.channels) for each in policy}) > 1:
            sizes = ", ".join(f"{each.name} {each.height} x {each.width} x {each.channels}" for each in policy)
            raise InvalidInput(
                f"Cameras that a policy observes together must have one frame size; got {sizes}.",
                field=field,
                hint="Set `height` and `width`, or observe cameras of one size.",
            )
        reward = _sized(task, config.reward_cameras, config, field="config.reward_cameras")
        return cls(policy, reward or policy)

    @classmethod
    def of_inputs(cls, inputs: Mapping[str, JSON], spec: ActorCriticSpec) -> "ObservedCameras":
        """Returns the cameras in a training's inputs, whose network says the size of the policy's frames."""
        bound = cast(Mapping[str, Any], inputs)
        names = bound.get("cameras", [bound["camera"]])  # earlier versions had one for both
        policy = tuple(Camera(name, spec.height, spec.width, spec.channels) for name in names)
        reward = tuple(Camera(**each) for each in bound.get("reward_cameras", ()))
        return cls(policy, reward or policy)

    def to_inputs(self) -> dict[str, JSON]:
        """Returns what `of_inputs` reads."""
        return {
            "camera": self.policy[0].name,
            "cameras": [camera.name for camera in self.policy],
            "reward_cameras": [asdict(camera) for camera in self.reward],
        }


def _sized(task: Task, names: Sequence[str], config: PPORunConfig, *, field: str) -> tuple[Camera, ...]:
    found = [find_camera(task, name, field=field) for name in names]
    return tuple(replace(each, height=config.height or each.height, width=config.width or each.width) for each in found)
