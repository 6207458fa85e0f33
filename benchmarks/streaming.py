"""What control streams give many robots at once.

First sixteen robots that each wait for their answer: with batches, and with one observation per call of the model. Then
thirty-two that send at their own rate, in a process of their own: the service beside a bare gRPC server that makes the
same call of the model for every message, with nothing around it. `Control` answers the newest observation of a robot
and drops what it overtook, while the bare server answers all of them: the shares answered are given beside. At 50 Hz a
core is not enough for a call per message, and the bare server falls behind; at 10 Hz it keeps up.
"""

import asyncio
from contextlib import AsyncExitStack
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks import floors
from benchmarks import load as loads
from benchmarks.controlling import CONTROL, Robot, controlling
from benchmarks.latencies import Latencies
from benchmarks.load import Answered, Load
from benchmarks.policies import Scene, publish
from benchmarks.processes import serving
from benchmarks.report import Bar, Findings, Ratio
from benchmarks.rounds import Contestant, Effort, race
from benchmarks.services import running
from freerein.clients import Channel, ImitationClient
from freerein_imitation.model import goal_conditioned_policy

_SIDE_PX = 64
_WAITING_ROBOTS, _MEASURED_BATCH = 16, 8
_WIDE = 512
"""Features and units of a policy whose weights no cache close to a core holds."""

_ROBOTS, _RATES_HZ = 32, (50.0, 10.0)
_PROMISED_HZ = 50.0


async def measure(effort: Effort) -> Findings:
    """Returns what batches give to sixteen streams, and how latency under load compares with a bare server's."""
    return await _measure_batching(effort) + await _measure_load(effort)


async def _measure_batching(effort: Effort) -> Findings:
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        robots = {}
        for name, module in (("batching", ""), ("off", "benchmarks.unbatched")):
            scene = publish(_SIDE_PX, folder / name, width=_WIDE)
            stack = await opened.enter_async_context(running("imitation", data_dir=folder / name, module=module))
            client = await opened.enter_async_context(ImitationClient(Channel(stack.addresses["imitation"])))
            robots[name] = [
                await opened.enter_async_context(controlling(client, scene)) for _ in range(_WAITING_ROBOTS)
            ]
        bare = await race([_bare("batch-1", scene, 1), _bare("batch-8", scene, _MEASURED_BATCH)], effort)
        many = await race([_waiting(name, some) for name, some in robots.items()], effort)
    cost = _MEASURED_BATCH / bare.speedup("batch-8", over="batch-1")
    return Findings(
        ratios=(
            Ratio("control.model_batch8_vs_batch1_cost", cost, Bar("at most", 2.0)),
            Ratio("control.throughput16_on_vs_off", many.speedup("batching", over="off"), Bar("at least", 2.5)),
        ),
        raw={"control.model": bare, "control.16-streams": many},
    )


def _bare(name: str, scene: Scene, size: int) -> Contestant:
    policy = goal_conditioned_policy.load(scene.folder, "cpu")
    frames = np.repeat(scene.frame[None], size, axis=0)
    goals = np.repeat(policy.encode_goals(scene.goal[None]), size, axis=0)
    previous = np.zeros((size, policy.action_size), np.float32)
    memory = np.zeros((size, policy.memory_size), np.float32)

    async def run(count: int) -> None:
        for _ in range(count):
            policy.step(frames, goals, previous, memory)

    return Contestant(name, run, size, "observations")


def _waiting(name: str, robots: list[Robot]) -> Contestant:
    """Returns robots that each observe, wait for the answer, and observe again."""

    async def observe(robot: Robot, count: int) -> None:
        for _ in range(count):
            await robot.answer()

    async def run(count: int) -> None:
        await asyncio.gather(*(observe(robot, count) for robot in robots))

    return Contestant(name, run, len(robots), "observations")


async def _measure_load(effort: Effort) -> Findings:
    found = Findings()
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        scene = publish(_SIDE_PX, folder)
        stack = await opened.enter_async_context(running("imitation", data_dir=folder))
        port = await opened.enter_async_context(serving("benchmarks.floors", "policy", str(scene.folder)))
        for rate_hz in _RATES_HZ:
            count = max(1, round(rate_hz * effort.load_s))
            found += await _measure_rate(
                {
                    "control": _control_load(scene, stack.addresses["imitation"], rate_hz, count),
                    "bare": _bare_load(scene, f"127.0.0.1:{port}", rate_hz, count),
                },
                effort.loads,
            )
    return found


async def _measure_rate(sent: dict[str, Load], rounds: int) -> Findings:
    rate_hz = sent["control"].rate_hz
    answered: dict[str, list[Answered]] = {name: [] for name in sent}
    for turn in range(rounds):
        for name in sorted(sent, reverse=bool(turn % 2)):
            answered[name].append(await loads.run(sent[name]))
    times = Latencies({name: tuple(np.array(turn.seconds) for turn in turns) for name, turns in answered.items()})
    shares = {name: median(turn.share for turn in turns) for name, turns in answered.items()}
    case = f"{_ROBOTS}x{rate_hz:g}hz"
    bar = Bar("at most", 1.5) if rate_hz == _PROMISED_HZ else None
    return Findings(
        ratios=(
            Ratio(f"control.p99_vs_bare.{case}", times.ratio("control", over="bare", share=0.99), bar),
            Ratio(f"control.p50_vs_bare.{case}", times.ratio("control", over="bare", share=0.5)),
            *(Ratio(f"control.answered_share.{case}.{name}", share) for name, share in shares.items()),
        ),
        latencies={f"control.{case}": times},
    )


def _control_load(scene: Scene, address: str, rate_hz: float, count: int) -> Load:
    messages = list(islice(scene.observations(), count))
    return Load(address, CONTROL, scene.greeting(), messages, 0, _ROBOTS, rate_hz)


def _bare_load(scene: Scene, address: str, rate_hz: float, count: int) -> Load:
    size, frame = floors.SEQ_BYTES, scene.frame.tobytes()
    messages = [seq.to_bytes(size, "little") + frame for seq in range(count)]
    return Load(address, floors.STREAM, scene.goal.tobytes(), messages, size, _ROBOTS, rate_hz)
