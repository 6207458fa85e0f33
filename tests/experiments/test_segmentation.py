"""Demonstrations, the supervised learner, and the scoring of labels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from experiments.segmentation import dataset, draw, evaluation, supervised, truth, weakly_supervised
from experiments.segmentation.dataset import DatasetSpec, SplitSpec

from freerein.errors import InvalidInput
from freerein_segmentation.training import SegmentationConfig

DATA = DatasetSpec("grid", train=SplitSpec(9, 2, 4), validation=SplitSpec(3, 2, 4), test=SplitSpec(3, 5, 5))
CONFIG = SegmentationConfig(batch_size=4, context="causal", lr=0.01)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(Path(__file__).parents[2])
        return dataset.open_or_draw(DATA, tmp_path_factory.mktemp("work"))


def test_a_dataset_is_drawn_once_and_found_by_its_hash(folder: Path) -> None:
    before = (folder / "spec.json").stat()
    assert dataset.open_or_draw(DATA, folder.parents[1]) == folder
    assert (folder / "spec.json").stat().st_mtime_ns == before.st_mtime_ns
    assert replace(DATA, seed=1).hash != DATA.hash != replace(DATA, task="grid-no-indicator").hash


def test_worlds_that_draw_different_frames_have_different_hashes() -> None:
    assert draw.world_hash("grid") != draw.world_hash("grid-no-indicator")


def test_a_trajectory_does_not_depend_on_the_part_that_it_is_drawn_in(folder: Path, tmp_path: Path) -> None:
    draw.main(tmp_path, draw.Part("grid", 0, dataset.SPLITS.index("train"), 2, 4, first=4, stop=6))
    train = dataset.open_split(folder, DATA, "train")
    drawn = np.fromfile(tmp_path / "frames", np.uint8)
    assert np.array_equal(drawn, np.concatenate([train.frames["top"][item] for item in (4, 5)]).ravel())


def test_the_tags_of_a_trajectory_are_the_skills_of_its_true_labels(folder: Path) -> None:
    for name in dataset.SPLITS:
        split, labels, spec = dataset.open_split(folder, DATA, name), truth.open_labels(folder, name), DATA.split(name)
        assert len(split) == spec.count
        assert split.frames["top"][0].shape[1:] == (33, 30, 3)
        for index, tags in enumerate(split.skills):
            assert len(labels[index]) == len(split.actions[index])
            assert {DATA.world.skills[label] for label in labels[index]} == set(tags)
            assert spec.least_skills <= len(tags) <= spec.most_skills


def test_true_labels_lie_where_no_learner_reads(folder: Path) -> None:
    assert {path.name for path in (folder / "train").iterdir()} == {
        "frames.raw",
        "actions.raw",
        "lengths.raw",
        "tags.raw",
    }


def test_the_supervised_learner_starts_with_the_same_weights_and_its_loss_falls(folder: Path) -> None:
    weak = weakly_supervised.make_learner(CONFIG, DATA, folder)
    learner = supervised.make_learner(CONFIG, DATA, folder)
    state, other = (each.init(torch.Generator().manual_seed(0)) for each in (learner, weak))
    assert all(map(torch.equal, state.network.state_dict().values(), other.network.state_dict().values()))
    assert learner.evaluate(state) == pytest.approx(np.log(5), abs=0.1)

    losses = []
    for _ in range(40):
        state, metrics = learner.update(state, np.arange(4))
        losses.append(metrics["train_loss"])

    assert losses[-1] < losses[0] / 2


def test_predictions_do_not_depend_on_the_batch(folder: Path) -> None:
    weak = weakly_supervised.make_learner(CONFIG, DATA, folder)
    network = weak.init(torch.Generator().manual_seed(0)).network
    together = evaluation.predict(network, weak.training, count=9)
    alone = [evaluation.predict(network, weak.training.subset([index]), count=1)[0] for index in range(9)]
    assert [len(each) for each in together] == weak.training.lengths().tolist()
    assert all(map(np.array_equal, together, alone))


def test_perfect_labels_score_one_and_an_unknown_method_is_refused(folder: Path) -> None:
    known = truth.first_labels(folder, "test", 3)
    outcome = evaluation.score(known, known, split="test")
    assert set(outcome.figures.values()) == {1.0}
    assert outcome.samples["test.frame_accuracy"].counts == [len(each) for each in known]
    with pytest.raises(InvalidInput, match="objective"):
        SegmentationConfig.from_mapping({"objective": "telepathy"})


def test_guesses_are_as_good_as_chance_allows() -> None:
    rng, truth_labels = np.random.default_rng(0), np.array([0, 0, 0, 1] * 500)
    accuracy = {
        guess.__name__: float(np.mean(guess(truth_labels, skills=5, rng=rng) == truth_labels))
        for guess in (evaluation.guess_skill, evaluation.guess_tag, evaluation.guess_majority)
    }
    assert accuracy["guess_skill"] == pytest.approx(0.2, abs=0.03)
    assert accuracy["guess_tag"] == pytest.approx(0.5, abs=0.04)
    assert accuracy["guess_majority"] == 0.75
