"""The training loop under kill -9, SIGTERM and damage."""

import json
import os
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tests.freerein.line import CONFIG, CUT, STAGE_END, Line
from torch import nn

from freerein.errors import FailedPrecondition, OutOfStorage
from freerein.learning import checkpoints, weights
from freerein.learning.fit_config import FitConfig
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein.learning.training_loop import FitEvent, FitResult, fit, fit_and_save


class Diverging(Line):
    def loss(self, state: TrainState[nn.Linear], items: Items) -> Losses:
        return {"train_loss": super().loss(state, items)["train_loss"] * float("nan")}


class Normalised(nn.Module):
    """A line whose input is normalised by what was usual in training."""

    def __init__(self) -> None:
        super().__init__()
        self.norm = nn.BatchNorm2d(1)
        self.line = nn.Linear(1, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y: torch.Tensor = self.line(self.norm(x[:, :, None, None]).flatten(start_dim=1))
        return y


class NormalisedLine(Learner[Normalised]):
    """Fits `Normalised`, and leaves it in training mode after updates and in evaluation mode after evaluations."""

    config = CONFIG
    size = 10
    fingerprint = ""

    def init(self, generator: torch.Generator) -> TrainState[Normalised]:
        network = Normalised()
        weights.initialise(network, generator=generator)
        return TrainState.with_adam(network, 0.1, generator=generator)

    def loss(self, state: TrainState[Normalised], items: Items) -> Losses:
        x = torch.from_numpy(items).float()[:, None]
        return {"train_loss": (state.network.train()(x) - x).square().mean()}

    @torch.no_grad()
    def evaluate(self, state: TrainState[Normalised]) -> float:
        x = torch.arange(10.0)[:, None]
        loss: float = (state.network.eval()(x) - x).square().mean().item()
        return loss


def run(folder: Path, learner: Line | None = None) -> tuple[str, list[FitEvent]]:
    """Trains to the end; returns the sha256 of the weights and what happened."""
    events: list[FitEvent] = []
    fitted = fit(learner or Line(), folder, on_event=events.append)
    assert fitted is not None
    return sha256(fitted), events


def sha256(fitted: FitResult[nn.Linear]) -> str:
    return f"{weights.sha256(fitted.network)} {fitted.best_step} {fitted.validation_loss}"


def rows(folder: Path) -> str:
    return (folder / "metrics.jsonl").read_text()


@pytest.fixture
def undisturbed(tmp_path: Path) -> tuple[str, str]:
    digest, _ = run(tmp_path / "undisturbed")
    return digest, rows(tmp_path / "undisturbed")


@pytest.fixture
def child(tmp_path: Path, fork_program: Callable[..., Any]) -> Any:
    """A program that trains in `tmp_path / "cut"` and, about to make update CUT, waits for a line of input."""
    program = fork_program("tests.freerein.line", tmp_path / "cut")
    assert program.stdout.readline() == f"{CUT}\n"
    return program


@pytest.mark.fault("O1")
def test_a_training_killed_by_sigkill_goes_on_to_the_same_bits(
    child: Any, tmp_path: Path, undisturbed: tuple[str, str]
) -> None:
    child.process.send_signal(signal.SIGKILL)
    assert child.process.wait() == -signal.SIGKILL
    digest, events = run(tmp_path / "cut")
    assert events[0] == FitEvent("resumed", 5)
    assert (digest, rows(tmp_path / "cut")) == undisturbed
    shown = EventAccumulator(str(tmp_path / "cut" / "tensorboard")).Reload().Scalars("train/train_loss")
    assert [each.step for each in shown] == [json.loads(row)["step"] for row in rows(tmp_path / "cut").splitlines()]


def test_sigterm_saves_and_ends_and_the_training_goes_on_to_the_same_bits(
    child: Any, tmp_path: Path, undisturbed: tuple[str, str]
) -> None:
    child.process.send_signal(signal.SIGTERM)
    child.stdin.write("\n")
    child.stdin.flush()
    assert (child.stdout.read(), child.process.wait()) == ("stopped\n", 0)
    digest, events = run(tmp_path / "cut")
    assert events[0] == FitEvent("resumed", CUT + 1)
    assert (digest, rows(tmp_path / "cut")) == undisturbed


@pytest.mark.fault("G5")
def test_a_training_stopped_after_any_update_goes_on_to_the_same_bits(
    tmp_path: Path, undisturbed: tuple[str, str]
) -> None:
    for cut in range(CONFIG.steps):
        left, folder = iter(range(cut)), tmp_path / f"cut-{cut}"
        assert fit(Line(), folder, stop=lambda left=left: next(left, None) is None) is None  # type: ignore[misc]
        assert (run(folder)[0], rows(folder)) == undisturbed


@pytest.mark.fault("O3")
def test_a_damaged_newest_checkpoint_is_told_and_the_one_before_serves(
    tmp_path: Path, undisturbed: tuple[str, str]
) -> None:
    folder = tmp_path / "undisturbed"
    (folder / "checkpoints" / "step-000000012" / "state.safetensors").write_bytes(b"")
    digest, events = run(folder)
    assert [(event.kind, event.step) for event in events[:2]] == [("checkpoint_corrupt", 12), ("resumed", 10)]
    assert (digest, rows(folder)) == undisturbed


def test_a_finished_training_is_not_made_again(tmp_path: Path, undisturbed: tuple[str, str]) -> None:
    digest, events = run(tmp_path / "undisturbed")
    assert digest == undisturbed[0]
    assert events == [FitEvent("resumed", 12)]


def test_a_network_is_returned_in_evaluation_mode_whether_or_not_an_update_was_left_to_make(tmp_path: Path) -> None:
    digests = []
    for _ in range(2):
        fitted = fit(NormalisedLine(), tmp_path)
        assert fitted is not None
        assert not any(layer.training for layer in fitted.network.modules())
        fitted.network(torch.arange(10.0)[:, None])  # in training mode this would move what is usual
        digests.append(weights.sha256(fitted.network))
    assert digests[0] == digests[1]


@pytest.mark.fault("O7")
@pytest.mark.parametrize(
    ("change", "data", "message"),
    [
        ({"threads": 2}, "points", "config.threads was 1 and is 2"),
        ({"seed": 2}, "points", "config.seed was 1 and is 2"),
        ({}, "others", "data was points and is others"),
    ],
)
def test_a_training_is_resumed_as_it_was_begun_or_not_at_all(
    tmp_path: Path, undisturbed: tuple[str, str], change: dict[str, int], data: str, message: str
) -> None:
    with pytest.raises(FailedPrecondition, match=message):
        run(tmp_path / "undisturbed", Line(replace(CONFIG, **change), data=data))


@dataclass(frozen=True)
class LaterConfig(FitConfig):
    added: bool = False


def test_a_key_that_a_later_version_adds_is_as_by_default_in_earlier_checkpoints(
    tmp_path: Path, undisturbed: tuple[str, str]
) -> None:
    asked = iter(range(CUT + 1))
    assert fit(Line(), tmp_path / "parts", stop=lambda: next(asked) == CUT) is None
    with pytest.raises(FailedPrecondition, match="added was False and is True"):
        run(tmp_path / "parts", Line(LaterConfig(**vars(CONFIG), added=True)))
    assert run(tmp_path / "parts", Line(LaterConfig(**vars(CONFIG))))[0] == undisturbed[0]


def test_the_weights_of_the_last_stage_that_did_best_on_held_out_data_are_returned(
    tmp_path: Path, undisturbed: tuple[str, str]
) -> None:
    losses = {
        row["step"]: row["validation_loss"] for row in map(json.loads, undisturbed[1].splitlines()) if len(row) == 3
    }
    assert sorted(losses) == [4, 8, 12]
    best = fit(Line(replace(CONFIG, lr=0.5)), tmp_path / "best at first")
    assert best is not None
    earliest = json.loads(rows(tmp_path / "best at first").splitlines()[1])
    assert earliest["step"] == 4
    assert earliest["validation_loss"] < best.validation_loss
    fitted = fit(Line(), tmp_path / "undisturbed")
    assert fitted is not None
    losses.pop(4)
    assert fitted.best_step == min(losses, key=losses.__getitem__)
    assert (fitted.network.weight - 2).abs().item() == fitted.validation_loss == losses[fitted.best_step]


def test_rows_of_metrics_are_means_over_steps_of_one_stage(undisturbed: tuple[str, str]) -> None:
    assert [json.loads(row)["step"] for row in undisturbed[1].splitlines()] == [3, 4, STAGE_END, 6, 8, 9, 12]


def test_a_loss_that_is_not_finite_ends_the_training_with_advice(tmp_path: Path) -> None:
    with pytest.raises(FailedPrecondition, match="train_loss is nan after 1 updates") as error:
        run(tmp_path, Diverging())
    assert "learning rate" in error.value.hint


@pytest.mark.fault("O5")
def test_a_full_disk_is_told_and_survived_until_it_stays_full(tmp_path: Path, undisturbed: tuple[str, str]) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "checkpoints").write_bytes(b"a file where the folder should be: every save fails")
    digest, events = run(tmp_path / "full", Line(replace(CONFIG, checkpoint_every=12)))
    assert digest == undisturbed[0]
    assert [event.kind for event in events].count("checkpoint_failed") == 2
    with pytest.raises(OutOfStorage, match="3 in a row"):
        run(tmp_path / "full", Line(replace(CONFIG, checkpoint_every=2)))


