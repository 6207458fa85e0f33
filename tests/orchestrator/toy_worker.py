"""An orchestrator without REST and gRPC, with JSON commands on stdin: arguments DATA_DIR NAME DATABASE_URL."""

import asyncio
import json
import os
import signal
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freerein.errors import ServiceError
from freerein.fork_server import ForkServer, StartChild
from freerein.jobs import attempt
from freerein.jobs.attempt import AttemptRunner
from freerein.jobs.store import JobStore
from freerein.serving.health import Health
from freerein.types.orchestrator import (
    CancelRunRequest,
    GetRunRequest,
    ListRunsRequest,
    ResumeRunRequest,
    StartRunRequest,
    WatchRunRequest,
)
from freerein_orchestrator.runs.dbos_queue import DbosQueue
from freerein_orchestrator.runs.service import Resolved, RunService

_CHILD = "tests.orchestrator.toy_child"
attempt._CANCEL_S = 15.0  # a child that saves may have to wait for its machine


async def main(data_dir: Path, name: str, url: str, start_child: StartChild) -> int:
    health, store = Health(), JobStore(data_dir / "runs", noun="run")
    runner = AttemptRunner(store, module=_CHILD, arguments=(name,), start_child=start_child)
    queue = DbosQueue(
        data_dir / "runs",
        store=store,
        attempt=runner.run,
        database_url=url,
        executor_id=name,
        takeover_s=1.0,  # on a busy machine a run that was dequeued may take half a second to begin
        answer_s=5.0,
    )
    runs = RunService(store, queue, resolve=resolve, health=health)
    try:
        await runs.start()
    except ServiceError as error:
        sys.stderr.write(error.detail)
        await runs.close()
        return 3
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, health.drain)
    say("open")
    commands = asyncio.create_task(obey(runs))
    await health.wait_for_drain()
    commands.cancel()
    await asyncio.wait({commands})
    await runs.close()
    return 0


def say(reply: Any) -> None:
    sys.stdout.write(json.dumps(reply) + "\n")
    sys.stdout.flush()


async def obey(runs: RunService) -> None:
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    pipe, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    try:
        while line := await reader.readline():
            command = json.loads(line)
            try:
                reply = await answer(runs, command.pop("do"), **command)
            except ServiceError as error:
                reply = {"error": type(error).__name__}
            say(reply)
    finally:
        pipe.close()


async def answer(runs: RunService, do: str, **values: Any) -> Any:
    match do:
        case "start":
            return asdict((await runs.start_run(StartRunRequest("ppo", values["config"], values["key"]))).run)
        case "get":
            return asdict((await runs.get_run(GetRunRequest(values["id"]))).run)
        case "cancel":
            return asdict((await runs.cancel_run(CancelRunRequest(values["id"]))).run)
        case "resume":
            return asdict((await runs.resume_run(ResumeRunRequest(values["id"]))).run)
        case "watch":
            events = []
            async for event in runs.watch_run(WatchRunRequest(values["id"], values["start"])):
                events.append({"sequence": event.sequence, **asdict(event.run)})
                if event.run.step >= values["until_step"]:
                    break
            return events
        case "list":
            return [asdict(run) for run in (await runs.list_runs(ListRunsRequest())).runs]


def resolve(_kind: str, config: Mapping[str, Any]) -> Resolved:
    whole = {"steps": 5, **config}
    return Resolved(whole, whole["steps"])


if __name__ == "__main__":
    start_child = ForkServer.fork().start
    os._exit(asyncio.run(main(Path(sys.argv[1]), sys.argv[2], sys.argv[3], start_child)))  # as the orchestrator does
