"""Records one episode of a scripted policy."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.world import Action, Frame, ScriptedPolicy, World


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """Frames, actions and ground-truth skill labels of an episode of T timesteps.

    Attributes:
        frames: By camera, uint8 (T, H, W, C); frame t precedes action t.
        actions: float32 (T, A) in [-1, 1], or int64 (T, 1) for discrete actions.
        labels: int64 (T,), index of the skill at each timestep, -1 for none.
        skills: Skills that the policy was asked to execute, in order.
        success: Whether the policy succeeded without divergence.
    """

    frames: dict[str, npt.NDArray[np.uint8]]
    actions: Action
    labels: npt.NDArray[np.int64]
    skills: tuple[str, ...]
    success: bool


def record_episode(
    world: World,
    policy: ScriptedPolicy,
    *,
    skills: Sequence[str] = (),
    cameras: Sequence[str],
    height: int,
    width: int,
    max_steps: int,
) -> RecordedEpisode:
    """Runs a policy from the current state until it finishes, the episode terminates or `max_steps` is reached.

    The world must have been reset with `skills`, those that the policy was asked to execute in order, as its recipe.
    `height` and `width` are in pixels.
    """
    action = world.spec.action
    frames: dict[str, list[Frame]] = {camera: [] for camera in cameras}
    actions: list[Action] = []
    labels: list[int] = []
    diverged = False
    while len(actions) < max_steps and (chosen := policy.act()) is not None:
        for camera, seen in frames.items():
            seen.append(world.render(camera, height=height, width=width))
        actions.append(chosen.action)
        labels.append(chosen.skill)
        result = world.step(chosen.action)
        diverged = result.diverged
        if result.terminated:
            break
    joined = np.array(actions, np.int64) if action.choices else np.array(actions, np.float32)
    return RecordedEpisode(
        frames={camera: _stack(world, camera, seen, height, width) for camera, seen in frames.items()},
        actions=joined.reshape(-1, action.size),
        labels=np.array(labels, np.int64),
        skills=tuple(skills),
        success=policy.succeeded() and not diverged,
    )


def _stack(world: World, camera: str, seen: Sequence[Frame], height: int, width: int) -> npt.NDArray[np.uint8]:
    channels = next(each.channels for each in world.spec.cameras if each.name == camera)
    return np.array(seen, np.uint8).reshape(-1, height, width, channels)
