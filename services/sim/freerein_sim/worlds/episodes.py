"""Records one episode of a scripted policy, such as the expert."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein.types.common import Camera
from freerein_sim.worlds.world import Action, Frame, LabelledAction, ScriptedPolicy, World, expert_of


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """Frames, actions and ground-truth skill labels of an episode of T timesteps.

    Attributes:
        frames: By camera, uint8 (T, H, W, C); frame t precedes action t.
        actions: float32 (T, A) in [-1, 1], or int64 (T, 1) for discrete actions.
        labels: int64 (T,), index of the skill at each timestep, -1 for none.
        terminated: bool (T,), whether the action of each timestep terminated the episode.
        success: Whether the policy succeeded without divergence.
    """

    frames: dict[str, npt.NDArray[np.uint8]]
    actions: Action
    labels: npt.NDArray[np.int64]
    terminated: npt.NDArray[np.bool_]
    success: bool


def record_expert(
    world: World, recipe: Sequence[str], rng: np.random.Generator, *, cameras: Sequence[Camera] = (), settle: int = 0
) -> RecordedEpisode:
    """Resets a world, and records its expert at a recipe; an empty one means the world's own."""
    world.reset(rng, recipe=recipe)
    expert = expert_of(world)(recipe, rng)
    return record_episode(world, expert, cameras=cameras, max_steps=world.spec.max_episode_steps, settle=settle)


def record_episode(
    world: World, policy: ScriptedPolicy, *, cameras: Sequence[Camera], max_steps: int, settle: int = 0
) -> RecordedEpisode:
    """Runs a policy from the current state until it finishes, the episode terminates or `max_steps` is reached.

    A frame is what was seen before an action: without `settle` none shows what the last action came to.

    Args:
        world: Already reset.
        policy: Chooses the actions.
        cameras: Cameras to record, with the frame size.
        max_steps: Greatest number of timesteps.
        settle: Timesteps for which it goes on once the policy has finished, holding, with the last skill's label.
    """
    action = world.spec.action
    frames: dict[Camera, list[Frame]] = {camera: [] for camera in cameras}
    actions: list[Action] = []
    labels: list[int] = []
    terminated: list[bool] = []
    diverged = False
    while len(actions) < max_steps:
        if (chosen := policy.act()) is None:
            if not settle or not labels:
                break
            settle, chosen = settle - 1, LabelledAction(action.hold_action(), labels[-1])
        for camera, seen in frames.items():
            seen.append(world.render(camera.name, height=camera.height, width=camera.width))
        actions.append(chosen.action)
        labels.append(chosen.skill)
        result = world.step(chosen.action)
        terminated.append(result.terminated)
        diverged = result.diverged
        if result.terminated:
            break
    return RecordedEpisode(
        frames={
            camera.name: np.array(seen, np.uint8).reshape(-1, camera.height, camera.width, camera.channels)
            for camera, seen in frames.items()
        },
        actions=cast(Action, np.array(actions, action.dtype).reshape(-1, action.size)),
        labels=np.array(labels, np.int64),
        terminated=np.array(terminated, np.bool_),
        success=policy.succeeded() and not diverged,
    )
