"""Steps per second of a training loop's environments, with frames, beside the same environments in process.

All step the task with random actions. The sim service has one worker process. A session of one environment is
compared with one environment in process, vectors with a vector.
"""

from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import numpy.typing as npt
from stable_baselines3.common.env_util import make_vec_env

from benchmarks.report import Ratio, Results
from benchmarks.servers import run_service
from benchmarks.timing import Effort, Rates, Workload, measure_rates, repeat_function
from freerein.envs import TextReward, VectorTextReward
from freerein.envs.sb3 import SB3VecEnv
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds.tasks import tasks

_TASK, _CAMERA = "blocks.yellow-left-of-green", "front"
_ID, _TEXT = f"freerein/{_TASK}-v0", "a yellow block to the left of a green block"
_ENVS = 16
_SEED = 0
_OVER_NETWORK = ("make_vec", "sb3", "sb3-text", "sb3-16-single-text")

Step: TypeAlias = Callable[[npt.NDArray[np.float32]], object]


async def measure(effort: Effort) -> Results:
    """Returns the ratios of steps per second to those in process."""
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        sim = await opened.enter_async_context(run_service("sim", data_dir=folder / "sim", FREEREIN_SIM_WORKERS="1"))
        reward = await opened.enter_async_context(run_service("reward", data_dir=folder / "reward"))
        ways = opened.enter_context(_ways(sim.addresses["sim"], reward.addresses["reward"]))
        rates = await measure_rates([_workload(*way) for way in ways], effort)
        return Results(_ratios(rates), {"envs": rates})


def _ratios(rates: Rates) -> tuple[Ratio, ...]:
    return (
        Ratio("envs.make_vs_in_process", rates.speedup("make", over="in-process-1")),
        *(Ratio(f"envs.{name}_vs_in_process", rates.speedup(name, over="in-process-16")) for name in _OVER_NETWORK),
    )


@contextmanager
def _ways(sim: str, reward: str) -> Iterator[tuple[tuple[str, Step, int], ...]]:
    """Makes the environments; yields the name, step function and number of each."""
    with ExitStack() as opened:

        def begin(envs: Any) -> Any:
            opened.enter_context(closing(envs)).reset()
            return envs

        def local(num_envs: int) -> Step:
            envs = begin(VectorEnv(tasks()[_TASK], num_envs=num_envs, seed=_SEED))
            return partial(envs.step, cameras=(_CAMERA,))

        def vector() -> gymnasium.vector.VectorEnv[Any, Any, Any]:
            return gymnasium.make_vec(_ID, _ENVS, address=sim)

        def judged(env: gymnasium.Env[Any, Any]) -> TextReward:
            return TextReward(env, _TEXT, address=reward)

        single = begin(gymnasium.make(_ID, address=sim))
        judged_singles = make_vec_env(_ID, _ENVS, env_kwargs={"address": sim}, wrapper_class=judged)
        yield (
            ("in-process-1", local(1), 1),
            ("in-process-16", local(_ENVS), _ENVS),
            ("make", partial(_step_single, single), 1),
            ("make_vec", begin(vector()).step, _ENVS),
            ("sb3", begin(SB3VecEnv(vector())).step, _ENVS),
            ("sb3-text", begin(SB3VecEnv(VectorTextReward(vector(), _TEXT, address=reward))).step, _ENVS),
            ("sb3-16-single-text", begin(judged_singles).step, _ENVS),
        )


def _step_single(env: gymnasium.Env[Any, Any], actions: npt.NDArray[np.float32]) -> None:
    _, _, terminated, truncated, _ = env.step(actions[0])
    if terminated or truncated:
        env.reset()


def _workload(name: str, step: Step, num_envs: int) -> Workload:
    rng, shape = np.random.default_rng(_SEED), (num_envs, tasks()[_TASK].spec.action.size)
    call = repeat_function(lambda: step(rng.uniform(-1, 1, shape).astype(np.float32)))
    return Workload(name, call, num_envs, "steps")
