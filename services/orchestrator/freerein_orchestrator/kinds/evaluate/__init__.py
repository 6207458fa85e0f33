"""Kind `evaluate`: measures policies and models against true states, which only an evaluation may see.

`record.py` says what is on disk. A form is one module: `returns`, `sentences`, `landmarks`, `demonstrations`,
`recipes`, `relations`, `segmentation`.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import torch

from freerein.clients.tasks import find_task
from freerein.config import parse
from freerein.errors import InvalidInput
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.evaluate import (
    demonstrations,
    landmarks,
    recipes,
    relations,
    returns,
    segmentation,
    sentences,
)
from freerein_orchestrator.kinds.evaluate.form import Form, FormConfig, Setup
from freerein_orchestrator.kinds.evaluate.record import TrialRecord
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.kinds.policy_video import can_film, save_video

FORMS: Mapping[str, Form[Any]] = {
    "returns": returns.FORM,
    "sentences": sentences.FORM,
    "landmarks": landmarks.FORM,
    "demonstrations": demonstrations.FORM,
    "recipes": recipes.FORM,
    "relations": relations.FORM,
    "segmentation": segmentation.FORM,
}
_TORCH_THREADS = 1


def _parse(values: Mapping[str, Any]) -> FormConfig:
    form = values.get("form", "returns")
    if not (isinstance(form, str) and form in FORMS):
        raise InvalidInput(
            f"`form` must be one of {', '.join(FORMS)}; got another value.",
            field="config.form",
            hint="Leave it out for returns.",
        )
    config: FormConfig = parse(FORMS[form].config, values)
    return config


def check(config: FormConfig, store: PolicyStore, earlier: Mapping[str, str]) -> None:
    """Checks what the form builds on."""
    FORMS[config.form].check(config, store, earlier)


def run(context: RunContext, config: FormConfig) -> None:
    """Runs the trials in rounds of `num_envs`; a killed run continues after the last whole round.

    Raises:
        Stopped: The run is to stop.
        InvalidInput: There is no such policy, model or task, or they do not fit.
        ServiceError: A service refuses.
    """
    torch.set_num_threads(_TORCH_THREADS)
    record, retry, sim = TrialRecord(context, config.episodes), context.retry(), context.client("sim")
    task = retry.call(lambda: find_task(sim, config.task))
    setup = Setup(context, config, task, sim, record.subject, retry.interrupt)
    evaluation = retry.call(lambda: FORMS[config.form].open(setup))
    while (done := record.count) < config.episodes:
        count = min(config.num_envs, config.episodes - done)
        record.add(evaluation.subject, retry.call(partial(evaluation.run_round, done, count)))
    result = retry.call(lambda: evaluation.result(record.trials()))
    header = {name: getattr(config, name) for name in ("form", "task", "conditions", "episodes", "num_envs", "seed")}
    if result.film is not None and can_film(context):
        save_video(context, result.film, dt_s=task.control_dt_s)
    record.write_result(result, {**header, "privileged": True})


_CONFIGS = {name: form.config for name, form in FORMS.items()}
KIND = Kind(
    _CONFIGS,
    _parse,
    steps=lambda config: config.episodes,
    run=run,
    check=check,
    truth=lambda _config, _store: "true states, which are privileged: to measure",
    meaning="Measures policies and models against true states, which only an evaluation may see.",
)
