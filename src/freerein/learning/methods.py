"""The methods of a learned service: how a model is configured, trained, saved and loaded.

A method is one `Method`, registered by its name in the service's `Methods`. A fit's configuration names it by the key
`method`, and so does the card of the model that the fit makes.
"""

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import nn

from freerein.atomic_files import write_atomic
from freerein.config import parse
from freerein.config_schema import config_schema
from freerein.data.lookup import choose_cameras, unseen_cameras
from freerein.errors import InvalidInput
from freerein.jobs.child import run_child
from freerein.learning.fit_config import DatasetFitConfig, FitConfig
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.in_distribution import InDistribution
from freerein.learning.learner import Learner
from freerein.learning.model_files import choose_device, read_card, save_model
from freerein.learning.train_state import N
from freerein.learning.training_loop import FitEvent, FitResult, fit_and_save

C = TypeVar("C", bound=DatasetFitConfig)
L = TypeVar("L", bound=Learner[Any])
M_co = TypeVar("M_co", covariant=True)


@dataclass(frozen=True)
class Method(Generic[C, L, N, M_co]):
    """One way to train a model of class M_co, with a configuration C, a learner L and a network N.

    Attributes:
        config: Class of the configuration.
        check: Raises InvalidInput where the dataset cannot be trained on, before a fit is queued; what it returns
            does not matter. Further keyword arguments are as of `prepare`.
        prepare: Returns the learner of a fit, for a dataset, a resolved configuration and a device; further keyword
            arguments are the resources of `Methods.run_fit`.
        card: Returns the card's entries of this method, such as `supervision`; they replace the common ones of the
            same name.
        load: Returns the model in a folder, for a device `auto`, `cpu` or `cuda:N`. Raises InvalidInput where a file is
            missing or malformed.
        complete: Returns the configuration completed by what the dataset decides.
        files: Returns files of the model beside weights and card, by name.
        needs_actions: Whether it learns from executed actions. One whose configuration has `use_actions` does without
            where the dataset has none.
    """

    config: type[C]
    check: Callable[..., object]
    prepare: Callable[..., L]
    card: Callable[[FitDataset, L, FitResult[N]], dict[str, Any]]
    load: Callable[[Path, str], M_co]
    complete: Callable[[FitDataset, C], C] = lambda _source, config: config
    files: Callable[[L], Mapping[str, bytes]] = lambda _learner: {}
    needs_actions: bool = True


