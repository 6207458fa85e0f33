"""The training loop: what it learns, that it resumes to the same bits, and what it does when something fails."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from freerein.errors import FailedPrecondition, InvalidInput, OutOfStorage
from freerein.learning import checkpoints, tensor_files
from freerein.learning.actor_critic.networks import ActorCritic
from freerein_orchestrator.kinds.metrics_logger import MetricsLogger
from freerein_orchestrator.rl.config import PPOConfig, Schedule
from freerein_orchestrator.rl.errors import Stopped
from freerein_orchestrator.rl.initial_network import network_spec
from freerein_orchestrator.rl.rollout import CollectorState, RolloutBuffer, collect
from freerein_orchestrator.rl.state import (
    PPOState,
    from_checkpoint,
    init_state,
    to_checkpoint,
    trained_on,
)
from freerein_orchestrator.rl.trainer import Trainer
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecEnv, VecStep

CPU = torch.device("cpu")
FRAME = (12, 12, 1)
FRAMES = PPOConfig(
    iterations=6,
    num_envs=8,
    num_steps=32,
    epochs=4,
    batch_size=64,
    lr=5e-3,
    gamma=0.5,
    ent_coef=0.005,
    normalise_rewards=False,
    feature_size=16,
    hidden_size=16,
)
SHORT = replace(FRAMES, iterations=4, num_steps=8, batch_size=32, epochs=1, normalise_rewards=True)

Spoil = Callable[[int, Rewards], Rewards]
"""Given the number of a rollout, from 1, and its rewards, returns other rewards."""


class DotEnvs:
    """A dot left or right in a frame moves at random; an action of its side's sign earns 1, others 0.

    Episodes terminate at random, or are truncated after 10 timesteps.
    """

    def __init__(self, num_envs: int = 8, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self._is_right, self._ages = np.zeros(num_envs, np.bool_), np.zeros(num_envs, np.int64)
        self._rewards: list[Rewards] = []

    @property
    def num_envs(self) -> int:
        return len(self._ages)

    def reset(self) -> Observations:
        self._ages[:] = 0
        return self._move()

    def step(self, actions: Actions) -> VecStep:
        self._rewards.append(((actions[:, 0] > 0) == self._is_right).astype(np.float32))
        self._ages += 1
        terminated, truncated = self._rng.random(self.num_envs) < 0.05, self._ages >= 10
        final = self._move()
        self._ages[terminated | truncated] = 0
        return VecStep(self._move(), terminated, truncated, final)

    def rewards(self) -> Rewards:
        rewards, self._rewards = np.stack(self._rewards), []
        return rewards

    def snapshots(self) -> tuple[bytes, ...]:
        state = self._rng.bit_generator.state, self._is_right.tolist(), self._ages.tolist()
        return (json.dumps(state).encode(),)

    def restore(self, snapshot: bytes) -> None:
        self._rng.bit_generator.state, is_right, ages = json.loads(snapshot)
        self._is_right, self._ages, self._rewards = np.array(is_right), np.array(ages), []

    def _move(self) -> Observations:
        self._is_right = self._rng.random(self.num_envs) < 0.5
        frames = self._rng.integers(90, 110, (self.num_envs, *FRAME), np.uint8)
        frames[np.arange(self.num_envs), 4:8, np.where(self._is_right, 9, 2)] = 255
        return frames


class CueEnvs:
    """A cue, +1 or -1, is seen once; naming it three timesteps later earns 1, anything else 0."""

    def __init__(self, num_envs: int = 16) -> None:
        self._rng = np.random.default_rng(0)
        self._cues, self._t = np.zeros(num_envs), 0
        self._rewards: list[Rewards] = []

    @property
    def num_envs(self) -> int:
        return len(self._cues)

    def reset(self) -> Observations:
        self._cues, self._t = self._rng.choice([-1.0, 1.0], self.num_envs), 0
        return self._observe()

    def step(self, actions: Actions) -> VecStep:
        is_last, self._t = self._t == 3, self._t + 1
        self._rewards.append((is_last & ((actions[:, 0] == 1) == (self._cues > 0))).astype(np.float32))
        seen = self.reset() if is_last else self._observe()
        return VecStep(seen, np.full(self.num_envs, is_last), np.zeros(self.num_envs, np.bool_), seen)

    def rewards(self) -> Rewards:
        rewards, self._rewards = np.stack(self._rewards), []
        return rewards

    def snapshots(self) -> tuple[bytes, ...]:
        return (json.dumps([self._rng.bit_generator.state, self._cues.tolist(), self._t]).encode(),)

    def restore(self, snapshot: bytes) -> None:
        self._rng.bit_generator.state, cues, self._t = json.loads(snapshot)
        self._cues = np.array(cues)

    def _observe(self) -> Observations:
        cues = self._cues if self._t == 0 else np.zeros_like(self._cues)
        return np.stack([cues, np.full_like(cues, self._t == 3)], axis=1).astype(np.float32)


class LocalCollector:
    """Collects from environments in this process, restored for each rollout."""

    recoveries = 0

    def __init__(self, envs: DotEnvs | CueEnvs, config: PPOConfig, spoil: Spoil | None = None) -> None:
        self._envs = envs
        self._config = config
        self._spoil = spoil
        self._count = 0

    def collect(self, network: ActorCritic, state: CollectorState) -> tuple[RolloutBuffer, CollectorState]:
        self._count += 1
        self._envs.restore(state.env_snapshots[0])
        envs: VecEnv = self._envs
        if self._spoil is not None:
            envs = _Spoilt(self._envs, lambda rewards: self._spoil(self._count, rewards))  # type: ignore[misc]
        return collect(network, envs, state, num_steps=self._config.num_steps)

    def close(self) -> None:
        """Holds nothing."""


class _Spoilt:
    """Environments with other rewards."""

    def __init__(self, envs: DotEnvs | CueEnvs, spoil: Callable[[Rewards], Rewards]) -> None:
        self.num_envs, self.reset, self.step, self.snapshots = envs.num_envs, envs.reset, envs.step, envs.snapshots
        self._envs = envs
        self._spoil = spoil

    def rewards(self) -> Rewards:
        return self._spoil(self._envs.rewards())


def dot_state(
    config: PPOConfig, envs: VecEnv | None = None, *, frame_stack: int = 1, action_repeat: int = 1
) -> PPOState:
    spec = network_spec(config, observation=FRAME, frame_stack=frame_stack, action_repeat=action_repeat)
    return init_state(config, spec, envs or DotEnvs(), device=CPU)


def train(
    folder: Path,
    config: PPOConfig = SHORT,
    *,
    spoil: Spoil | None = None,
    interrupt: Callable[[], None] = lambda: None,
    log: list[str] | None = None,
    finished: PPOState | None = None,
    frame_stack: int = 1,
    action_repeat: int = 1,
) -> PPOState:
    """Trains on the dots, or resumes; goes on with a finished training if there is one."""
    collector = LocalCollector(DotEnvs(seed=99), config, spoil)
    return Trainer(
        folder,
        init=lambda: (
            trained_on(to_checkpoint(finished), config, device=CPU)
            if finished
            else dot_state(config, frame_stack=frame_stack, action_repeat=action_repeat)
        ),
        load=lambda checkpoint: from_checkpoint(checkpoint, config, device=CPU),
        collector=lambda _: collector,
        metrics_log=lambda last_step: MetricsLogger(folder, last_step=last_step),
        interrupt=interrupt,
        log_line=(log if log is not None else list[str]()).append,
    ).train()


def digest(state: PPOState) -> str:
    """Returns the sha256 of the complete state."""
    checkpoint = to_checkpoint(state)
    document = json.dumps(dict(checkpoint.document), sort_keys=True).encode()
    return hashlib.sha256(tensor_files.dump(checkpoint.tensors) + document).hexdigest()


def rows(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The digest of an undisturbed training."""
    return digest(train(tmp_path_factory.mktemp("undisturbed")))


