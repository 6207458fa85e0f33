"""The frames that a policy visits, for the score of how familiar others are to it."""

import torch
from torch import Tensor

from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.image_statistics import image_statistics
from freerein.learning.in_distribution import CALIBRATED_FROM, InDistribution
from freerein_orchestrator.rl.vec_env import VecEnv, env_actions, executed_actions, observation_tensor


@torch.no_grad()
def visited_frames(network: ActorCritic, envs: VecEnv, generator: torch.Generator, *, num_steps: int) -> Tensor:
    """Returns the frames of `num_steps` timesteps of N environments, uint8 (num_steps * N, H, W, C), step after step.

    They are as the environments return them: those of all cameras on the channels, and none of them earlier ones.

    Args:
        network: The policy; its actions are sampled.
        envs: Frames; they are reset.
        generator: Samples the actions, on the CPU.
        num_steps: Timesteps.

    Raises:
        InvalidInput: The observations are not what the network takes.
    """
    spec, num_envs, device = network.spec, envs.num_envs, next(network.parameters()).device
    seen, frames = observation_tensor(envs.reset(), spec, num_envs), []
    starts, state = torch.ones(num_envs, dtype=torch.bool), torch.zeros(num_envs, spec.recurrent_size)
    executed, earlier = torch.zeros(num_envs, spec.action_size), torch.zeros(num_envs, *spec.earlier_shape).byte()
    for _ in range(num_steps):
        frames.append(seen)
        observed = network.observe(seen, executed, earlier, starts)
        outputs = network(observed[None].to(device), starts[None].to(device), state.to(device))
        actions, state = outputs.actions.sample(generator)[0].cpu(), outputs.recurrent_state.cpu()
        step = envs.step(env_actions(actions))
        starts = torch.from_numpy(step.terminated | step.truncated)
        executed = executed_actions(actions) * ~starts[:, None]
        seen, earlier = observation_tensor(step.observations, spec, num_envs), network.earlier_frames(observed)
    envs.rewards()  # unused
    return torch.cat(frames)


def fit_in_distribution(frames: Tensor, *, num_envs: int, cameras: int = 1) -> InDistribution:
    """Returns the score of how familiar frames are; those of the later half of the environments count as held out.

    So no episode is on both sides. Of a single environment the later half of the frames is held out.

    Args:
        frames: uint8 (T * N, H, W, C), those of N environments step after step.
        num_envs: N.
        cameras: Number of cameras whose frames are side by side on the channels.
    """
    statistics = image_statistics({str(number): each for number, each in enumerate(frames.chunk(cameras, dim=-1))})
    parts = statistics.reshape(-1, num_envs, statistics.shape[1]).tensor_split(2, dim=min(1, num_envs - 1))
    known, held_out = (part.flatten(end_dim=1) for part in parts)
    score = InDistribution(statistics.shape[1])
    confidence = torch.ones(len(held_out))  # none, so that there is none to calibrate on many episodes
    score.fit(known, held_out, confidence, trajectories=CALIBRATED_FROM)
    return score
