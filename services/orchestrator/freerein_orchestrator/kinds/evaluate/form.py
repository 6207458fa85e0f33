"""A form of evaluation: a configuration, rounds of trials, and the figures of all trials."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.clients.tasks import find_camera
from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.metrics import mean_interval, median_interval, ratio_interval
from freerein.types.common import Camera
from freerein.types.sim import CreateSessionRequest, Recipe, Task
from freerein_orchestrator.envs.episodes import derive_seed, replay
from freerein_orchestrator.envs.policies import PolicyHandle
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.kinds.policy_video import HEIGHT, max_frames
from freerein_orchestrator.rl.vec_env import Actions

Frames = npt.NDArray[np.uint8]

_MOST_WIDE = 320
"""Pixels of the widest frames that worlds render, unless they say otherwise."""

_HELD_OUT = 1_000_000
"""Seed of evaluations. That of a dataset is 0, and demonstration i of a task depends on the seed and i alone."""

FILMED = "filmed"
"""Name of a trial's actions that its policy's film replays."""


@dataclass(frozen=True, kw_only=True)
class FormConfig:
    """The configuration that all forms share.

    Attributes:
        form: The form.
        task: The task's name.
        episodes: Number of trials: of episodes, or of demonstrations.
        num_envs: Trials per round; a killed evaluation continues after the last whole round.
        seed: Seed of every random draw; by default one that no other kind of run has, so that trials are new ones.
        conditions: Conditions of the task, named variations; empty for the nominal task.
    """

    form: str = "returns"
    task: str
    episodes: int = bounded(50, least=1, most=100_000)
    num_envs: int = bounded(10, least=1, most=64)
    seed: int = bounded(_HELD_OUT, least=0, most=2**31 - 1)
    conditions: tuple[str, ...] = ()


C = TypeVar("C", bound=FormConfig)


@dataclass(frozen=True, eq=False)
class Trial:
    """Measurements of one trial.

    Attributes:
        values: JSON; empty for a trial that could not be measured. Its numbers are the trial's metrics.
        shown: Arrays of what pictures may show of it, by name: frames, or actions to replay. Of one name only the first
            trial's are kept: their number must not grow with that of the trials.
    """

    values: dict[str, Any]
    shown: dict[str, npt.NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Figure:
    """A measured value.

    Attributes:
        value: The value.
        low: Lower end of its 95 % interval over trials; None where there is none.
        high: Upper end, likewise.
        baseline: Value of the trivial answer on the same data; None where there is none.
    """

    value: float
    low: float | None = None
    high: float | None = None
    baseline: float | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """The result of an evaluation.

    Attributes:
        figures: By name.
        counts: How much was measured, by name.
        details: More values, JSON, by name.
        pictures: Describes the frames, JSON; written only where there are some.
        frames: What pictures show, uint8, by name.
        film: Frames of the policy's first episode, uint8 (T, H, W, C); None without a policy.
    """

    figures: dict[str, Figure]
    counts: dict[str, int] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    pictures: list[dict[str, Any]] = field(default_factory=list)
    frames: dict[str, Frames] = field(default_factory=dict)
    film: Frames | None = None


@dataclass(frozen=True, eq=False)
class Setup(Generic[C]):
    """The inputs of an evaluation.

    Attributes:
        context: The run's.
        config: The form's configuration.
        task: The task.
        sim: Client of the sim service.
        subject: `Evaluation.subject` of earlier attempts; empty in the first.
        interrupt: Called often; raises to stop.
    """

    context: RunContext
    config: C
    task: Task
    sim: SyncClient
    subject: Mapping[str, Any]
    interrupt: Callable[[], None]

    def seed(self, first: int) -> int:
        """Returns the seed of the round that begins with a trial."""
        return derive_seed(self.config.seed, first)

    def session(
        self, count: int, first: int, *, height: int = 0, width: int = 0, max_steps: int = 0
    ) -> CreateSessionRequest:
        """Returns the privileged session of a round's trials; equal sessions begin in equal states.

        Args:
            count: Trials of the round.
            first: The first one.
            height: Frame height in pixels; 0 for the cameras' own.
            width: Frame width in pixels; as `height`.
            max_steps: Steps of an episode; 0 for the task's own.
        """
        return CreateSessionRequest(
            self.task.name,
            num_envs=count,
            seed=self.seed(first),
            height=height,
            width=width,
            privileged=True,
            conditions=self.config.conditions,
            max_episode_steps=max_steps,
        )

    def film(
        self, index: int, trial: Trial, policy: PolicyHandle, *, recipes: Sequence[Recipe] = (), episode_steps: int = 0
    ) -> Frames:
        """Returns the frames of a trial's episode, as many as a video has; arguments as of `replay`."""
        return self.replay(index, trial.shown[FILMED], policy, recipes=recipes, episode_steps=episode_steps)

    def replay(
        self,
        index: int,
        actions: Actions,
        policy: PolicyHandle,
        *,
        times: Collection[int] | None = None,
        recipes: Sequence[Recipe] = (),
        episode_steps: int = 0,
    ) -> Frames:
        """Returns frames of a trial's episode, uint8 (K, H, W, C), of the first camera that its policy sees.

        Args:
            index: The trial's.
            actions: The episode's, as executed: float32 (T, A) or int64 (T, 1).
            policy: Whose they are.
            times: K timesteps, 0 to T; None for all, as many as a video has.
            recipes: What the episodes of its round required, up to its own; empty for what the world drew.
            episode_steps: Steps of an episode; 0 for the task's own.
        """
        camera = find_camera(self.task, (*policy.cameras, "")[0])
        env = index % self.config.num_envs

        def replayed(height: int, width: int) -> Frames:
            request = self.session(env + 1, index - env, height=height, width=width, max_steps=episode_steps)
            shown = range(min(len(actions) + 1, max_frames(height, width))) if times is None else times
            return replay(self.sim, request, actions, self.interrupt, camera=camera.name, times=shown, recipes=recipes)

        return enlarged(camera, (policy.height or camera.height, policy.width or camera.width), replayed)