def test_actions_are_learned_from_frames(tmp_path: Path) -> None:
    train(tmp_path, FRAMES)
    rewards = [row["episode_return"] / row["episode_length"] for row in rows(tmp_path)]
    assert len(rewards) == FRAMES.iterations
    assert rewards[0] < 0.65
    assert rewards[-1] > 0.9


def test_timesteps_and_lengths_of_episodes_count_each_timestep_of_an_action_that_is_held(tmp_path: Path) -> None:
    train(tmp_path / "once")
    train(tmp_path / "thrice", action_repeat=3)
    for once, thrice in zip(rows(tmp_path / "once"), rows(tmp_path / "thrice"), strict=True):
        assert thrice["timesteps"] == 3 * once["timesteps"]
        assert thrice["episode_length"] == 3 * once["episode_length"]
        assert thrice["episode_return"] == once["episode_return"]


def test_a_recurrent_policy_learns_to_remember(tmp_path: Path) -> None:
    config = PPOConfig(
        iterations=12,
        num_steps=16,
        batch_size=128,
        lr=2e-2,
        normalise_rewards=False,
        hidden_size=16,
        recurrent=True,
    )
    spec = network_spec(config, observation=(2,), action_choices=2)
    Trainer(
        tmp_path,
        init=lambda: init_state(config, spec, CueEnvs(), device=CPU),
        load=lambda checkpoint: from_checkpoint(checkpoint, config, device=CPU),
        collector=lambda _: LocalCollector(CueEnvs(), config),
        metrics_log=lambda last_step: MetricsLogger(tmp_path, last_step=last_step),
    ).train()
    assert np.mean([row["episode_return"] for row in rows(tmp_path)[-3:]]) > 0.95  # 0.5 without memory


