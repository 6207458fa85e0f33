"""Latency of many control streams at once, beside a bare server.

Thirty-two robots send at a fixed rate from a process of their own: the service beside a bare gRPC server that makes the
same model call for every message. `Control` answers a robot's newest observation and drops those it overtook, the bare
server answers all: the answered shares are reported beside. At 50 Hz one core is too slow for one call per message, and
the bare server falls behind; at 10 Hz it keeps up.
"""

from contextlib import AsyncExitStack
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks import load_generator
from benchmarks.bare_policy import SEQ_BYTES, STREAM
from benchmarks.imitation_robot import CONTROL, publish_scene
from benchmarks.load_generator import Load, LoadResult
from benchmarks.report import Ratio, Results
from benchmarks.servers import run_server, run_service
from benchmarks.timing import Effort, Latencies

_SIDE_PX = 64
_ROBOTS, _RATES_HZ = 32, (50.0, 10.0)
_BAR_HZ = 50.0


async def measure(effort: Effort) -> Results:
    """Returns the latency under load relative to a bare server's."""
    results = Results()
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        scene = publish_scene(_SIDE_PX, folder)
        stack = await opened.enter_async_context(run_service("imitation", data_dir=folder))
        port = await opened.enter_async_context(run_server("benchmarks.bare_policy", str(scene.folder)))
        for rate_hz in _RATES_HZ:
            count = max(1, round(rate_hz * effort.load_s))
            observations = list(islice(scene.observed_bytes(), count))
            frames = [seq.to_bytes(SEQ_BYTES, "little") + scene.frame.tobytes() for seq in range(count)]
            address = stack.addresses["imitation"]
            loads = {
                "control": Load(address, CONTROL, scene.hello_bytes(), observations, 0, _ROBOTS, rate_hz),
                "bare": Load(f"127.0.0.1:{port}", STREAM, scene.goal.tobytes(), frames, SEQ_BYTES, _ROBOTS, rate_hz),
            }
            results += await _measure_rate(loads, effort.loads)
    return results


async def _measure_rate(loads: dict[str, Load], rounds: int) -> Results:
    rate_hz = loads["control"].rate_hz
    done: dict[str, list[LoadResult]] = {name: [] for name in loads}
    for turn in range(rounds):
        for name in sorted(loads, reverse=bool(turn % 2)):
            done[name].append(await load_generator.run(loads[name]))
    times = Latencies({name: tuple(np.array(turn.latencies_s) for turn in turns) for name, turns in done.items()})
    shares = {name: median(turn.answered_share for turn in turns) for name, turns in done.items()}
    case, limit = f"{_ROBOTS}x{rate_hz:g}hz", 1.5 if rate_hz == _BAR_HZ else None
    return Results(
        ratios=(
            Ratio(f"control.p99_vs_bare.{case}", times.ratio("control", over="bare", share=0.99), at_most=limit),
            Ratio(f"control.p50_vs_bare.{case}", times.ratio("control", over="bare", share=0.5)),
            *(Ratio(f"control.answered_share.{case}.{name}", share) for name, share in shares.items()),
        ),
        latencies={f"control.{case}": times},
    )
