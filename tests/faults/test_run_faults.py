"""The process of a run whose files are damaged and whose services lie: it ends as it would have, or says why not."""

import asyncio
import hashlib
import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.faults import chaos_proxy as network
from tests.faults.lies import tell
from tests.waiting import wait_until

from freerein.fork_server import ChildProcess, Program, StartChild
from freerein.jobs.child import PERMANENT_FAILURE
from freerein_orchestrator.kinds import KINDS

pytestmark = pytest.mark.e2e
PATIENCE_S = 500.0
LIES = "infinite", "huge", "short"
TINY = {
    "task": "grid",
    "goal_text": "more",
    "camera": "top",
    "reward": "base",
    "reward_model": "default",
    "encoder": "spatial",
    "iterations": 4,
    "num_envs": 2,
    "num_steps": 8,
    "epochs": 1,
    "batch_size": 8,
    "feature_size": 8,
    "hidden_size": 8,
}


class Run:
    """A run's folder, and the process that works in it.

    Args:
        folder: Of the run.
        environ: Says where services are.
        fork: Starts the process.
        config: What differs from `TINY`.
    """

    def __init__(self, folder: Path, environ: dict[str, str], fork: StartChild, **config: Any) -> None:
        self.folder = folder
        self._environ = environ
        self._fork = fork
        self.configure(**config)

    def configure(self, **config: Any) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        kind = KINDS["ppo"]
        job = {"kind": "ppo", "config": kind.dump(kind.parse({**TINY, **config})), "steps": 4}
        (self.folder / "config.json").write_text(json.dumps(job))

    @contextmanager
    def start(self) -> Iterator[ChildProcess]:
        """Yields the process, which ends with the block."""
        stdin, held = (os.fdopen(fd, mode) for fd, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
        with stdin, held, (self.folder / "log.txt").open("ab") as log:
            arguments = str(self.folder), str(self.folder.parents[1]), "cpu"
            files = stdin.fileno(), log.fileno(), log.fileno()
            yield self._fork(Program("freerein_orchestrator.runs", arguments, self._environ, *files))

    def finish(self) -> int:
        """Returns the exit code of a process that works until it ends."""
        with self.start() as process:
            return process.wait(PATIENCE_S)

    def until(self, checkpoints: int) -> None:
        wait_until(lambda: len(self.checkpoints) >= checkpoints, PATIENCE_S)

    def killed_after(self, checkpoints: int) -> None:
        """Works until there are so many checkpoints, of which the last three are kept, and no further."""
        with self.start() as process:
            self.until(checkpoints)
            process.send_signal(signal.SIGKILL)
            process.wait()

    @property
    def checkpoints(self) -> list[Path]:
        return sorted((self.folder / "checkpoints").glob("step-?????????"))

    @property
    def policy(self) -> str:
        return hashlib.sha256((self.folder / "artifacts" / "policy.safetensors").read_bytes()).hexdigest()

    @property
    def log(self) -> str:
        return (self.folder / "log.txt").read_text()

    @property
    def reason(self) -> str:
        """What the process said last: why it cannot succeed."""
        return self.log.splitlines()[-1]


@pytest.fixture(scope="module")
def reward(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service("tests.faults.faulty_reward", FREEREIN_SHIPPED_DIR="none")


@pytest.fixture(scope="module")
def environ(start_module_service: Callable[..., Any], reward: Any) -> dict[str, str]:
    sim = start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    where = {"FREEREIN_SIM_ADDRESS": sim.address, "FREEREIN_REWARD_ADDRESS": reward.address}
    return {**os.environ, **where, "OMP_NUM_THREADS": "1"}


@pytest.fixture
def lies(reward: Any) -> Iterator[Callable[[str], None]]:
    """A function that tells the reward service what nonsense to answer, and how often: `lies("nan 3")`."""
    told = reward.data_dir / "lies"
    yield partial(tell, told)
    tell(told, "")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, environ: dict[str, str], fork_child: StartChild) -> Run:
    """A run that nobody disturbed."""
    run = Run(tmp_path_factory.mktemp("whole") / "runs" / "whole", environ, fork_child)
    assert run.finish() == 0, run.log
    return run


@pytest.fixture
def run(tmp_path: Path, environ: dict[str, str], fork_child: StartChild) -> Run:
    return Run(tmp_path / "runs" / "run", environ, fork_child)


@pytest.fixture(scope="module")
def killed(
    tmp_path_factory: pytest.TempPathFactory, environ: dict[str, str], reward: Any, fork_child: StartChild
) -> Run:
    """A run that was killed when it had three checkpoints."""
    run, told = (
        Run(tmp_path_factory.mktemp("killed") / "runs" / "killed", environ, fork_child),
        reward.data_dir / "lies",
    )
    tell(told, "slow 1000000")
    run.killed_after(3)
    tell(told, "")
    assert len(run.checkpoints) == 3
    return run


@pytest.fixture
def begun(run: Run, killed: Run) -> Run:
    """The same, to be gone on with."""
    shutil.copytree(killed.folder, run.folder, dirs_exist_ok=True)
    return run


@pytest.mark.fault("N1")
async def test_a_training_over_a_bad_network_ends_with_the_same_policy(
    run: Run, whole: Run, environ: dict[str, str], fork_child: StartChild
) -> None:
    weather = network.Weather(delay_s=0.005, jitter_s=0.005, resets_after=200_000)  # a list of tasks gets through
    async with (
        network.ChaosProxy(environ["FREEREIN_SIM_ADDRESS"], weather) as sim,
        network.ChaosProxy(environ["FREEREIN_REWARD_ADDRESS"], weather) as reward,
    ):
        over = {"FREEREIN_SIM_ADDRESS": sim.address, "FREEREIN_REWARD_ADDRESS": reward.address}
        with Run(run.folder, {**environ, **over}, fork_child).start() as process:
            await asyncio.to_thread(run.until, 2)
            for proxy in (sim, reward):
                proxy.partition()
            await asyncio.sleep(1)
            for proxy in (sim, reward):
                proxy.heal()
            assert await asyncio.to_thread(process.wait, PATIENCE_S) == 0, run.log
        assert sim.connections > 1
    assert run.policy == whole.policy


@pytest.mark.fault("O8")
@pytest.mark.fault("O12")
@pytest.mark.parametrize(
    "lie", ["nan", *(pytest.param(lie, marks=pytest.mark.long) for lie in ("infinite", "huge", "short"))]
)
def test_nonsense_is_rolled_back_and_a_tracker_that_cannot_be_written_stops_no_training(
    run: Run, whole: Run, lies: Callable[[str], None], lie: str
) -> None:
    (run.folder / "tensorboard").write_text("in the way")
    lies("slow 1000000")
    with run.start() as process:
        run.until(2)
        lies(f"{lie} 2")
        assert process.wait(PATIENCE_S) == 0
    assert run.policy == whole.policy
    assert "Rolled back, 1 in a row" in run.log
    rows = [json.loads(line)["step"] for line in (run.folder / "metrics.jsonl").read_text().splitlines()]
    assert rows == [1, 2, 3, 4]


def rewrite(checkpoint: Path, name: str, data: bytes) -> None:
    """Replaces a file of a checkpoint, and its sha256 in the manifest."""
    (checkpoint / name).write_bytes(data)
    manifest = json.loads((checkpoint / "manifest.json").read_text())
    manifest["files"][name] = hashlib.sha256(data).hexdigest()
    (checkpoint / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.fault("O13")
def test_a_checkpoint_that_is_a_program_is_never_run(begun: Run, whole: Run, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    gadget = b"cposix\nsystem\n(S'touch %s'\ntR." % str(ran).encode()
    _, second, newest = begun.checkpoints
    rewrite(newest, "state.safetensors", gadget)
    rewrite(second, "state.safetensors", (1 << 40).to_bytes(8, "little") + b"{" * 64)  # a header of a terabyte
    assert begun.finish() == 0
    assert begun.policy == whole.policy
    assert begun.log.count("is skipped") == 2
    assert not ran.exists()


@pytest.mark.fault("O13")
def test_a_policy_that_is_a_program_or_of_other_weights_is_refused(run: Run, whole: Run, tmp_path: Path) -> None:
    ran, planted = tmp_path / "ran", tmp_path / "runs" / ("0" * 32)
    shutil.copytree(whole.folder / "artifacts", planted / "artifacts")
    run.configure(init_from="0" * 32)
    policy = planted / "artifacts" / "policy.safetensors"
    policy.write_bytes(b"cposix\nsystem\n(S'touch %s'\ntR." % str(ran).encode())
    assert run.finish() == PERMANENT_FAILURE
    assert not ran.exists()
    assert "Traceback" not in run.log
