"""The interface of vectorised environments, and the checks of what they return."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein_orchestrator.rl.errors import IterationRejected

Observations: TypeAlias = npt.NDArray[np.uint8] | npt.NDArray[np.float32]
"""Frames uint8 (N, H, W, C), those of several cameras side by side on the channels, or vectors float32 (N, D)."""
Actions: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""float32 (N, A) in [-1, 1], or discrete int64 (N, 1)."""
Frames: TypeAlias = npt.NDArray[np.uint8]
CameraFrames: TypeAlias = Mapping[str, Frames]
"""Frames of the same moments by camera, uint8 (M, H, W, C) each."""
Rewards: TypeAlias = npt.NDArray[np.float32]

_SIM_HINT = "See the log of the sim service."


@dataclass(frozen=True, eq=False)
class VecStep:
    """The result of one step of N environments; those whose episode ended are reset already.

    Attributes:
        observations: The next observations; the first of the new episode where one ended.
        terminated: bool (N,), whether the episode reached a terminal state.
        truncated: bool (N,), whether it was cut off by a time limit.
        final_observations: As `observations`, but the last of the old episode where one ended; other rows are not read.
        given_up: bool (N,), whether it was truncated only to begin in another state; None for nowhere.
    """

    observations: Observations
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    final_observations: Observations
    given_up: npt.NDArray[np.bool_] | None = None


class VecEnv(Protocol):
    """N environments that step together. Rewards may lag behind the steps: `rewards` waits for them."""

    @property
    def num_envs(self) -> int:
        """N."""

    def reset(self) -> Observations:
        """Starts an episode in every environment; returns the first observations."""

    def step(self, actions: Actions) -> VecStep:
        """Takes one action in every environment."""

    def rewards(self) -> Rewards:
        """Returns the rewards of the T steps since the last call, float32 (T, N)."""

    def snapshots(self) -> tuple[bytes, ...]:
        """Returns snapshots of the environments; empty where that is impossible."""


def join_cameras(frames: CameraFrames, cameras: Sequence[str]) -> Frames:
    """Returns the frames of some cameras, of one height and width, side by side on the channels: uint8 (M, H, W, C)."""
    chosen = [frames[camera] for camera in cameras]
    return chosen[0] if len(chosen) == 1 else np.concatenate(chosen, axis=-1)


def moments(frames: CameraFrames) -> int:
    """Returns the number of moments that frames of at least one camera show."""
    return len(next(iter(frames.values())))


def observation_tensor(observations: Observations, spec: ActorCriticSpec, num_envs: int) -> Tensor:
    """Returns a copy of the observations of `num_envs` environments as a tensor on the CPU.

    Raises:
        InvalidInput: Dtype or shape is not the network's, or a number is not finite.
    """
    dtype = np.dtype(np.float32 if spec.vector_size else np.uint8)
    shape = (num_envs, *spec.input_shape)
    if observations.dtype != dtype or observations.shape != shape:
        raise InvalidInput(
            f"Observations must be {dtype} {shape}; got {observations.dtype} {observations.shape}.",
            hint="Make the network for the frames that the environments render.",
        )
    if spec.vector_size and (wrong := int(np.sum(~np.isfinite(observations)))):
        raise InvalidInput(
            f"Observations must be finite; {wrong} of {observations.size} numbers are not.",
            hint="The simulation diverged.",
        )
    return torch.from_numpy(observations.copy())


def given_up(step: VecStep) -> npt.NDArray[np.bool_]:
    """Returns whether each environment's episode was given up for another state, bool (N,)."""
    return np.zeros_like(step.truncated) if step.given_up is None else step.given_up


def step_observations(step: VecStep, spec: ActorCriticSpec, num_envs: int) -> tuple[Tensor, Tensor]:
    """Returns next and final observations of a step, checked; the latter of the K episodes that ended, (K, ...).

    Raises:
        IterationRejected: The environments returned something malformed.
    """
    if {step.terminated.shape, step.truncated.shape} != {(num_envs,)}:
        raise IterationRejected(
            f"`terminated` and `truncated` must have shape ({num_envs},); "
            f"got {step.terminated.shape} and {step.truncated.shape}.",
            hint=_SIM_HINT,
        )
    try:
        done = step.terminated | step.truncated
        final = observation_tensor(step.final_observations[done], spec, int(done.sum()))
        return observation_tensor(step.observations, spec, num_envs), final
    except InvalidInput as error:
        raise IterationRejected(error.detail, hint=_SIM_HINT) from error


def reward_tensor(rewards: Rewards, shape: torch.Size) -> Tensor:
    """Returns a copy of rewards as a tensor.

    Raises:
        IterationRejected: They have another shape, or are not all finite.
    """
    if rewards.shape != shape or not np.isfinite(rewards).all():
        raise IterationRejected(
            f"Rewards must be finite and of shape {tuple(shape)}; "
            f"got shape {rewards.shape} with {np.isfinite(rewards).sum()} finite ones.",
            hint="See the log of the service that computes rewards.",
        )
    return torch.from_numpy(np.array(rewards, np.float32))


def executed_actions(actions: Tensor) -> Tensor:
    """Returns actions (..., A) as they are executed: continuous ones clipped to [-1, 1]."""
    return actions.clamp(-1, 1) if actions.is_floating_point() else actions


def env_actions(actions: Tensor) -> Actions:
    """Returns actions (N, A) as environments take and execute them."""
    array: Actions = executed_actions(actions).cpu().numpy()
    return array
