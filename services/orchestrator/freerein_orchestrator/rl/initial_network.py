"""Networks before the first iteration: their spec, initial weights, and the calibration of their image encoders."""

import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.actor_critic.object_encoder import ObjectEncoderSpec
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.rollout import first_observations, next_observations
from freerein_orchestrator.rl.vec_env import VecEnv, env_actions

_CALIBRATION_STEPS = 64


def network_spec(
    config: PPOConfig,
    *,
    observation: tuple[int, ...],
    action_size: int = 1,
    action_choices: int = 0,
    object_encoder: ObjectEncoderSpec | None = None,
    encoder: str = "spatial",
    action_repeat: int = 1,
    cameras: int = 1,
    frame_stack: int = 1,
    gray: bool = False,
) -> ActorCriticSpec:
    """Returns the network of a configuration.

    Args:
        config: Hyperparameters.
        observation: Shape of a camera's frame, (H, W, C), or of a vector, (D,).
        action_size: Numbers per action.
        action_choices: Number of discrete actions, 0 if continuous.
        object_encoder: The frozen one that sees the frames, if any.
        encoder: The image encoder that sees them without an object encoder.
        action_repeat: Timesteps that each action is held for.
        cameras: Number of cameras.
        frame_stack: The last frames of each camera that are one observation.
        gray: Whether the network sees the luma of RGB frames.

    Raises:
        InvalidInput: There is no network for such observations or actions.
    """
    match observation:
        case (height, width, channels):
            shape = {"height": height, "width": width, "channels": channels}
        case (size,):
            shape = {"vector_size": size}
        case _:
            raise InvalidInput(f"An observation must have the shape (H, W, C) or (D,); got {observation}.")
    return ActorCriticSpec(
        **shape,
        action_size=action_size,
        action_choices=action_choices,
        feature_size=config.feature_size,
        hidden_size=config.hidden_size,
        recurrent=config.recurrent,
        init_log_std=config.init_log_std,
        layer_norm=config.layer_norm,
        eye=object_encoder,
        encoder="spatial" if object_encoder else encoder,
        action_repeat=action_repeat,
        cameras=cameras,
        frame_stack=frame_stack,
        gray=gray,
    )


def init_network(spec: ActorCriticSpec, generator: torch.Generator) -> ActorCritic:
    """Returns a network with initial weights, not yet calibrated."""
    network = ActorCritic(spec)
    weights.initialise(network, generator=generator)
    return network


def calibrate(network: ActorCritic, envs: VecEnv, generator: torch.Generator) -> None:
    """Calibrates a network's image encoder on frames that random actions lead to; does nothing for vectors."""
    spec = network.spec
    if spec.vector_size:
        return
    seen = [first_observations(network, envs)]
    for _ in range(_CALIBRATION_STEPS):
        actions = random_actions(spec, envs.num_envs, generator)
        step = envs.step(env_actions(actions))
        seen.append(next_observations(network, seen[-1], step, actions)[0])
    envs.rewards()  # unused
    network.calibrate(torch.cat(seen).to(next(network.parameters()).device))


def random_actions(spec: ActorCriticSpec, num_envs: int, generator: torch.Generator) -> Tensor:
    """Returns uniform actions, (num_envs, A)."""
    size = num_envs, spec.action_size
    if spec.action_choices:
        return torch.randint(spec.action_choices, size, generator=generator)
    return 2 * torch.rand(size, generator=generator) - 1
