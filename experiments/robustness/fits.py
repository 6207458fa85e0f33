"""Fits that several arms share, found by configuration and data; see `cache_paths`.

<work>/fits/<hash>/              checkpoints and metrics
                   model/        the model, as the service saves it
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from experiments.workbench.cache_paths import cache_path
from experiments.workbench.locks import locked
from freerein.learning import model_files
from freerein.learning.checkpoints import JSON
from freerein.learning.fit_config import FitConfig
from freerein.learning.learner import Learner
from freerein.learning.train_state import N
from freerein.learning.training_loop import FitResult, fit_and_save


def fit_once(
    config: FitConfig,
    inputs: Sequence[JSON],
    make_learner: Callable[[], Learner[N]],
    *,
    work: Path,
    on_progress: Callable[[], None],
) -> Path | None:
    """Returns the folder of a model, which is fitted where it is missing; None when SIGTERM stopped the fit.

    `inputs` tell apart what fits of one configuration learn from.
    """
    kind, version = type(config).__name__, torch.__version__
    folder = cache_path(work / "fits", {"kind": kind, "config": config, "inputs": inputs, "torch": version})
    with locked(folder.with_suffix(".lock")):
        if not (folder / "model" / model_files.MODEL.card).is_file():
            learner = make_learner()

            def save(fitted: FitResult[N], model: Path) -> None:
                model_files.save_model(fitted.network, model, card={"figures": fitted.figures})

            if not fit_and_save(learner, folder, save, on_event=lambda _: on_progress()):
                return None
    return folder / "model"
