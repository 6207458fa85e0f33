"""The part of the demo that learns, from random weights: skills from tags, and a policy from a sentence."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.cli.demo import curves, pictures
from freerein.cli.demo.evaluations import Evaluation, labelled_trajectory
from freerein.cli.demo.first_results import EPISODES
from freerein.cli.demo.parts import HELD_OUT_SEED, PREFIX, Clients, Demo, Part
from freerein.cli.demo.report import Figure
from freerein.types.common import Goal, ModelRef, Observation
from freerein.types.imitation import ActRequest, PublishPolicyRequest
from freerein.types.sim import CloseSessionRequest, CreateSessionRequest, RenderRequest, ResetRequest, StepRequest

_TASK, _SENTENCE = "blocks.yellow-left-of-green", "a yellow block to the left of a green block"
_CAMERA = "front"
GRID_DEMONSTRATIONS: dict[str, Any] = {"task": "grid", "count": 1000, "min_skills": 2, "max_skills": 4}
GRID_FIT: dict[str, Any] = {"steps": 300, "batch_size": 16, "augmentation": 0.0}
"""The demonstrations of the world `grid`, and the fit to them."""

PPO: dict[str, Any] = {"conditions": ["start-on-the-way"]}
ITERATIONS = 47
"""Half of the default: 96 256 timesteps."""

UNTRAINED: dict[str, Any] = {"iterations": 1, "lr": 1e-7}
"""The smallest learning rate, which changes nothing: the policy with random weights that PPO begins with."""

_SHOWN_FRAMES, _EVERY = 9, 2


async def learn_skills_from_tags(demo: Demo) -> Sequence[Figure]:
    """A segmentation model is fitted to demonstrations, each tagged with the set of its skills."""
    dataset, model = f"{PREFIX}grid-{demo.seed}", f"{PREFIX}grid"
    collect = {**GRID_DEMONSTRATIONS, "dataset": dataset, "seed": demo.seed}
    await demo.run("5-record", "collect", collect, about_s=9)
    fit = {**GRID_FIT, "seed": demo.seed}
    asked = {"service": "segmentation", "dataset": dataset, "model_name": model, "config": fit}
    await demo.run("5-fit", "fit", asked, about_s=25, curve="train_loss", unit="loss")
    longer = {"min_skills": 5, "max_skills": 5, "smoothing": 1}  # more different skills than any that it has seen
    labelled = await demo.evaluate(
        "5-labels", "segmentation", about_s=4, task="grid", model=model, episodes=50, **longer
    )
    demo.save(pictures.timeline_figure(labelled_trajectory(labelled), task="grid"), "5-labels")
    return [Figure.of("timesteps right, learned from tags", labelled.figure("frame_accuracy"), "%", "longest skill")]


async def learn_from_a_sentence(demo: Demo) -> Sequence[Figure]:
    """A policy is trained by PPO on the reward that a model reads from images and the sentence."""
    seeded = {**PPO, "task": _TASK, "seed": demo.seed}
    demo.reporter.line("It first moves at random, to find its gripper in images; then it learns.")
    untrained = await demo.run("6-untrained", "ppo", {**seeded, **UNTRAINED, "explorations": 1}, about_s=8)
    trained = await demo.run(
        "6-ppo", "ppo", {**seeded, "iterations": ITERATIONS}, about_s=85, curve="episode_return", unit="return"
    )
    before = await _returns(demo, "6-before", untrained.run.id)
    after = await _returns(demo, "6-after", trained.run.id, baseline="random")
    bars = {
        "random": after.figure("baseline_return_mean"),
        "untrained": before.figure("return_mean"),
        "ppo": after.figure("return_mean"),
        "expert": after.figure("expert_return_mean"),
    }
    picture = curves.returns_figure(
        trained.curve,
        {"timesteps at the goal": bars},
        title=f'PPO from random weights: "{_SENTENCE}"',
        subtitle=f"timesteps of 100 by true states, in the same {EPISODES} episodes each; lines are 95 % intervals",
    )
    demo.save(picture, "6-returns")
    await _show_episode(demo, trained.run.id)
    random = bars["random"].value
    return [
        Figure("timesteps as told, untrained", bars["untrained"].value, "steps", None, random, "random actions"),
        Figure.of("timesteps as told, after PPO", bars["ppo"], "steps", "random actions"),
    ]


async def _returns(demo: Demo, name: str, run: str, **config: Any) -> Evaluation:
    policy = {"run": run}
    return await demo.evaluate(
        name, "returns", about_s=8, task=_TASK, policy=policy, episodes=EPISODES, num_envs=EPISODES, **config
    )


async def _show_episode(demo: Demo, run: str) -> None:
    """Serves the policy of a run, and draws an episode conditioned on the sentence."""
    name = f"{PREFIX}left"
    demo.reporter.command(f"freerein models publish {run} --name {name}")
    served = (await demo.clients.imitation.publish_policy(PublishPolicyRequest(run, name))).model
    frames = await _episode(demo.clients, served, seed=demo.seed + HELD_OUT_SEED)
    picture = pictures.episode_figure(
        frames[: _SHOWN_FRAMES * _EVERY : _EVERY],
        title=f'"{_SENTENCE}"',
        subtitle="the first timesteps of an episode of the policy that was learned; not chosen",
    )
    demo.save(picture, "6-episode")


async def _episode(clients: Clients, model: ModelRef, *, seed: int) -> list[npt.NDArray[np.uint8]]:
    """Returns what the policy saw at each of its steps in an episode, drawn larger, uint8 (256, 256, 3) each."""
    created = await clients.sim.create_session(CreateSessionRequest(_TASK, seed=seed))
    try:
        return await _seen(clients, model, created.session, most=created.task.max_episode_steps)
    finally:
        await clients.sim.close_session(CloseSessionRequest(created.session))


async def _seen(clients: Clients, model: ModelRef, session: str, *, most: int) -> list[npt.NDArray[np.uint8]]:
    step = 0
    frame = (await clients.sim.reset(ResetRequest(session, cameras=(_CAMERA,)))).frames[_CAMERA][0]
    frames, state, executed = [await _drawn(clients, session)], b"", None
    while step < most:
        seen = Observation((images.encode(frame, encoding="raw_rgb8", camera=_CAMERA),))
        asked = ActRequest(seen, Goal(text=_SENTENCE), executed, state, model=model)
        answer = await clients.imitation.act(asked)
        state, executed = answer.state, answer.actions
        for action in answer.actions:
            step += 1
            stepped = await clients.sim.step(StepRequest(session, step, action[None], (_CAMERA,)))
            if stepped.terminated[0] or stepped.truncated[0]:
                return frames
        frame = stepped.frames[_CAMERA][0]
        frames.append(await _drawn(clients, session))
    return frames


async def _drawn(clients: Clients, session: str) -> npt.NDArray[np.uint8]:
    """Returns what a session shows now, at the size of pictures, uint8 (256, 256, 3)."""
    side = pictures.RENDERED_PX
    rendered = await clients.sim.render(RenderRequest(session, (_CAMERA,), side, side))
    (frame,) = rendered.frames[_CAMERA]
    return np.asarray(frame, np.uint8)


LEARNED = (
    Part(
        "tags",
        "Learn which skill is executed when",
        "1 000 demonstrations say which skills occur in them, never when.",
        40,
        learn_skills_from_tags,
    ),
    Part(
        "ppo",
        "Learn to put the yellow block to the left of the green one",
        "Random weights behind the image encoder of the reward model, and a sentence.",
        120,
        learn_from_a_sentence,
    ),
)
"""The part of the demo that learns."""
