"""Figure 4.5: the base reward by image, along episodes in which the goal is reached, beside the learned reward."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from experiments.chapter4.trained_on import PLACE, PUSH, PUSH_TEXT, STACK
from experiments.robustness import wordings
from experiments.robustness.confidence import auroc
from experiments.robustness.reward_model import grounding_version, open_grounding
from experiments.robustness.worlds import CAMERA, open_world
from experiments.workbench import claims
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.plots import new_figure, png
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.table import Picture, Section, Table, words
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ModelRef
from freerein_reward.model import load_reward_model
from freerein_sim.worlds.generators import generator
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import expert_of

_METHOD, _VERSION = "curves", 2
_EPISODES, _SEED, _AFTER = 20, 1_000_003, 5
_SIZE = 64
"""Episodes of the expert, each with some steps after the goal has come to hold; the first one is the curve."""

BASE, LEARNED, TRUE = "base", "learned", "true"
_COLOURS = {BASE: "tab:blue", LEARNED: "tab:orange", TRUE: "0.6"}


class Curves(Experiment):
    """An arm for each task of figure 4.6; models that ship are evaluated."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The arms."""
        return tuple(Arm(task, _METHOD) for task in (PUSH, STACK, PLACE))

    def config(self, arm: Arm) -> Config:
        """Returns the episodes and the models; the shipped reward model knows no pucks."""
        learned = "" if arm.world == PUSH else _reward_model().version
        return {"version": _VERSION, "episodes": _EPISODES, "grounding": grounding_version(), "reward": learned}

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Rewards the frames of the episodes; see `Experiment`."""
        torch.set_num_threads(1)
        episodes = [_record(arm.world, index) for index in range(_EPISODES)]
        frames, holds = (np.concatenate(each) for each in zip(*episodes, strict=True))
        trial = np.repeat(np.arange(_EPISODES), [len(each) for each, _ in episodes])
        rewarded = {BASE: _base(frames, _text(arm.world))}
        if arm.world != PUSH:
            rewarded[LEARNED] = _learned(frames, _text(arm.world))
        samples = {name: auroc(each, holds, trial) for name, each in rewarded.items()}
        first = trial == 0
        shown = {name: np.round(each[first], 4).tolist() for name, each in (rewarded | {TRUE: holds * 1.0}).items()}
        return Outcome({}, samples, {"curves": shown})

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns how well each reward tells frames that show the goal, and the curves of the first episodes."""
        rows = tuple(
            (each.world, _text(each.world), *(_cell(each.samples, name) for name in (BASE, LEARNED)))
            for each in results
        )
        header = ("task", "text", "base reward, AUROC", "learned reward, AUROC")
        return Table(
            title="Figure 4.5: the base reward by image",
            text=words("fig_4_5"),
            sections=(Section(header, rows),),
            claims=tuple(_claims(results)),
            picture=Picture("Rewards along an episode of the expert", partial(_picture, results)),
        )


def _text(task: str) -> str:
    return PUSH_TEXT if task == PUSH else tasks()[task].goal_text


def _record(task: str, index: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
    """Returns frames, uint8 (T, H, W, 3), of an episode of the expert, and whether they show the goal, bool (T,)."""
    frames: list[npt.NDArray[np.uint8]] = []
    holds: list[bool] = []
    rng = generator(np.random.SeedSequence(_SEED, spawn_key=(index,)))
    with closing(open_world(task)) as world:
        world.reset(rng)
        expert = expert_of(world)((), rng)
        while sum(holds) < _AFTER and len(frames) < world.spec.max_episode_steps:
            frames.append(world.render(CAMERA, height=_SIZE, width=_SIZE).copy())
            holds.append(world.truth().reward > 0)
            done = expert.act()
            world.step(world.spec.action.hold_action() if done is None else done.action)
    return np.stack(frames), np.array(holds, np.bool_)


def _base(frames: npt.NDArray[np.uint8], text: str) -> npt.NDArray[np.float64]:
    model = open_grounding()
    (camera,) = model.cameras
    seen, (said, _) = model.embed_images({camera: frames}), model.embed_texts((model.grammar.read(text).text,))
    return np.asarray((seen.vectors @ said.T)[:, 0], np.float64)


def _learned(frames: npt.NDArray[np.uint8], text: str) -> npt.NDArray[np.float64]:
    store = ModelStore(CLONE_MODELS / "reward")
    model = load_reward_model(store.folder(_reward_model()), "cpu")
    return wordings.rewards(model, model.embed_images({CAMERA: frames}), model.grammar.read(text)).astype(np.float64)


def _reward_model() -> ModelRef:
    store = ModelStore(CLONE_MODELS / "reward")
    return ModelRef("default", store.active_version("default"))


def _cell(samples: Mapping[str, Sample], name: str) -> str:
    return f"{samples[name].mean:.3f}" if name in samples else ""


def _claims(results: Sequence[ArmResult]) -> Iterator[claims.Claim]:
    for each in results:
        for name, sample in each.samples.items():
            yield claims.claim_of(
                f"{each.world.removeprefix('blocks.')}_{name}",
                [each],
                [sample],
                seeds=1,
                command="python -m experiments run fig_4_5",
            )


def _picture(results: Sequence[ArmResult]) -> bytes:
    figure = new_figure(8.0, 2.2 * len(results))
    for axes, each in zip(figure.subplots(len(results), 1, squeeze=False)[:, 0], results, strict=True):
        curves: Mapping[str, Sequence[float]] = each.shown["curves"]  # type: ignore[assignment]
        for name, values in curves.items():
            scaled = np.array(values) - min(values)
            axes.plot(scaled / max(scaled.max(), 1e-6), color=_COLOURS[name], label=name)
        axes.set_title(_text(each.world), fontsize="small")
        axes.set_xlabel("timestep", fontsize="x-small")
        axes.legend(fontsize="x-small")
    return png(figure)


EXPERIMENT = Curves()
