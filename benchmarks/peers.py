"""Latency of one action beside policy servers of other projects, which serve the same policy, in one run.

One robot sends one raw image after the other and waits for the action, from arrays to arrays:

    torch      the model call in process
    control    the stream `Control`, by the Python client
    websocket  our WebSocket, by openpi's own client
    vla-eval   vla-eval's server and client, with raw images
    json       `Act` over REST, from a prepared body to the parsed reply, by Python's own HTTP client
    litserve   LitServe with the same content as JSON, in the same way

The peers and openpi's client are installed in an environment of their own, in which everything here runs.
"""

import asyncio
import json
from dataclasses import asdict

import numpy as np

from benchmarks.peer_environment import peers_python
from benchmarks.report import Ratio, Results
from benchmarks.timing import Effort, Latencies

_RATIOS = (("control", "vla-eval", 1.0), ("websocket", "vla-eval", None), ("json", "litserve", 0.67))


async def measure(effort: Effort) -> Results:
    """Returns the latency of each, and ours relative to theirs; nothing where the peers cannot be installed."""
    python = await asyncio.to_thread(peers_python)
    if python is None:
        return Results()
    pipe = asyncio.subprocess.PIPE
    arguments = ("-m", "benchmarks.peer_calls", json.dumps(asdict(effort)))
    process = await asyncio.create_subprocess_exec(python, *arguments, stdout=pipe)
    output, _ = await process.communicate()
    if process.returncode:
        raise RuntimeError(f"`python -m benchmarks.peer_calls` must end with 0; it ended with {process.returncode}.")
    results = Results()
    for case, calls in json.loads(output).items():
        times = Latencies({name: tuple(map(np.array, rounds)) for name, rounds in calls.items()})
        ratios = (
            Ratio(f"peers.{ours}_vs_{theirs}.{case}", times.ratio(ours, over=theirs, share=0.5), at_most=bar)
            for ours, theirs, bar in _RATIOS
        )
        results += Results(ratios=tuple(ratios), latencies={f"peers.{case}": times})
    return results
