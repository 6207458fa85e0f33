"""Speed of PPO on the learned reward, over the network and in one process; see `benchmarks.ppo`."""

import asyncio

from benchmarks import ppo
from benchmarks.timing import THOROUGH

from experiments.workbench.results import Outcome, Sample

VERSION = 2
"""Raised where the code that it measures has become faster: old runs say nothing of it."""

TICKS_PER_S, TICKS_PER_S_HELD, NETWORK_VS_IN_PROCESS = "ticks-per-s", "ticks-per-s-held", "network-vs-in-process"


def evaluate() -> Outcome:
    """Returns simulated control ticks per second over the network, and in units of those in process, by round.

    Those where each action is held for two ticks are a figure of their own.
    """
    rates = asyncio.run(ppo.measure(THOROUGH)).rates["ppo"].rates
    served, local = rates["one-sim"], rates["in-process"]
    ratios = [ours / theirs for ours, theirs in zip(served, local, strict=True)]
    figures = {TICKS_PER_S: served, TICKS_PER_S_HELD: rates["held"], NETWORK_VS_IN_PROCESS: ratios}
    return Outcome({}, {name: Sample(each, [1] * len(each)) for name, each in figures.items()})
