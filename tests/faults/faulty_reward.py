"""The reward service as it is, around the contract suite's models, but what it rewards may be told to be nonsense.

The file `lies` in its data directory says which nonsense to answer, and how often: `nan 3`.
"""

import asyncio
import sys
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.faults.lies import next_lie

from freerein.serving.health import Health
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.types.reward import RewardRequest, RewardResponse
from freerein_reward.__main__ import NAME
from freerein_reward.settings import RewardSettings

sys.path.insert(0, str(Path(__file__).parents[1] / "reward"))

_SLOW_S = 1.0
_LIES = {"nan": np.nan, "infinite": np.inf, "huge": 1e30}


def lie(answer: RewardResponse, kind: str) -> RewardResponse:
    """Returns nonsense in place of an answer."""
    if kind == "short":
        return replace(answer, rewards=answer.rewards[:-1])
    return replace(answer, rewards=np.full_like(answer.rewards, _LIES[kind]))


def lying(reward: Callable[[RewardRequest], Awaitable[RewardResponse]], told: Path) -> Callable[..., object]:
    """Returns what rewards, and lies as often as it is told to."""

    async def answer(request: RewardRequest) -> RewardResponse:
        kind, truth = next_lie(told), await reward(request)
        await asyncio.sleep(_SLOW_S * (kind == "slow"))
        return lie(truth, kind) if kind in (*_LIES, "short") else truth

    return answer


def build_lying(settings: RewardSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    """Returns the service."""
    from toy_service import build_toy

    honest = build_toy(settings, limits, metrics, health)
    methods = (
        replace(method, call=lying(method.call, settings.data_dir / "lies")) if method.name == "Reward" else method
        for method in honest.methods
    )
    return replace(honest, methods=tuple(methods))


if __name__ == "__main__":
    run(NAME, RewardSettings, build_lying)