def test_a_training_resumed_from_any_checkpoint_ends_with_the_same_bits(tmp_path: Path) -> None:
    config, frame_stack = replace(SHORT, recurrent=True), 3
    for iteration in range(3):

        def stop(log: Path = tmp_path / "metrics.jsonl", iteration: int = iteration) -> None:
            if log.is_file() and len(log.read_bytes().splitlines()) > iteration:
                raise Stopped

        with pytest.raises(Stopped):
            train(tmp_path, config, interrupt=stop, frame_stack=frame_stack)
    state = train(tmp_path, config)
    assert digest(state) == digest(train(tmp_path / "undisturbed", config, frame_stack=frame_stack))
    assert digest(train(tmp_path, config)) == digest(state)


def test_a_training_stopped_anywhere_ends_with_the_same_bits_and_one_row_per_iteration(
    tmp_path: Path, expected: str
) -> None:
    for calls in (1, 4, 2):
        left = iter(range(calls))

        def interrupt(left: Iterator[int] = left) -> None:
            if next(left, None) is None:
                raise Stopped

        with pytest.raises(Stopped):
            train(tmp_path, interrupt=interrupt)
    assert digest(train(tmp_path)) == expected
    assert [row["step"] for row in rows(tmp_path)] == [1, 2, 3, 4]
    shown = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    for curve in ("rollout/episode_return", "train/value_loss", "time/steps_per_s"):
        assert [each.step for each in shown.Scalars(curve)] == [64, 128, 192, 256]


@pytest.mark.fault("O8")
def test_rejected_iterations_are_rolled_back_and_repeated(tmp_path: Path, expected: str) -> None:
    log: list[str] = []

    def spoil(count: int, rewards: Rewards) -> Rewards:
        return rewards * np.float32(np.nan) if count in (1, 4, 5) else rewards

    assert digest(train(tmp_path, spoil=spoil, log=log)) == expected
    assert [text[:24] for text in log] == [
        "Rolled back, 1 in a row:",
        "Rolled back, 1 in a row:",
        "Rolled back, 2 in a row:",
    ]
    assert sum(row["rejected"] for row in rows(tmp_path)) == 3


@pytest.mark.fault("O8")
def test_three_rejected_iterations_in_a_row_stop_the_training_with_a_diagnosis(tmp_path: Path) -> None:
    def spoil(count: int, rewards: Rewards) -> Rewards:
        return rewards[1:] if count >= 3 else rewards

    with pytest.raises(FailedPrecondition, match=r"Iteration 3 was rejected 3 times .* shape \(8, 8\)") as raised:
        train(tmp_path, spoil=spoil)
    assert "log" in raised.value.hint
    unscaled = replace(SHORT, normalise_rewards=False)
    with pytest.raises(FailedPrecondition, match=r"Iteration 1 .* policy_loss became nan"):
        train(tmp_path / "huge", unscaled, spoil=lambda _, rewards: np.full_like(rewards, 1e38))


@pytest.mark.fault("O3")
def test_damaged_checkpoints_are_skipped_and_named(tmp_path: Path, expected: str) -> None:
    train(tmp_path)
    newest, before = sorted((tmp_path / "checkpoints").iterdir())[:0:-1]
    (newest / "state.safetensors").write_bytes(b"")
    (before / "manifest.json").unlink()
    log: list[str] = []
    assert digest(train(tmp_path, log=log)) == expected
    assert [text[:13] for text in log] == ["Checkpoint 8 ", "Checkpoint 6 "]
    assert [row["step"] for row in rows(tmp_path)] == [1, 2, 3, 4]


