"""Any process killed at any moment: the final policy has the same bits as that of an undisturbed run."""

import asyncio
import hashlib
import itertools
import json
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest
import pytest_asyncio

from freerein.clients import Channel, OrchestratorClient
from freerein.errors import Unavailable
from freerein.types.orchestrator import GetArtifactRequest, Run, StartRunRequest, WatchRunRequest

pytestmark = [pytest.mark.e2e, pytest.mark.asyncio(loop_scope="module")]
MODULES = {"sim": "freerein_sim", "reward": "tests.faults.faulty_reward", "orchestrator": "freerein_orchestrator"}
TINY = {
    "task": "grid",
    "goal_text": "more",
    "camera": "top",
    "reward": "base",
    "reward_model": "default",
    "encoder": "spatial",
    "iterations": 3,
    "num_envs": 2,
    "num_steps": 8,
    "epochs": 1,
    "batch_size": 8,
    "feature_size": 8,
    "hidden_size": 8,
}
ROLLOUTS, TIMEOUT_S = 8, 500.0
POLICY = "policy.safetensors"
PPO = [
    pytest.param(*case, marks=() if case == ("all", "collecting") else pytest.mark.long)
    for case in itertools.product(("sim", "reward", "child", "orchestrator", "all"), ("collecting", "committing"))
]
DISTILL = list(itertools.product(("sim", "imitation", "child", "orchestrator", "all"), ("collecting", "fitting")))


@dataclass(frozen=True)
class Running:
    """The services by name, and what starts one again at its address."""

    services: dict[str, Any]
    start_again: Callable[[str], Any]
    client: OrchestratorClient
    data_dir: Path

    async def start(self, kind: str, config: dict[str, Any], key: str) -> str:
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                try:
                    return (await self.client.start_run(StartRunRequest(kind, config, key))).run.id
                except Unavailable:
                    await asyncio.sleep(0.1)

    async def end(self, run_id: str) -> Run:
        """Waits for the end of a run and returns it."""
        seen: list[Run] = []
        async with asyncio.timeout(TIMEOUT_S):
            while not seen or seen[-1].state in ("queued", "running"):
                try:
                    async with aclosing(self.client.watch_run(WatchRunRequest(run_id, len(seen)))) as watching:
                        seen += [event.run async for event in watching]
                except Unavailable:
                    await asyncio.sleep(0.1)
        return seen[-1]

    async def reached(self, run_id: str, step: int) -> None:
        """Waits until a run has reached a step."""
        async with asyncio.timeout(TIMEOUT_S), aclosing(self.client.watch_run(WatchRunRequest(run_id))) as watching:
            async for event in watching:
                if event.run.step >= step:
                    return

    def learned(self, run_id: str) -> list[dict[str, float]]:
        """Returns the metrics of a run's iterations, without what takes its time or depends on who was killed."""
        rows = map(json.loads, (self.data_dir / "runs" / run_id / "metrics.jsonl").read_text().splitlines())
        return [{name: row[name] for name in row.keys() - {"steps_per_s", "recoveries", "rejected"}} for row in rows]

    async def policy(self, run_id: str) -> str:
        """Returns the sha256 of a run's policy artifact."""
        parts = [part.data async for part in self.client.get_artifact(GetArtifactRequest(run_id, POLICY))]
        return hashlib.sha256(b"".join(parts)).hexdigest()

    def kill(self, victim: str) -> None:
        """Kills the child of the orchestrator, or services, which it starts again."""
        if victim == "child":
            descendants = psutil.Process(self.services["orchestrator"].process.pid).children(recursive=True)
            (child,) = (each.pid for each in descendants if each.name() == "orchestrator.runs"[:15])
            os.kill(child, signal.SIGKILL)
            return
        killed = list(self.services) if victim == "all" else [victim]
        for name in killed:
            self.services[name].kill()
        for name in killed:
            self.services[name].process.wait(60)
            self.services[name] = self.start_again(name)


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def running(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    reserve_ports: Any,
    start_module_service: Callable[..., Any],
) -> AsyncIterator[Running]:
    distils = any("student" in item.fixturenames for item in request.session.items)
    modules = {**MODULES, "imitation": "freerein_imitation"} if distils else MODULES
    data_dir, ports = tmp_path_factory.mktemp("matrix"), reserve_ports(modules)
    mine = {f"FREEREIN_{name.upper()}_ADDRESS": f"127.0.0.1:{each.grpc}" for name, each in ports.items()}
    mine |= {"FREEREIN_SHIPPED_DIR": "none", "FREEREIN_SIM_WORKERS": "1"}
    (data_dir / "lies").write_text("slow 1000000")  # so that there is time to kill somebody

    def start(name: str) -> Any:
        at = {"FREEREIN_HTTP_PORT": str(ports[name].rest), "FREEREIN_GRPC_PORT": str(ports[name].grpc)}
        return start_module_service(modules[name], data_dir, **mine, **at)

    services = {name: start(name) for name in modules}
    async with OrchestratorClient(Channel(services["orchestrator"].address)) as client:
        yield Running(services, start, client, data_dir)


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def undisturbed(running: Running) -> str:
    """Id of an undisturbed PPO run."""
    run_id = await running.start("ppo", TINY, "undisturbed")
    ended = await running.end(run_id)
    assert (ended.state, ended.step) == ("succeeded", TINY["iterations"]), ended.error
    return run_id


