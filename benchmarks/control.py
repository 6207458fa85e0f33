"""Throughput and latency of many control streams at once.

First sixteen robots that each wait for their reply, with batching and with one observation per model call. Then
thirty-two robots that send at a fixed rate from a process of their own: the service beside a bare gRPC server that
makes the same model call for every message. `Control` answers a robot's newest observation and drops those it overtook,
the bare server answers all: the answered shares are reported beside. At 50 Hz one core is too slow for one call per
message, and the bare server falls behind; at 10 Hz it keeps up.
"""

from contextlib import AsyncExitStack
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks import load_generator
from benchmarks.bare_policy import SEQ_BYTES, STREAM
from benchmarks.imitation_robot import CONTROL, Scene, control_stream, policy_step, publish_scene
from benchmarks.load_generator import Load, LoadResult
from benchmarks.report import Ratio, Results
from benchmarks.servers import run_server, run_service
from benchmarks.timing import Effort, Latencies, Workload, measure_rates, repeat_function, repeat_together
from freerein.clients import Channel, ImitationClient

_SIDE_PX = 64
_WAITING_ROBOTS, _MEASURED_BATCH = 16, 8
_WIDE = 512
"""Features and units of a policy whose weights exceed a core's caches."""

_ROBOTS, _RATES_HZ = 32, (50.0, 10.0)
_BAR_HZ = 50.0


async def measure(effort: Effort) -> Results:
    """Returns the gain of batching for sixteen streams, and the latency under load relative to a bare server's."""
    return await _measure_batching(effort) + await _measure_load(effort)


async def _measure_batching(effort: Effort) -> Results:
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        robots = {}
        for name, module in (("batching", ""), ("off", "benchmarks.unbatched_imitation")):
            scene = publish_scene(_SIDE_PX, folder / name, width=_WIDE)
            stack = await opened.enter_async_context(run_service("imitation", data_dir=folder / name, module=module))
            client = await opened.enter_async_context(ImitationClient(Channel(stack.addresses["imitation"])))
            robots[name] = [
                await opened.enter_async_context(control_stream(client, scene)) for _ in range(_WAITING_ROBOTS)
            ]
        model = await measure_rates([_model("batch-1", scene, 1), _model("batch-8", scene, _MEASURED_BATCH)], effort)
        streams = await measure_rates(
            [Workload(name, repeat_together(some), len(some), "observations") for name, some in robots.items()],
            effort,
        )
    cost = _MEASURED_BATCH / model.speedup("batch-8", over="batch-1")
    return Results(
        ratios=(
            Ratio("control.model_batch8_vs_batch1_cost", cost, at_most=2.0),
            Ratio("control.throughput16_on_vs_off", streams.speedup("batching", over="off"), at_least=2.5),
        ),
        rates={"control.model": model, "control.16-streams": streams},
    )


def _model(name: str, scene: Scene, size: int) -> Workload:
    return Workload(name, repeat_function(policy_step(scene, size)), size, "observations")


async def _measure_load(effort: Effort) -> Results:
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
