"""Speed of PPO on the learned reward, over the network and in one process; see `benchmarks.ppo`."""

import asyncio

from benchmarks import ppo
from benchmarks.timing import THOROUGH

from experiments.workbench.results import Outcome, Sample

TICKS_PER_S, NETWORK_VS_IN_PROCESS = "ticks-per-s", "network-vs-in-process"


def evaluate() -> Outcome:
    """Returns simulated control ticks per second over the network, and in units of those in process, by round."""
    rates = asyncio.run(ppo.measure(THOROUGH)).rates["ppo"].rates
    served, local = rates["one-sim"], rates["in-process"]
    ratios = [ours / theirs for ours, theirs in zip(served, local, strict=True)]
    samples = {
        name: Sample(each, [1] * len(each)) for name, each in ((TICKS_PER_S, served), (NETWORK_VS_IN_PROCESS, ratios))
    }
    return Outcome({}, samples)
