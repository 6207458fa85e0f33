"""Trains the grounding model on synthetic images: `python -m freerein_reward.pretrain FOLDER`.

It is published as FOLDER/models/grounding/<version>/. The same command resumes after a kill.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freerein.errors import ServiceError
from freerein.learning.model_files import choose_device, save_model
from freerein.learning.training_loop import FitEvent, FitResult, fit_and_save
from freerein.model_store import ModelStore
from freerein_reward.command_line import device, file_problem, setting
from freerein_reward.model import GROUNDING, DualEncoder, GradCamModel
from freerein_reward.training.config import GroundingConfig
from freerein_reward.training.evaluation import evaluate_grounding
from freerein_reward.training.grounding_learner import GroundingLearner
from freerein_reward.training.known_phrases import evaluate_known_phrases

_LIMITS = (
    "It names things by colour: see `names`. It tells shapes badly (`shape_accuracy`, `known_shapes`), and knows no "
    "other nouns. Trained on drawings; not measured on photographs."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Trains and publishes the grounding model; returns the process's exit code, 1 when it was stopped before."""
    parser = argparse.ArgumentParser(prog="python -m freerein_reward.pretrain", description="Train a grounding model.")
    parser.add_argument("folder", type=Path, help="folder for checkpoints, metrics and the model")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="override a configuration key, e.g. seed=1")
    parser.add_argument("--device", type=device, default="cpu", help="auto, cpu or cuda:N")
    options = parser.parse_args(arguments)
    try:
        config = GroundingConfig.from_mapping(dict(map(setting, options.settings)))
        return _pretrain(options.folder, GroundingLearner(config, choose_device(options.device)))
    except ServiceError as error:
        parser.error(f"{error.detail} {error.hint}")
    except OSError as error:
        parser.error(file_problem(error))


def _pretrain(folder: Path, learner: GroundingLearner) -> int:
    def save(fitted: FitResult[DualEncoder], path: Path) -> None:
        save_model(fitted.network, path, card=_card(learner, fitted))

    if not fit_and_save(learner, folder, save, on_event=_print_event):
        return 1
    store = ModelStore(folder / "models")
    ref = store.publish(GROUNDING, folder / "model")
    store.activate(ref)
    sys.stdout.write(f"{ref.name} {ref.version}\n")
    return 0


def _print_event(event: FitEvent) -> None:
    sys.stdout.write(f"{event.step} {event.kind} {event.detail}\n")
    sys.stdout.flush()


def _card(learner: GroundingLearner, fitted: FitResult[DualEncoder]) -> Mapping[str, Any]:
    return {
        "method": GROUNDING,
        "data": "synthetic images of single objects, freerein_reward.training.synthetic_objects",
        "command": "python -m freerein_reward.pretrain FOLDER",
        "config": asdict(learner.config),
        "names": list(GradCamModel(fitted.network).names),
        "figures": {
            **fitted.figures,
            **evaluate_grounding(fitted.network, learner),
            **evaluate_known_phrases(fitted.network, learner),
        },
        "supervision": "captions of single objects, without positions and relations",
        "limits": _LIMITS,
    }


if __name__ == "__main__":
    raise SystemExit(main())
