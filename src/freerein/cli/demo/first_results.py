"""The first minute: what the models that come with freerein can do."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from rich.text import Text

from freerein import metrics
from freerein.cli.commands.sim import record
from freerein.cli.connection import SEGMENT_TIMEOUT_S
from freerein.cli.demo import curves, pictures
from freerein.cli.demo.evaluations import filmstrip, filmstrip_failure, reward_examples
from freerein.cli.demo.parts import HELD_OUT_SEED, PREFIX, Demo, Part
from freerein.cli.demo.pictures import RewardExample
from freerein.cli.demo.report import Figure
from freerein.cli.segments import picture, timeline
from freerein.data import Dataset, dataset_path, truth
from freerein.types.common import ModelRef
from freerein.types.segmentation import SegmentRequest
from freerein.types.sim import DemonstrateRequest

DIAL = "dial"
_KEYS = 5
_SCENES, _GOAL_EPISODES, EPISODES = 64, 16, 16
_CAPTIONS = (0, 2, 4)  # places of left, on top, and apart in their group
_BAR = 20  # characters


async def label_a_demonstration(demo: Demo) -> Sequence[Figure]:
    """A robot's demonstration is recorded, and each timestep labelled."""
    name, seed = f"{PREFIX}{DIAL}-{demo.seed}", demo.seed + HELD_OUT_SEED
    skills = f"--min-skills {_KEYS} --max-skills {_KEYS}"
    demo.reporter.command(f"freerein sim demonstrate {DIAL} --out {name} --count 1 {skills} --seed {seed} --truth")
    asked = DemonstrateRequest(DIAL, "expert", min_skills=_KEYS, max_skills=_KEYS, count=1, seed=seed, privileged=True)
    root = dataset_path(demo.data_dir, name)
    with demo.reporter.waiting("recording"):
        await record(demo.clients.sim, asked, root, on_count=lambda _: None)
    dataset = Dataset(root)
    trajectory, labels = dataset[0], truth.labels(root, 0)
    (frames,) = trajectory.frames.values()
    path = demo.out / "1-demonstration.png"
    demo.reporter.command(f"freerein segment {name} --model {DIAL} --smoothing 1 --png {path}")
    request = SegmentRequest(ModelRef(DIAL), frames, actions=trajectory.actions, smoothing=1)
    with demo.reporter.waiting("labelling"):
        answer = await demo.clients.segmentation.segment(request, timeout_s=SEGMENT_TIMEOUT_S)
    labelled = timeline.at_rate(answer, fps=dataset.spec.fps)
    demo.reporter.show(lambda console: timeline.show(labelled, console))
    with demo.reporter.waiting("rendering"):
        film = await _rendered(demo, asked, timesteps=len(frames))
    picture.draw(path, labelled, list(film))
    demo.reporter.picture(path)
    predicted = np.array([dataset.spec.skills.index(skill) for skill in answer.skills])[answer.labels]
    right, longest = metrics.frame_accuracy(predicted, labels), metrics.majority_accuracy(labels)
    return [Figure("timesteps labelled right", right, "%", None, longest, "longest skill")]


async def _rendered(demo: Demo, asked: DemonstrateRequest, *, timesteps: int) -> npt.NDArray[np.uint8]:
    """Returns the frames of the demonstration at the size of pictures, uint8 (T, 256, 256, C); recorded again."""
    larger = replace(asked, height=pictures.RENDERED_PX, width=pictures.RENDERED_PX, privileged=False)
    async for shown in demo.clients.sim.demonstrate(larger):
        (frames,) = shown.trajectory.frames.values()
    return frames[:timesteps]


async def judge_images(demo: Demo) -> Sequence[Figure]:
    """Images are judged against five sentences each."""
    judged = await demo.evaluate(
        "2-sentences",
        "relations",
        about_s=4,
        task="blocks.scatter",
        conditions=["blocks-2"],
        episodes=_SCENES,
        num_envs=_SCENES,
    )
    examples = await reward_examples(judged, demo.clients.reward, captions=_CAPTIONS)
    demo.reporter.show(lambda console: console.print(draw_similarities(examples[0])))
    demo.save(pictures.rewards_figure(examples, images="first held-out image of three relations"), "2-sentences")
    return [Figure.of("images whose sentence was found", judged.figure("accuracy"), "%", "most frequent")]


def draw_similarities(example: RewardExample) -> Text:
    """Returns a line for each sentence: how well it fits the image, and which one is true."""
    low, high = min(example.similarities), max(example.similarities)
    lines = []
    for place, (text, value) in enumerate(zip(example.texts, example.similarities, strict=True)):
        bar = "█" * round(1 + (_BAR - 1) * float((value - low) / (high - low)))
        colour = "green" if value == high else "dim"
        line = Text.assemble(f"  {text:<45} {value:5.2f} ", (bar, colour), " true" if place == example.truth else "")
        lines.append(line)
    return Text("\n").join(lines)


async def follow_goal_images(demo: Demo) -> Sequence[Figure]:
    """A robot follows goal images, and says when it is at one."""
    followed = await demo.evaluate(
        "3-goal-images",
        "landmarks",
        about_s=6,
        task="blocks",
        policy={"model": "default"},
        episodes=_GOAL_EPISODES,
        num_envs=_GOAL_EPISODES,
    )
    goals = filmstrip(followed)
    for number, goal in enumerate(goals, 1):
        said = f"step {goal.step:>3}: at goal image {number}, says the model with confidence {goal.confidence:.2f}"
        demo.reporter.line(f"{said}; {'true' if goal.reached else 'not true'}")
    demo.save(pictures.filmstrip_figure(goals, filmstrip_failure(followed)), "3-goal-images")
    free, flag = followed.figure("no_object_moves.landmarks_reached"), followed.figure("visited.goal_auroc")
    return [
        Figure.of("goal images reached", followed.figure("landmarks_reached"), "%", "random actions"),
        Figure.of("— that need no block moved", free, "%", "random actions"),
        Figure.of("goal-reached flag, AUROC", flag, "", "chance"),
    ]


async def obey_a_sentence(demo: Demo) -> Sequence[Figure]:
    """A policy does what a sentence says."""
    obeyed = await demo.evaluate(
        "4-sentence",
        "returns",
        about_s=8,
        task="blocks.yellow-right-of-green",
        policy={"stored": "yellow-right-of-green"},
        baseline="random",
        episodes=EPISODES,
        num_envs=EPISODES,
    )
    returns = {"policy": obeyed.result["returns"], "random actions": obeyed.result["baseline_returns"]}
    title, subtitle = f'"{obeyed.result["goal_text"]}"', "timesteps of 100 for which that was true, by episode"
    demo.save(curves.episodes_figure(returns, title=title, subtitle=subtitle), "4-sentence")
    return [Figure.of("timesteps of 100 as told", obeyed.figure("return_mean"), "steps", "random actions")]


FIRST_RESULTS = (
    Part(
        "demonstration",
        "Which key does a Jaco arm press when?",
        "The model learned from which keys occur in demonstrations, never when.",
        4,
        label_a_demonstration,
    ),
    Part(
        "sentences",
        "Which of five sentences is true of an image?",
        "The model learned from unlabelled images and the names of blocks.",
        6,
        judge_images,
    ),
    Part(
        "goal-images",
        "Follow goal images",
        "The model learned from random actions, and says itself when it is there.",
        8,
        follow_goal_images,
    ),
    Part(
        "sentence",
        "Put the yellow block to the right of the green one",
        "The policy learned from a reward that a model reads from its images.",
        9,
        obey_a_sentence,
    ),
)
"""The part of the demo that shows the shipped models."""