@dataclass(frozen=True)
class Methods(Generic[M_co]):
    """The methods of a service, whose models are of class M_co.

    Attributes:
        service: Name of the service.
        by_name: The methods; the first is the default.
        made_elsewhere: As `Method.load`, of models that no fit makes, by the method that their cards name.
    """

    service: str
    by_name: Mapping[str, Method[Any, Any, Any, M_co]]
    made_elsewhere: Mapping[str, Callable[[Path, str], M_co]] = field(default_factory=dict)

    def resolve(
        self, data_dir: Path, dataset: str, values: Mapping[str, Any], *, threads: int, **resources: Path
    ) -> dict[str, Any]:
        """Returns the complete configuration of a fit; `values` override the defaults, `resources` are as of `run_fit`.

        Raises:
            NotFound: There is no such dataset.
            InvalidInput: The configuration is invalid, or the dataset cannot be trained on.
            FailedPrecondition: The dataset lacks labels, or what a method needs is not installed.
        """
        name, method, given = self._choose(values)
        source = FitDataset.open(data_dir, dataset)
        config = parse(method.config, {"threads": threads, **given})
        config = replace(config, cameras=choose_cameras(source.dataset, config.cameras))
        if method.needs_actions and not source.dataset.spec.has_actions:
            config = _without_actions(config, given)
        method.check(source, config, **resources)
        return {"method": name, **asdict(method.complete(source, config))}

    def schema(self) -> dict[str, Any]:
        """Returns the JSON schema of the configuration of a fit, as `resolve` takes it."""
        default = next(iter(self.by_name))
        schemas = []
        for name, method in self.by_name.items():
            schema = config_schema(method.config, title=name, more={"method": {"const": name}})
            schemas.append(schema if name == default else {**schema, "required": ["method", *schema["required"]]})
        return {"anyOf": schemas}

    def run_fit(self, folder: Path, data_dir: Path, device: str, **resources: Path) -> int:
        """Runs or resumes the fit in a folder, as its child process; returns the exit code, of `freerein.jobs.child`.

        The folder holds `config.json`; metrics, checkpoints and in the end `model/` are written there. `resources` are
        the files and folders that the service's methods need beside the dataset; `prepare` receives them.
        """

        def train(job: Mapping[str, Any]) -> bool:
            name, method, given = self._choose(job["config"])
            source, config = FitDataset.open(data_dir, job["dataset"]), parse(method.config, given)
            torch.set_num_threads(config.threads)
            notes = [each for each in (unseen_cameras(tuple(source.dataset.spec.cameras), config.cameras),) if each]
            sys.stderr.write("".join(f"{each}\n" for each in notes))
            learner = method.prepare(source, config, choose_device(device), **resources)

            def save(fitted: FitResult[Any], model: Path) -> None:
                for file, data in method.files(learner).items():
                    write_atomic(model / file, data)
                own = method.card(source, learner, fitted)
                warnings = {"warnings": [*own.get("warnings", []), *_uncalibrated(fitted.network)]}
                card = self._common_card(name, source, learner, fitted) | {"notes": notes} | own | warnings
                save_model(fitted.network, model, card=card)

            return fit_and_save(learner, folder, save, on_event=_tell)

        return run_child(folder, train)

    def load(self, folder: Path, device: str) -> M_co:
        """Returns the model in a folder, by the method that its card names.

        Raises:
            InvalidInput: A file is missing or malformed.
        """
        loads = {**{name: method.load for name, method in self.by_name.items()}, **self.made_elsewhere}
        name = str(read_card(folder).get("method"))
        if name not in loads:
            raise InvalidInput(
                f"A model's card must have `method` {' or '.join(loads)}; got another or none.",
                hint="Fit the model again, or restore its folder from a copy.",
            )
        return loads[name](folder, device)

    def _choose(self, values: Mapping[str, Any]) -> tuple[str, Method[Any, Any, Any, M_co], dict[str, Any]]:
        """Returns the method that a configuration names, and the configuration's other keys."""
        others = dict(values)
        name = others.pop("method", next(iter(self.by_name)))
        if not isinstance(name, str) or name not in self.by_name:
            raise InvalidInput(
                f"`method` must be {' or '.join(self.by_name)}; got something else.",
                field="config.method",
                hint="Leave it out for the default.",
            )
        return name, self.by_name[name], others

    def _common_card(
        self, name: str, source: FitDataset, learner: Learner[Any], fitted: FitResult[Any]
    ) -> dict[str, Any]:
        """Returns the entries that every card has."""
        return {
            "method": name,
            "command": f"freerein fit {self.service} DATASET{self._options(name, learner.config)}",
            "task": source.dataset.spec.task,
            "data": {
                "trajectories": len(source.dataset),
                "fps": source.dataset.spec.fps,
                "fingerprint": learner.fingerprint,
            },
            "config": asdict(learner.config),
            "figures": fitted.figures,
        }

    def _options(self, name: str, config: FitConfig) -> str:
        """Returns the options of the command line that makes the same configuration."""
        given = {} if name == next(iter(self.by_name)) else {"method": name}
        for each in fields(config):
            value = getattr(config, each.name)
            if value != each.default:
                given[each.name] = value if isinstance(value, str) else json.dumps(value)
        return "".join(f" --set {shlex.quote(f'{key}={text}')}" for key, text in given.items())


_TOLD = {
    "resumed": "The fit goes on after step {step}.",
    "checkpoint_corrupt": "The checkpoint of step {step} is passed over. {detail}",
    "checkpoint_failed": "The checkpoint of step {step} could not be written: {detail}.",
}
"""What the log of a fit's job holds, by the kind of event."""


def _tell(event: FitEvent) -> None:
    """Writes an event of a fit to the log of its job, where that has a word for it."""
    if told := _TOLD.get(event.kind):
        sys.stderr.write(told.format(step=event.step, detail=event.detail) + "\n")


def _uncalibrated(network: nn.Module) -> Iterator[str]:
    """Yields a warning where few trajectories were held out for an in-distribution score."""
    scores = [each for each in network.modules() if isinstance(each, InDistribution)]
    if scores:
        yield from scores[0].warnings


def _without_actions(config: C, given: Mapping[str, Any]) -> C:
    """Returns a configuration that uses no actions; InvalidInput where there is none, or it was asked to."""
    if "use_actions" in {each.name for each in fields(config)} and not given.get("use_actions", False):
        without: dict[str, Any] = {"use_actions": False}
        return replace(config, **without)
    raise InvalidInput(
        "This fit learns from executed actions; the timesteps of the dataset have none.",
        field="dataset",
        hint="Record them with the images. Without, segmentation and reward models can be fitted.",
    )
