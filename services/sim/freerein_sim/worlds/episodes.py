"""Records a behaviour in a world."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.types.common import ActionSpec
from freerein_sim.worlds.world import Action, Frame, ScriptedPolicy, World


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """What was seen and done, and, for evaluation only, which skill was executed when.

    Attributes:
        frames: By camera, uint8 (T, H, W, C); frame t was seen before action t.
        actions: float32 (T, A) in [-1, 1], or int64 (T, 1) where discrete.
        labels: int64 (T,), the skill in execution as an index into the world's skills, -1 for none.
        skills: The skills that were executed, in order.
        success: Whether the behaviour did all that was asked.
    """

    frames: dict[str, npt.NDArray[np.uint8]]
    actions: Action
    labels: npt.NDArray[np.int64]
    skills: tuple[str, ...]
    success: bool


def record_episode(
    world: World,
    behaviour: ScriptedPolicy,
    *,
    skills: Sequence[str] = (),
    cameras: Sequence[str],
    height: int,
    width: int,
    max_steps: int,
) -> RecordedEpisode:
    """Lets a behaviour act from the state of now until it, the episode or the steps end, and records it.

    Args:
        world: Already reset, with the same skills as its recipe.
        behaviour: Who acts.
        skills: What was asked of the behaviour, in order.
        cameras: Cameras to record.
        height: Height of frames, in pixels.
        width: Width of frames, in pixels.
        max_steps: Greatest number of timesteps.

    Returns:
        The demonstration, of 0 to `max_steps` timesteps.
    """
    frames: dict[str, list[Frame]] = {camera: [] for camera in cameras}
    actions: list[Action] = []
    labels: list[int] = []
    diverged = False
    while len(actions) < max_steps and (decision := behaviour.act()) is not None:
        for camera, seen in frames.items():
            seen.append(world.render(camera, height=height, width=width))
        actions.append(decision.action)
        labels.append(decision.skill)
        outcome = world.step(decision.action)
        diverged = outcome.diverged
        if outcome.terminated:
            break
    return RecordedEpisode(
        frames={camera: _stack(world, camera, seen, height, width) for camera, seen in frames.items()},
        actions=_join(world.spec.action, actions),
        labels=np.array(labels, np.int64),
        skills=tuple(skills),
        success=behaviour.succeeded() and not diverged,
    )


def _stack(world: World, camera: str, seen: Sequence[Frame], height: int, width: int) -> npt.NDArray[np.uint8]:
    channels = next(each.channels for each in world.spec.cameras if each.name == camera)
    return np.array(seen, np.uint8).reshape(-1, height, width, channels)


def _join(spec: ActionSpec, actions: Sequence[Action]) -> Action:
    if spec.choices:
        return np.array(actions, np.int64).reshape(-1, spec.size)
    return np.array(actions, np.float32).reshape(-1, spec.size)
