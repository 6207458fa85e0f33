from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.fit import fit
from freerein_reward import objectives
from freerein_reward.model import DualEncoder, DualEncoderSpec, GradCamModel
from freerein_reward.relations import SpatialRelation
from freerein_reward.training import CaptionDataset, RewardConfig, RewardModelLearner, evaluate_reward, network_spec
from freerein_reward.training.caption_dataset import (
    ABSENT,
    CAPTIONS,
    NO_CAPTION,
    pair_captions,
    pairwise_absences,
    pairwise_relations,
)

CPU = torch.device("cpu")
PHRASES = ("a red block", "a blue block")
FAST = RewardConfig(
    cameras=("front",),
    phrases=PHRASES,
    steps=6,
    batch_size=8,
    warmup_steps=2,
    evaluate_every=3,
    checkpoint_every=3,
    hidden_size=32,
)


def blocks(count: int, *, seed: int) -> CaptionDataset:
    """Returns images of a red and a blue square, and how they truly lie to one another."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.1, 0.9, size=(count, 2, 2))
    frames = np.full((count, 64, 64, 3), 90, np.uint8)
    for frame, pair in zip(frames, places, strict=True):
        for (x, y), colour in zip((64 * pair).astype(int), ((220, 20, 20), (20, 20, 220)), strict=True):
            frame[max(0, y - 3) : y + 3, max(0, x - 3) : x + 3] = colour
    shown = np.ones((count, 2), bool)
    x, y = places[..., 0], places[..., 1]
    relations = pairwise_relations(x, y, shown, epsilon=0.1)
    return CaptionDataset((frames,), PHRASES, relations)


@pytest.fixture(scope="module")
def learner() -> RewardModelLearner:
    grounding = DualEncoder(DualEncoderSpec(cameras=("",), vocabulary=("a", "red", "blue", "block")))
    weights.initialise(grounding, generator=torch.Generator().manual_seed(0))
    training, validation = blocks(32, seed=0), blocks(8, seed=1)
    return RewardModelLearner(
        FAST, network_spec(grounding.spec, FAST), training, validation, GradCamModel(grounding), "", "", CPU
    )


def test_a_fit_that_is_stopped_goes_on_to_the_same_bits(learner: RewardModelLearner, tmp_path: Path) -> None:
    whole = fit(learner, tmp_path / "whole")
    asked = iter([False, False, False, True])
    assert fit(learner, tmp_path / "parts", stop=lambda: next(asked)) is None
    parts = fit(learner, tmp_path / "parts")
    assert whole is not None
    assert parts is not None
    assert weights.sha256(whole.network) == weights.sha256(parts.network)


def test_before_the_first_update_each_phrase_has_a_keypoint_with_its_heatmap(learner: RewardModelLearner) -> None:
    begun = learner.init(torch.Generator().manual_seed(5)).network.image
    frames = learner.training.views[0][:4]

    with torch.no_grad():
        maps = begun.feature_maps(torch.from_numpy(frames)).permute(0, 2, 3, 1)
        asked = begun.relation_pool.logits(maps).permute(0, 3, 1, 2)
        heat = (asked - begun.relation_pool.logits.bias[:, None, None]).relu()  # (N, P, h, w)
        heat /= heat.amax(dim=(2, 3), keepdim=True).clamp(min=1e-6)

    heatmaps = learner.grounding.ground(frames, PHRASES).heatmaps
    assert heatmaps.max() == 1.0
    np.testing.assert_allclose(heat, heatmaps, atol=1e-3)


def test_statistics_of_the_grounding_model_stay(learner: RewardModelLearner) -> None:
    after, _ = learner.update(learner.init(torch.Generator().manual_seed(5)), np.arange(8))
    known = learner.grounding.network.image.state_dict()
    statistics = {name: each for name, each in after.network.image.state_dict().items() if "running" in name}
    assert statistics
    assert all(torch.equal(tensor, known[name]) for name, tensor in statistics.items())


def test_evaluation_has_accuracy_precision_and_recall(learner: RewardModelLearner) -> None:
    figures = evaluate_reward(learner.init(torch.Generator().manual_seed(0)).network, learner.validation)
    assert 0.0 <= figures["relation_accuracy"] <= 1.0
    assert {
        f"{relation.name.lower()}.{kind}" for relation in SpatialRelation for kind in ("precision", "recall")
    } < set(figures)


def test_in_a_mirror_left_is_right_and_top_is_top() -> None:
    dataset = blocks(200, seed=2)
    mirrored = dataset.mirrored(np.ones(200, bool))
    there, back = dataset.relations[:, 0, 1], mirrored.relations[:, 0, 1]
    assert np.array_equal(there == SpatialRelation.LEFT_OF, back == SpatialRelation.RIGHT_OF)
    assert np.array_equal(there == SpatialRelation.ON_TOP_OF, back == SpatialRelation.ON_TOP_OF)
    assert (mirrored.relations[:, 0, 0] == NO_CAPTION).all()
    assert np.array_equal(mirrored.views[0][:, :, ::-1], dataset.views[0])


def test_no_caption_mentions_an_object_that_is_not_shown() -> None:
    x = y = np.array([[0.1, 0.5, 0.9]])
    relations = pairwise_relations(x, y, np.array([[True, True, False]]), epsilon=0.1)
    assert (relations[0, 0, 1], relations[0, 1, 0]) == (SpatialRelation.APART_FROM, SpatialRelation.APART_FROM)
    assert (relations[0, 2] == NO_CAPTION).all()
    assert (relations[0, :, 2] == NO_CAPTION).all()


def test_what_is_surely_missing_is_told_from_what_may_be_there() -> None:
    absences = pairwise_absences(np.array([[1.0, 0.5, 0.01]]), least=0.95)
    assert absences[0].tolist() == [[False, False, True], [False, False, True], [True, True, False]]


def test_captions_come_in_the_order_of_the_relations() -> None:
    texts = pair_captions(PHRASES, np.array([[1, 0]]))
    assert len(texts) == CAPTIONS
    assert texts[SpatialRelation.BELOW] == "a blue block below a red block"
    assert texts[ABSENT] == "a blue block or a red block missing"


def test_whole_trajectories_are_held_out_and_images_without_a_caption_left_out() -> None:
    dataset = blocks(10, seed=4)
    numbered = replace(dataset, views=(np.arange(10, dtype=np.uint8).reshape(10, 1, 1, 1),))
    numbered.relations[9] = NO_CAPTION
    lengths = np.array([3, 1, 4, 2])
    training, validation = (side.views[0].ravel().tolist() for side in numbered.split(lengths, fraction=0.3, seed=0))
    assert sorted(training + validation) == list(range(9))
    assert validation in ([0, 1, 2], [3], [4, 5, 6, 7], [8])


def test_a_dataset_that_cannot_be_split_or_tells_nothing_is_refused() -> None:
    dataset = blocks(4, seed=4)
    with pytest.raises(InvalidInput, match="2 trajectories"):
        dataset.split(np.array([4]), fraction=0.3, seed=0)
    dataset.relations[:] = NO_CAPTION
    with pytest.raises(InvalidInput, match="show two"):
        dataset.split(np.array([2, 2]), fraction=0.3, seed=0)


def test_equal_captions_are_never_each_others_negatives() -> None:
    scores = torch.tensor([[9.0, 0.0], [9.0, 0.0], [0.0, 9.0]])
    positives = torch.tensor([[True, False], [True, False], [False, True]])
    assert objectives.contrastive_loss(scores, positives).item() < 0.5
    assert objectives.multi_positive_cross_entropy(scores.T[:1], positives.T[:1]).item() == pytest.approx(
        np.log(2), abs=1e-3
    )


def test_relation_cross_entropy_counts_only_pairs_with_captions() -> None:
    scores = torch.zeros(2, 1, 5)
    scores[0, 0, SpatialRelation.BELOW] = 50.0
    told = torch.tensor([[int(SpatialRelation.BELOW)], [NO_CAPTION]])
    assert objectives.relation_cross_entropy(scores, told).item() == pytest.approx(0.0, abs=1e-6)
    assert objectives.relation_cross_entropy(scores, torch.full((2, 1), NO_CAPTION)).item() == 0.0
