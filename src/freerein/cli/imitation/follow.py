"""Has a policy follow the images of a demonstration in a session of the sim service, step by step."""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.clients import ImitationClient, SimClient
from freerein.clients.tasks import select_task
from freerein.errors import InvalidInput, quoted
from freerein.types.common import Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActRequest, ActResponse, GetSpecRequest, GetSpecResponse, Resize
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    ListTasksRequest,
    Recipe,
    ResetRequest,
    StepRequest,
    Task,
)

Frames = dict[str, npt.NDArray[np.uint8]]
"""By camera, uint8 (H, W, C)."""


@dataclass(frozen=True)
class Demonstration:
    """What a policy is to do, and where.

    Attributes:
        task: Task of the sim service.
        goals: Images of every camera of the model for the first landmark, then for the next, and so on.
        model: The policy.
        seed: Seed of the episode.
        steps: Most actions; 0 for as many as an episode of the task has.
        steps_per_goal: Actions after which a landmark is abandoned; 0 for the model's own limit.
        conditions: Conditions of the task.
        path: Skill of the task, where the robot begins as its demonstrations do; empty for anywhere.
        resize: How goal images of another size than the model's are made to fit; None to refuse them.
    """

    task: str
    goals: tuple[Image, ...]
    model: ModelRef = ModelRef()
    seed: int = 0
    steps: int = 0
    steps_per_goal: int = 0
    conditions: tuple[str, ...] = ()
    path: str = ""
    resize: Resize | None = None


@dataclass(frozen=True, eq=False)
class Seen:
    """What was seen before an action, and the policy's answer; at the end of an episode its last answer."""

    frames: Frames
    answer: ActResponse


@dataclass(frozen=True, eq=False)
class Landmark:
    """A landmark that is over.

    Attributes:
        index: Its place in the demonstration, from 0.
        step: Actions before the policy said so.
        reached: Whether it said that it is reached; else it was abandoned.
        confidence: Its confidence then that it is reached.
    """

    index: int
    step: int
    reached: bool
    confidence: float


@dataclass(eq=False)
class Followed:
    """How a demonstration is followed, so far.

    Attributes:
        total: Landmarks of the demonstration.
        seen: By action; what was seen last is the end.
        landmarks: Those that are over, in order.
        ending: Why it ended; empty while it goes on.
    """

    total: int
    seen: list[Seen] = field(default_factory=list)
    landmarks: list[Landmark] = field(default_factory=list)
    ending: str = ""

    def add(self, frames: Frames, answer: ActResponse, *, threshold: float) -> None:
        """Adds an answer, which may say that landmarks are over."""
        for index in range(len(self.landmarks), min(answer.goal_index, self.total)):
            reached = answer.goal_confidence >= threshold
            self.landmarks.append(Landmark(index, len(self.seen), reached, answer.goal_confidence))
        self.seen.append(Seen(frames, answer))


async def follow(sim: SimClient, imitation: ImitationClient, asked: Demonstration) -> AsyncIterator[Followed]:
    """Yields how a demonstration is followed, after each answer of the policy; the same object each time.

    Raises:
        InvalidInput: The model takes no goal images, or sees cameras that the task has not.
        ServiceError: A service refused or failed.
    """
    spec = await imitation.get_spec(GetSpecRequest(asked.model))
    cameras = tuple(camera.name for camera in spec.cameras)
    _check(spec, asked.goals)
    _check_cameras(spec, select_task(await sim.list_tasks(ListTasksRequest()), asked.task))
    followed, state, executed = Followed(len(asked.goals) // len(cameras)), b"", None
    async with _session(sim, asked, spec) as (session, most):
        recipes = (Recipe((asked.path,)),) if asked.path else ()
        begun = await sim.reset(ResetRequest(session, cameras=cameras, recipes=recipes))
        frames: Frames = {name: each[0] for name, each in begun.frames.items()}
        for step in range(1, most + 2):
            request = ActRequest(
                Observation(tuple(images.encode(each, camera=name) for name, each in frames.items())),
                Goal(asked.goals),
                executed,
                state,
                asked.steps_per_goal,
                spec.model,
                asked.resize,
            )
            answer = await imitation.act(request)
            followed.add(frames, answer, threshold=spec.reached_threshold)
            if not len(answer.actions):
                followed.ending = "all landmarks are over"
            elif step > most:
                followed.ending = followed.ending or f"{most} actions were executed"
            yield followed
            if followed.ending:
                return
            state, executed = answer.state, answer.actions[:1]
            reply = await sim.step(StepRequest(session, step, executed, cameras=cameras))
            is_over = reply.terminated[0] or reply.truncated[0]
            if is_over:
                followed.ending = (
                    f"the episode {'ended' if reply.terminated[0] else 'was cut short'} after {step} actions"
                )
            frames = {name: each[0] for name, each in (reply.final_frames if is_over else reply.frames).items()}


@asynccontextmanager
async def _session(sim: SimClient, asked: Demonstration, spec: GetSpecResponse) -> AsyncIterator[tuple[str, int]]:
    """Yields a session with frames as the model sees them, and the most actions."""
    camera = spec.cameras[0]
    created = await sim.create_session(
        CreateSessionRequest(
            asked.task,
            num_envs=1,
            seed=asked.seed,
            height=camera.height,
            width=camera.width,
            conditions=asked.conditions,
            max_episode_steps=asked.steps + 1 if asked.steps else 0,
        )
    )
    try:
        yield created.session, asked.steps or created.task.max_episode_steps
    finally:
        await sim.close_session(CloseSessionRequest(created.session))


def _check(spec: GetSpecResponse, goals: Sequence[Image]) -> None:
    if spec.goal_form != "images":
        raise InvalidInput(
            f"The model must follow goal images; {quoted(spec.model.name)} follows a {spec.goal_form}.",
            field="model",
            hint="`freerein fit imitation DATASET --set method=goal_conditioned` makes one.",
        )
    if len(goals) % len(spec.cameras):
        names = ", ".join(camera.name for camera in spec.cameras)
        raise InvalidInput(
            f"A demonstration must have an image of each camera, {names}, for each landmark; got {len(goals)} images.",
            field="demo",
            hint="Name a folder for each: --demo CAMERA=DIR.",
        )


def _check_cameras(spec: GetSpecResponse, task: Task) -> None:
    known = {camera.name for camera in task.cameras}
    unknown = [camera.name for camera in spec.cameras if camera.name not in known]
    if unknown:
        raise InvalidInput(
            f"The model must see cameras of the task, {', '.join(sorted(known))}; it sees {quoted(unknown[0])}.",
            field="model",
            hint="`freerein act spec` shows what a model sees, `freerein sim tasks` what tasks show.",
        )
