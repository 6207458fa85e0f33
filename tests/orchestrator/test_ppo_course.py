"""A training that is saved after each iteration, and what becomes of it when something goes wrong."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from freerein.errors import FailedPrecondition
from freerein.learning import weights
from freerein_orchestrator import ppo_training
from freerein_orchestrator.curve import Curve
from freerein_orchestrator.networks import ActorCritic
from freerein_orchestrator.patience import Stopped
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.ppo_course import Course
from freerein_orchestrator.ppo_training import Outset, PPOTraining, roll_out
from freerein_orchestrator.rollout import Actions, Observations, Rewards, Rollout, Step

CPU = torch.device("cpu")
SMALL = PPOConfig(iterations=5, num_envs=4, steps=8, epochs=1, batch_size=16, scale_rewards=False, hidden=4)


class SignEnvironments:
    """A number; telling whether it is positive is worth 1."""

    num_envs = 4

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self._shown = self._draw()
        self._kept: list[Rewards] = []

    def reset(self) -> Observations:
        return self._shown

    def step(self, actions: Actions) -> Step:
        self._kept.append((actions == (self._shown > 0))[:, 0].astype(np.float32))
        self._shown = self._draw()
        ended = self._rng.random(4) < 0.2
        return Step(self._shown, ended, np.zeros(4, np.bool_), self._shown)

    def rewards(self) -> Rewards:
        kept, self._kept = np.stack(self._kept), []
        return kept

    def snapshots(self) -> tuple[bytes, ...]:
        return (json.dumps([self._rng.bit_generator.state, self._shown.tolist()]).encode(),)

    def restore(self, snapshots: tuple[bytes, ...]) -> None:
        self._rng.bit_generator.state, shown = json.loads(snapshots[0])
        self._shown, self._kept = np.array(shown, np.float32), []

    def _draw(self) -> Observations:
        return self._rng.standard_normal((4, 1), np.float32)


class SignRollouts:
    """Collects from them; `spoil` is called with the number of each rollout, from 1, and its rewards."""

    recoveries = 0

    def __init__(self, spoil: Callable[[int, Rewards], Rewards]) -> None:
        self._spoil = spoil
        self._count = 0

    def gather(self, actor: ActorCritic, outset: Outset) -> tuple[Rollout, Outset]:
        self._count += 1
        environments = SignEnvironments()
        environments.restore(outset.environments)
        honest = environments.rewards
        environments.rewards = lambda: self._spoil(self._count, honest())  # type: ignore[method-assign]
        return roll_out(actor, outset, environments, SMALL)

    def close(self) -> None:
        """Holds nothing."""


def begin() -> PPOTraining:
    spec = ppo_training.design(SMALL, observation=(1,), action_choices=2)
    return ppo_training.begin(SMALL, spec, SignEnvironments(), device=CPU)


def honest(_count: int, rewards: Rewards) -> Rewards:
    return rewards


def finish(
    folder: Path,
    *,
    spoil: Callable[[int, Rewards], Rewards] = honest,
    interrupt: Callable[[], None] = lambda: None,
    said: list[str] | None = None,
) -> str:
    """Returns the sha256 of the weights that a course ends with."""
    rollouts = SignRollouts(spoil)
    course = Course(
        folder,
        begin=begin,
        resume=lambda checkpoint: ppo_training.restore(checkpoint, SMALL, device=CPU),
        rollouts=lambda _: rollouts,
        curve=lambda last_step: Curve(folder, last_step=last_step),
        interrupt=interrupt,
        say=(said if said is not None else list[str]()).append,
    )
    return weights.sha256(course.finish().network)


def rows(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The sha256 of the weights of a course in which nothing goes wrong."""
    return finish(tmp_path_factory.mktemp("whole"))


def test_a_course_stopped_anywhere_ends_at_the_same_weights(tmp_path: Path, expected: str) -> None:
    for calls in range(1, 12):
        left = iter(range(calls))

        def interrupt(left: Iterator[int] = left) -> None:
            if next(left, None) is None:
                raise Stopped

        try:
            finish(tmp_path, interrupt=interrupt)
        except Stopped:
            continue
    assert finish(tmp_path) == expected
    assert finish(tmp_path) == expected
    assert [row["step"] for row in rows(tmp_path)] == [1, 2, 3, 4, 5]


def test_iterations_that_are_worthless_are_rolled_back_and_made_again(tmp_path: Path, expected: str) -> None:
    said: list[str] = []

    def spoil(count: int, rewards: Rewards) -> Rewards:
        return rewards * np.float32(np.nan) if count in (1, 4, 5) else rewards

    assert finish(tmp_path, spoil=spoil, said=said) == expected
    assert [text[:24] for text in said] == [
        "Rolled back, 1 in a row:",
        "Rolled back, 1 in a row:",
        "Rolled back, 2 in a row:",
    ]
    assert sum(row["rejected"] for row in rows(tmp_path)) == 3


def test_three_worthless_iterations_in_a_row_stop_the_run_with_a_diagnosis(tmp_path: Path) -> None:
    def spoil(count: int, rewards: Rewards) -> Rewards:
        return rewards[1:] if count >= 3 else rewards

    with pytest.raises(FailedPrecondition, match=r"Iteration 3 was worthless 3 times .* shape \(8, 4\)") as raised:
        finish(tmp_path, spoil=spoil)
    assert "log" in raised.value.hint
    with pytest.raises(FailedPrecondition, match=r"Iteration 3 .* policy_loss became nan"):
        finish(tmp_path, spoil=lambda _, rewards: np.full_like(rewards, 1e38))


def test_damaged_checkpoints_are_passed_over_with_a_word(tmp_path: Path, expected: str) -> None:
    finish(tmp_path)
    newest, before = sorted((tmp_path / "checkpoints").iterdir())[:0:-1]
    (newest / "state.safetensors").write_bytes(b"")
    (before / "manifest.json").unlink()
    said: list[str] = []
    assert finish(tmp_path, said=said) == expected
    assert [text[:13] for text in said] == ["Checkpoint 10", "Checkpoint 8 "]
    assert [row["step"] for row in rows(tmp_path)] == [1, 2, 3, 4, 5]


def test_a_disk_that_cannot_be_written_stops_the_run_after_three_times(tmp_path: Path, expected: str) -> None:
    said: list[str] = []
    (tmp_path / "checkpoints").write_text("in the way")
    with pytest.raises(FailedPrecondition, match="3 in a row could not be"):
        finish(tmp_path, said=said)
    assert [text[:11] for text in said] == ["Iteration 0", "Iteration 1", "Iteration 2"]
    (tmp_path / "checkpoints").unlink()
    assert finish(tmp_path) == expected