def test_a_finished_fit_is_saved_with_its_figures(tmp_path: Path) -> None:
    saved: list[tuple[Path, Mapping[str, object]]] = []
    assert fit_and_save(Line(), tmp_path, lambda fitted, path: saved.append((path, fitted.figures)))
    [(path, figures)] = saved
    assert path == tmp_path / "model"
    assert set(figures) == {"validation_loss", "best_step"}


def test_rows_are_synced_before_the_checkpoint_that_counts_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced, fsync = list[str](), os.fsync

    def noted_fsync(descriptor: int) -> None:
        fsync(descriptor)
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    run(tmp_path)
    kept = [name for name in synced if name in ("metrics.jsonl", "manifest.json.tmp")]
    assert kept == ["metrics.jsonl", "manifest.json.tmp"] * 3


def test_a_torn_last_row_of_metrics_is_dropped(tmp_path: Path, undisturbed: tuple[str, str]) -> None:
    with (tmp_path / "undisturbed" / "metrics.jsonl").open("a") as file:
        file.write('{"step": 99, "tra')
    run(tmp_path / "undisturbed")
    assert rows(tmp_path / "undisturbed") == undisturbed[1]


def test_checkpoints_hold_nothing_but_safetensors_and_json(tmp_path: Path, undisturbed: tuple[str, str]) -> None:
    kept = tmp_path / "undisturbed" / "checkpoints"
    assert {path.suffix for path in kept.rglob("*") if path.is_file()} == {".safetensors", ".json"}
    assert len(list(kept.iterdir())) == checkpoints.KEPT
