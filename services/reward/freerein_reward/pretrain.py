"""Makes the grounding model, from pictures that are drawn here: `python -m freerein_reward.pretrain FOLDER`.

It is published as FOLDER/models/grounding/<version>/. Killed, the same command goes on where it was.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freerein.errors import ServiceError
from freerein.jobs.child import stop_on_sigterm
from freerein.learning.fit import FitEvent, FitResult, fit
from freerein.learning.model_files import choose_device, save_model
from freerein.serving.model_store import ModelStore
from freerein_reward.model import GROUNDING, DualEncoder
from freerein_reward.training import GroundingConfig, GroundingLearner, calibrate, measure


def main(arguments: Sequence[str] | None = None) -> int:
    """Trains and publishes the grounding model; returns the process's exit code, 1 where it was stopped before."""
    parser = argparse.ArgumentParser(prog="python -m freerein_reward.pretrain", description="Make the grounding model.")
    parser.add_argument("folder", type=Path, help="for checkpoints, metrics and the model")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="of the configuration, such as seed=1")
    parser.add_argument("--device", default="cpu", help="auto, cpu or cuda:N")
    asked = parser.parse_args(arguments)
    try:
        config = GroundingConfig.from_mapping(dict(_setting(each) for each in asked.settings))
        return _pretrain(asked.folder, GroundingLearner(config, choose_device(asked.device)))
    except ServiceError as error:
        parser.error(f"{error.detail} {error.hint}")


def _pretrain(folder: Path, learner: GroundingLearner) -> int:
    with stop_on_sigterm() as stop:
        fitted = fit(learner, folder, stop=stop, on_event=_say)
    if fitted is None:
        return 1
    calibrate(fitted.network, learner)
    save_model(fitted.network, folder / "model", card=_card(learner, fitted))
    store = ModelStore(folder / "models")
    ref = store.publish(GROUNDING, folder / "model")
    store.activate(ref)
    sys.stdout.write(f"{ref.name} {ref.version}\n")
    return 0


def _say(event: FitEvent) -> None:
    sys.stdout.write(f"{event.step} {event.kind} {event.detail}\n")
    sys.stdout.flush()


def _setting(text: str) -> tuple[str, object]:
    key, _, value = text.partition("=")
    return key, json.loads(value)


def _card(learner: GroundingLearner, fitted: FitResult[DualEncoder]) -> Mapping[str, Any]:
    return {
        "kind": GROUNDING,
        "data": "pictures of single objects, drawn by freerein_reward.training.objects",
        "command": "python -m freerein_reward.pretrain FOLDER",
        "config": asdict(learner.config),
        "figures": {
            "validation_loss": fitted.validation_loss,
            "best_step": fitted.best_step,
            **measure(fitted.network, learner),
        },
        "supervision": "captions of single objects, which name no place and no relation",
    }


if __name__ == "__main__":
    raise SystemExit(main())