@pytest.mark.fault("O5")
def test_a_disk_that_cannot_be_written_stops_the_training_after_three_failures(tmp_path: Path, expected: str) -> None:
    log: list[str] = []
    (tmp_path / "checkpoints").write_text("in the way")
    with pytest.raises(OutOfStorage, match="3 in a row could not be"):
        train(tmp_path, log=log)
    assert [text[:11] for text in log] == ["Iteration 0", "Iteration 1", "Iteration 2"]
    (tmp_path / "checkpoints").unlink()
    assert digest(train(tmp_path)) == expected


@pytest.mark.fault("O7")
def test_a_checkpoint_is_not_resumed_with_another_configuration_or_other_inputs() -> None:
    checkpoint = to_checkpoint(replace(dot_state(SHORT), inputs={"sims": 1, "camera": "front"}))
    with pytest.raises(FailedPrecondition, match=r"clip_range was 0\.2 and is 0\.3.* inputs\.sims was 1 and is 2"):
        from_checkpoint(checkpoint, replace(SHORT, clip_range=0.3), device=CPU, inputs={"sims": 2})


def test_environments_that_do_not_fit_the_configuration_are_refused() -> None:
    with pytest.raises(InvalidInput, match="8 environments; got 4"):
        dot_state(FRAMES, DotEnvs(4))
    with pytest.raises(InvalidInput, match="uint8"):
        init_state(FRAMES, network_spec(FRAMES, observation=(24, 24, 1)), DotEnvs(), device=CPU)


def test_a_row_is_synced_before_the_checkpoint_that_counts_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced, fsync = list[str](), os.fsync

    def noted_fsync(descriptor: int) -> None:
        fsync(descriptor)
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    train(tmp_path)
    kept = [name for name in synced if name in ("metrics.jsonl", "manifest.json.tmp")]
    assert kept == ["manifest.json.tmp", *["metrics.jsonl", "manifest.json.tmp"] * SHORT.iterations]


def test_a_finished_training_goes_on_with_all_of_its_state(tmp_path: Path) -> None:
    finished = train(tmp_path, replace(SHORT, recurrent=True))
    before, more = to_checkpoint(finished), replace(SHORT, recurrent=True, iterations=3, lr=1e-3)
    state = trained_on(before, more, device=CPU)
    after = to_checkpoint(state).tensors
    assert after.keys() == before.tensors.keys()
    assert all(torch.equal(after[name], tensor) for name, tensor in before.tensors.items())
    assert (state.iteration, state.schedule) == (0, Schedule(iterations=4, before=4))
    assert state.timesteps == finished.timesteps


def test_noise_and_learning_rate_keep_their_last_values(tmp_path: Path) -> None:
    finished = train(tmp_path)
    state = train(tmp_path / "more", finished=finished)
    again = train(tmp_path / "again", replace(SHORT, iterations=1), finished=state)
    lrs, timesteps = ([row[name] for row in rows(tmp_path / "more")] for name in ("lr", "timesteps"))
    assert lrs == [pytest.approx(SHORT.lr / 5)] * 4
    assert timesteps == [64.0 * iteration for iteration in (5, 6, 7, 8)]
    assert again.schedule == Schedule(iterations=4, before=8)
    assert again.schedule.log_std(SHORT, 0) == SHORT.final_log_std


def test_a_training_that_goes_on_is_stopped_anywhere_and_ends_with_the_same_bits(tmp_path: Path) -> None:
    finished = train(tmp_path / "finished")
    expected = digest(train(tmp_path / "undisturbed", finished=finished))
    for calls in (1, 6):
        left = iter(range(calls))

        def interrupt(left: Iterator[int] = left) -> None:
            if next(left, None) is None:
                raise Stopped

        with pytest.raises(Stopped):
            train(tmp_path, interrupt=interrupt, finished=finished)
    assert digest(train(tmp_path, finished=finished)) == expected


def test_a_checkpoint_of_a_version_without_schedules_or_stacks_is_resumed(tmp_path: Path, expected: str) -> None:
    def stop() -> None:
        if (tmp_path / "metrics.jsonl").is_file() and len(rows(tmp_path)) == 2:
            raise Stopped

    with pytest.raises(Stopped):
        train(tmp_path, interrupt=stop)
    saved = checkpoints.newest(tmp_path / "checkpoints", on_corrupt=lambda *_: None)
    assert saved is not None
    earlier = json.loads(json.dumps({name: value for name, value in saved.document.items() if name != "schedule"}))
    for key in ("cameras", "frame_stack", "gray"):
        del earlier["identity"]["network"][key]
    checkpoints.save(tmp_path / "checkpoints", replace(saved, document=earlier))
    assert digest(train(tmp_path)) == expected