def enlarged(camera: Camera, seen: tuple[int, int], render: Callable[[int, int], Frames]) -> Frames:
    """Returns frames that `render` makes of a height and width: those of pictures, or as seen where these are refused.

    Args:
        camera: The camera; its proportions stay.
        seen: Height and width that the model or policy sees.
        render: Raises InvalidInput where the world renders none so large, or a reply holds no so many.
    """
    scale = min(HEIGHT / camera.height, _MOST_WIDE / camera.width)
    height, width = (2 * round(side * scale / 2) for side in (camera.height, camera.width))  # codecs need even sides
    try:
        return render(height, width)
    except InvalidInput:
        return render(*seen)


class Evaluation(Protocol):
    """An evaluation at work."""

    @property
    def subject(self) -> dict[str, Any]:
        """The subject of the evaluation, with the versions of its models: JSON, part of the result."""

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`; the same however often it is called."""

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures of all trials; of their frames they hold those that were kept."""


@dataclass(frozen=True)
class Form(Generic[C]):
    """A form of evaluation, with a configuration of class C.

    Attributes:
        config: The class.
        open: Returns an evaluation; raises InvalidInput where task and configuration do not fit.
        check: As `Kind.check`.
    """

    config: type[C]
    open: Callable[[Setup[C]], Evaluation]
    check: Callable[[C, PolicyStore, Mapping[str, str]], None] = lambda _config, _store, _earlier: None


def mean_figure(values: Sequence[float], *, seed: int, baseline: float | None = None) -> Figure:
    """Returns the mean of a number per trial."""
    low, high = mean_interval(values, rng=np.random.default_rng(seed))
    return Figure(float(np.mean(values)), low, high, baseline)


def median_figure(values: Sequence[float]) -> Figure:
    """Returns the median of a number per trial, with the interval of its order statistics."""
    return Figure(float(np.median(values)), *median_interval(values))


def ratio_figure(part: npt.ArrayLike, whole: npt.ArrayLike, *, seed: int, baseline: float | None = None) -> Figure:
    """Returns a mean of ratios of sums over N trials; arguments as of `freerein.metrics.ratio_interval`."""
    parts, wholes = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    present = wholes.sum(axis=0) > 0
    low, high = ratio_interval(parts, wholes, rng=np.random.default_rng(seed))
    ratios = parts.sum(axis=0)[present] / wholes.sum(axis=0)[present]
    return Figure(float(ratios.mean()), low, high, baseline)


def share_figure(flags: Sequence[npt.ArrayLike], baseline: Sequence[npt.ArrayLike], *, seed: int) -> Figure | None:
    """Returns the share of flags that are true, bool (M,) per trial, beside a baseline's; None without any flag."""
    counts = [[np.size(each)] for each in flags]
    if not np.sum(counts):
        return None
    chance = float(np.mean(np.concatenate([np.ravel(each) for each in baseline])))
    return ratio_figure([[np.sum(each)] for each in flags], counts, seed=seed, baseline=chance)