@pytest.mark.fault("O1")
@pytest.mark.fault("O2")
@pytest.mark.fault("O15")
@pytest.mark.fault("G4")
@pytest.mark.fault("G5")
@pytest.mark.parametrize(("victim", "moment"), PPO)
async def test_a_killed_ppo_run_ends_with_the_same_policy(
    running: Running, undisturbed: str, wait_until: Any, victim: str, moment: str
) -> None:
    run_id = await running.start("ppo", TINY, f"ppo-{victim}-{moment}")
    checkpoints = running.data_dir / "runs" / run_id / "checkpoints"
    count = 2 if moment == "collecting" else 3  # the first is from before the first iteration
    await asyncio.to_thread(wait_until, lambda: len(list(checkpoints.glob("step-*"))) >= count, TIMEOUT_S)
    running.kill(victim)
    ended = await running.end(run_id)
    assert (ended.state, ended.step) == ("succeeded", TINY["iterations"]), ended.error
    assert running.learned(run_id) == running.learned(undisturbed)
    assert await running.policy(run_id) == await running.policy(undisturbed)


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def student(running: Running, undisturbed: str) -> str:
    """Model version of an undisturbed distillation."""
    ended = await running.end(await running.start("distill", distilled(undisturbed, "undisturbed"), "distilled"))
    assert ended.model is not None, ended.error
    return ended.model.version


def distilled(teacher: str, name: str) -> dict[str, Any]:
    fit = {
        "steps": 1_000,
        "batch_size": 4,
        "features": 8,
        "text_features": 4,
        "hidden_size": 8,
        "log_every": 5,
        "checkpoint_every": 50,
    }
    return {
        "teachers": [teacher],
        "rollouts": ROLLOUTS,
        "num_envs": 2,
        "dataset": name,
        "model_name": name,
        "config": fit,
    }


@pytest.mark.fault("O1")
@pytest.mark.fault("O2")
@pytest.mark.fault("G4")
@pytest.mark.fault("G5")
@pytest.mark.long
@pytest.mark.parametrize(("victim", "moment"), DISTILL)
async def test_a_killed_distillation_ends_with_the_same_student(
    running: Running, undisturbed: str, student: str, wait_until: Any, victim: str, moment: str
) -> None:
    run_id = await running.start("distill", distilled(undisturbed, f"{victim}-{moment}"), f"distill-{victim}-{moment}")
    if moment == "collecting":
        data = running.data_dir / "runs" / run_id / "rollouts" / "data"
        await asyncio.to_thread(wait_until, lambda: len(list(data.glob("**/*.parquet"))) >= 2, TIMEOUT_S)
    else:
        await running.reached(run_id, ROLLOUTS + 1)
    running.kill(victim)
    ended = await running.end(run_id)
    assert ended.model is not None, ended.error
    assert ended.model.version == student
