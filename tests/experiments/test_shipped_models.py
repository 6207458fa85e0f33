"""The segmentation models that come with freerein label new demonstrations of their worlds."""

import re
from pathlib import Path

import pytest
from experiments.segmentation.draw import Part, demonstrations
from experiments.workbench import results

from freerein.model_store import CLONE_MODELS, ModelStore
from freerein_segmentation.model.segmentation_model import load

STORE = ModelStore(CLONE_MODELS / "segmentation")
SKILLS = {"bins": 4, "dial": 5, "grid": 5, "tabletop": 2}
"""Skills of each demonstration: as many as in the world's test set."""

COUNTS = {"bins": 1, "dial": 1, "grid": 3, "tabletop": 3}
"""Demonstrations, of about 100 timesteps each but for `grid`; those of `tabletop` differ most."""

OVERWRITTEN = {"tabletop"}
"""Models of runs whose results later runs replaced, before every run of a claim was kept."""


@pytest.mark.parametrize("name", sorted(set(STORE.names()) - OVERWRITTEN))
def test_the_figures_of_a_card_are_those_of_the_arm_that_its_command_names(name: str) -> None:
    (card,) = (model.card for model in STORE.models() if model.ref.name == name and model.active)
    experiment, arm = re.fullmatch(r"python -m experiments run (\w+) --only (\S+)", card["command"]).groups()  # type: ignore[union-attr]
    made = results.load(Path(__file__).parents[2] / "experiments" / "results" / experiment / f"{arm}.json")
    assert card["figures"] == dict(made.figures)


@pytest.mark.parametrize("name", STORE.names())
def test_a_shipped_model_labels_new_demonstrations_of_its_world(name: str) -> None:
    (shipped,) = (model for model in STORE.models() if model.ref.name == name and model.active)
    model = load(STORE.folder(shipped.ref), "cpu")
    skills, task = SKILLS[name], shipped.card["task"]
    part = Part(task, 1, stream=0, least_skills=skills, most_skills=skills, first=0, stop=COUNTS[name])

    right, timesteps = 0, 0
    for arrays in demonstrations(part):
        labels = model.predict(arrays["frames"], arrays["actions"]).probabilities.argmax(axis=1)
        right += int((labels == arrays["labels"]).sum())
        timesteps += len(labels)
    assert right / timesteps == pytest.approx(shipped.card["figures"]["test.frame_accuracy"], abs=0.1)
