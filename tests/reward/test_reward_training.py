from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.training_loop import fit
from freerein.model_store import ModelStore
from freerein.relations import SpatialRelation, caption
from freerein.types.common import ModelRef
from freerein_reward.methods.relation_captions.caption_dataset import (
    ABSENT,
    CAPTIONS,
    CaptionDataset,
    image_relations,
    pair_captions,
    pairwise_absences,
    place_keypoints,
)
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.relation_captions.evaluation import evaluate_reward, pair_majority_accuracy
from freerein_reward.methods.relation_captions.losses import (
    RewardModelLearner,
    distillation_loss,
    naming_loss,
    network_spec,
    relation_cross_entropy,
)
from freerein_reward.model import DualEncoder, DualEncoderModel, DualEncoderSpec, GradCamModel, load_grounding
from freerein_reward.model.phrase_relations import NO_CAPTION, pairwise_relations
from freerein_reward.training.grounding_learner import contrastive_loss, multi_positive_cross_entropy

CPU = torch.device("cpu")
SHIPPED = Path(__file__).parents[2] / "models" / "reward"
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


def blocks(count: int, *, seed: int, missing: float = 0.0) -> CaptionDataset:
    """Returns images of a red and a blue square, how they truly lie to one another, and if the blue one is missing."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.1, 0.9, size=(count, 2, 2))
    shown = np.stack([np.ones(count, bool), rng.random(count) >= missing], axis=1)
    frames = np.full((count, 64, 64, 3), 90, np.uint8)
    for frame, pair, drawn in zip(frames, (64 * places).astype(int), shown, strict=True):
        for (x, y), colour in zip(pair[drawn], ((220, 20, 20), (20, 20, 220)), strict=False):
            frame[max(0, y - 3) : y + 3, max(0, x - 3) : x + 3] = colour
    relations = pairwise_relations(places[..., 0], places[..., 1], shown, epsilon=0.1)
    absences = pairwise_absences(shown.astype(float), least=0.95)
    keypoints = np.concatenate([2 * places[..., ::-1] - 1, np.ones((count, 2, 1))], axis=2) * shown[..., None]
    captions = np.where(absences, ABSENT, relations).astype(np.int8)
    return CaptionDataset((frames,), PHRASES, captions, np.ones(2), keypoints.astype(np.float32))


@pytest.fixture(scope="module")
def learner() -> RewardModelLearner:
    grounding = DualEncoder(DualEncoderSpec(cameras=("",), vocabulary=("a", "red", "blue", "block")))
    weights.initialise(grounding, generator=torch.Generator().manual_seed(0))
    training, validation = blocks(32, seed=0), blocks(8, seed=1)
    return RewardModelLearner(
        FAST, network_spec(grounding.spec, FAST), training, validation, GradCamModel(grounding), "", "", CPU
    )


def test_a_fit_that_is_stopped_goes_on_to_the_same_bits(learner: RewardModelLearner, tmp_path: Path) -> None:
    learner = replace(learner, config=replace(FAST, initial="scratch", distillation=10.0))
    whole = fit(learner, tmp_path / "whole")
    asked = iter([False, False, False, True])
    assert fit(learner, tmp_path / "parts", stop=lambda: next(asked)) is None
    parts = fit(learner, tmp_path / "parts")
    assert whole is not None
    assert parts is not None
    assert weights.sha256(whole.network) == weights.sha256(parts.network)


def test_a_fitted_model_rewards_no_goal_in_a_frame_that_shows_nothing(tmp_path: Path) -> None:
    store = ModelStore(SHIPPED)
    grounding = load_grounding(store.folder(ModelRef("grounding", store.active_version("grounding"))), "cpu")
    config = replace(FAST, steps=50, batch_size=16, evaluate_every=25, checkpoint_every=50, augmentation=0.0)
    training, validation = blocks(200, seed=0, missing=0.3), blocks(40, seed=1, missing=0.3)
    spec = network_spec(grounding.network.spec, config)
    fitted = fit(RewardModelLearner(config, spec, training, validation, grounding, "", "", CPU), tmp_path)
    assert fitted is not None
    model = DualEncoderModel(fitted.network)
    seen = model.embed_images({"front": np.full((1, 64, 64, 3), 90, np.uint8)}).vectors
    for (first, second), relation in product(permutations(PHRASES), SpatialRelation):
        goal = model.grammar.read(caption(first, relation, second))
        texts, _ = model.embed_texts((goal.text, *goal.rivals))
        assert (seen @ texts.T).argmax() == len(goal.rivals)  # the last rival: one is missing


def test_before_the_first_update_each_phrase_has_its_heatmap_in_units_of_its_half_heat(
    learner: RewardModelLearner,
) -> None:
    frames, half_heat = learner.training.views[0][:4], np.array([2.0, 0.25])
    scaled = replace(learner, training=replace(learner.training, half_heat=half_heat))
    begun = scaled.init(torch.Generator().manual_seed(5)).network.image

    with torch.no_grad():
        maps = begun.feature_maps(torch.from_numpy(frames)).permute(0, 2, 3, 1)
        heat = (begun.relation_pool.heat(maps) + 0.5).relu().permute(0, 3, 1, 2).numpy()  # (N, P, h, w)

    found = learner.grounding.ground(frames, PHRASES)
    peaks = heat.max(axis=(2, 3), keepdims=True)
    wins = found.heat == found.heat.max(axis=1, keepdims=True)  # elsewhere a phrase may yield to the other at its peak
    assert found.heatmaps.max() == 1.0
    np.testing.assert_allclose(heat / peaks.clip(1e-6), found.heatmaps, atol=1e-3)
    np.testing.assert_allclose(peaks[..., 0, 0][wins], (found.heat / half_heat)[wins], rtol=1e-3)


def test_statistics_of_the_grounding_model_stay(learner: RewardModelLearner) -> None:
    after, _ = learner.update(learner.init(torch.Generator().manual_seed(5)), np.arange(8))
    known = learner.grounding.network.image.state_dict()
    statistics = {name: each for name, each in after.network.image.state_dict().items() if "running" in name}
    assert statistics
    assert all(torch.equal(tensor, known[name]) for name, tensor in statistics.items())


def test_from_scratch_weights_and_statistics_are_the_fits_own(learner: RewardModelLearner) -> None:
    scratch = replace(learner, config=replace(FAST, initial="scratch"))
    begun = scratch.init(torch.Generator().manual_seed(5))
    theirs = learner.grounding.network.image.layer1.state_dict()
    ours = begun.network.image.layer1.state_dict()
    assert not any(torch.equal(ours[name], theirs[name]) for name in ours if "conv" in name)
    after, _ = scratch.update(begun, np.arange(8))
    assert all(each.abs().sum() > 0 for name, each in after.network.named_buffers() if name.endswith("running_mean"))
    scratch.evaluate(after)
    assert not after.network.training


def test_distillation_teaches_a_network_from_scratch_where_phrases_are(learner: RewardModelLearner) -> None:
    items, distances = np.arange(8), []
    for weight in (10.0, 0.0):
        config = replace(FAST, initial="scratch", distillation=weight, augmentation=0.0, steps=200)
        each = replace(learner, config=config)
        state = each.init(torch.Generator().manual_seed(5))
        for _ in range(30):
            state, _ = each.update(state, items)
        distances.append(distillation_loss(state.network.train(), learner.training.subset(items)).item())
    assert distances[0] < 0.5 * distances[1]


def test_places_are_keypoints_which_a_mirror_turns_and_a_phrase_that_is_not_shown_has_none() -> None:
    x, y, heat = np.array([[0.25, 0.5]]), np.array([[0.75, 0.5]]), np.ones((1, 2))
    keypoints = place_keypoints(x, y, heat, np.array([[1.0, 0.0]]))
    assert keypoints.tolist() == [[[0.5, -0.5, 1.0], [0.0, 0.0, 0.0]]]
    dataset = replace(blocks(1, seed=0), keypoints=keypoints)
    mirrored = dataset.mirrored(np.array([True])).keypoints
    assert mirrored is not None
    assert mirrored.tolist() == [[[0.5, 0.5, 1.0], [0.0, 0.0, 0.0]]]


def test_augmented_frames_change_updates_after_two_fifths_of_the_fit_and_none_before(
    learner: RewardModelLearner,
) -> None:
    digests: list[list[str]] = [[], []]
    for strength, found in zip((1.0, 0.0), digests, strict=True):
        each = replace(learner, config=replace(FAST, steps=5, augmentation=strength))
        state, items = each.init(torch.Generator().manual_seed(5)), np.arange(8)
        for _ in range(3):
            state, _ = each.update(state, items)
            found.append(weights.sha256(state.network))
    assert digests[0][:2] == digests[1][:2]
    assert digests[0][2] != digests[1][2]


def test_the_loss_on_held_out_images_counts_augmented_ones_that_are_drawn_alike_each_time(
    learner: RewardModelLearner,
) -> None:
    plain = replace(learner, config=replace(FAST, augmentation=0.0))
    sensitive = replace(learner, training=replace(learner.training, half_heat=np.full(2, 0.01)))
    state = sensitive.init(torch.Generator().manual_seed(5))
    assert learner.evaluate(state) == learner.evaluate(state) != plain.evaluate(state)


def test_the_text_encoder_learns_to_name_phrases_and_images_have_no_part_in_it(learner: RewardModelLearner) -> None:
    network = learner.init(torch.Generator().manual_seed(5)).network
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        loss = naming_loss(network, PHRASES)
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[0] > 0.5 > 0.02 > losses[-1]
    assert all(each.grad is None for each in network.image.parameters())


def test_evaluation_has_accuracy_precision_and_recall(learner: RewardModelLearner) -> None:
    figures = evaluate_reward(learner.init(torch.Generator().manual_seed(0)).network, learner.validation)
    assert 0.0 <= figures["relation_accuracy"] <= 1.0
    assert {
        f"{relation.name.lower()}.{kind}" for relation in SpatialRelation for kind in ("precision", "recall")
    } < set(figures)


def test_the_majority_is_that_of_each_ordered_pair_by_the_number_of_its_captions() -> None:
    left, right, apart = SpatialRelation.LEFT_OF, SpatialRelation.RIGHT_OF, SpatialRelation.APART_FROM
    mirrored = np.array([[left, right]] * 7 + [[right, left]] * 3 + [[ABSENT, NO_CAPTION]] * 20, np.int64)
    assert pair_majority_accuracy(mirrored) == 0.7
    third = np.array([apart] * 20 + [NO_CAPTION] * 10, np.int64)
    assert pair_majority_accuracy(np.column_stack([mirrored, third])) == (7 + 7 + 20) / 40


def test_in_a_mirror_left_is_right_and_top_is_top() -> None:
    dataset = blocks(200, seed=2, missing=0.3)
    mirrored = dataset.mirrored(np.ones(200, bool))
    there, back = dataset.relations[:, 0, 1], mirrored.relations[:, 0, 1]
    assert np.array_equal(there == SpatialRelation.LEFT_OF, back == SpatialRelation.RIGHT_OF)
    assert np.array_equal(there == SpatialRelation.ON_TOP_OF, back == SpatialRelation.ON_TOP_OF)
    assert np.array_equal(there == ABSENT, back == ABSENT)
    assert 0 < (there == ABSENT).sum() < 200
    assert (mirrored.relations[:, 0, 0] == NO_CAPTION).all()
    assert np.array_equal(mirrored.views[0][:, :, ::-1], dataset.views[0])


def test_the_views_of_an_image_are_augmented_alike_and_captions_stay() -> None:
    one = blocks(20, seed=3)
    twins = replace(one, views=one.views * 2)
    first, second = (
        view.astype(float) for view in twins.augmented(1.0, generator=torch.Generator().manual_seed(0)).views
    )
    brightness = first.mean(axis=(1, 2, 3))
    assert np.abs((first - second).mean(axis=(1, 2, 3))).max() < 2  # noise is each view's own
    assert brightness.std() > 10
    same = twins.augmented(0.0, generator=torch.Generator())
    assert all(np.array_equal(*pair) for pair in zip(twins.views, same.views, strict=True))
    assert same.relations is twins.relations


def test_no_caption_mentions_an_object_that_is_not_shown() -> None:
    x = y = np.array([[0.1, 0.5, 0.9]])
    relations = pairwise_relations(x, y, np.array([[True, True, False]]), epsilon=0.1)
    assert (relations[0, 0, 1], relations[0, 1, 0]) == (SpatialRelation.APART_FROM, SpatialRelation.APART_FROM)
    assert (relations[0, 2] == NO_CAPTION).all()
    assert (relations[0, :, 2] == NO_CAPTION).all()


def test_what_is_surely_missing_is_told_from_what_may_be_there() -> None:
    absences = pairwise_absences(np.array([[1.0, 0.5, 0.01]]), least=0.95)
    assert absences[0].tolist() == [[False, False, True], [False, False, True], [True, True, False]]


def test_the_weaker_of_two_phrases_in_one_place_is_in_no_caption_but_what_is_missing_is() -> None:
    x, y = np.array([[0.5, 0.52, 0.8, 0.1]]), np.full((1, 4), 0.3)
    heat, presence = np.array([[4.0, 2.0, 3.0, 0.0]]), np.array([[0.99, 0.99, 0.99, 0.01]])
    config = RewardConfig(phrases=("a", "b", "c", "d"), epsilon=0.1)
    relations, half_heat = image_relations(x, y, heat, presence, config)
    apart = SpatialRelation.APART_FROM
    assert relations[0].tolist() == [
        [NO_CAPTION, NO_CAPTION, apart, ABSENT],
        [NO_CAPTION, NO_CAPTION, NO_CAPTION, ABSENT],
        [apart, NO_CAPTION, NO_CAPTION, ABSENT],
        [ABSENT, ABSENT, ABSENT, NO_CAPTION],
    ]
    assert half_heat.tolist() == pytest.approx([2.0, 1.0, 1.5, 1.0])


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
    assert contrastive_loss(scores, positives).item() < 0.5
    assert multi_positive_cross_entropy(scores.T[:1], positives.T[:1]).item() == pytest.approx(np.log(2), abs=1e-3)


def test_relation_cross_entropy_counts_only_pairs_with_captions() -> None:
    scores = torch.zeros(3, 1, CAPTIONS)
    scores[0, 0, SpatialRelation.BELOW] = scores[1, 0, ABSENT] = 50.0
    told = torch.tensor([[int(SpatialRelation.BELOW)], [ABSENT], [NO_CAPTION]])
    assert relation_cross_entropy(scores, told).item() == pytest.approx(0.0, abs=1e-6)
    told[2] = ABSENT
    assert relation_cross_entropy(scores, told).item() == pytest.approx(np.log(CAPTIONS) / 3, abs=1e-6)
    assert relation_cross_entropy(scores, torch.full((3, 1), NO_CAPTION)).item() == 0.0
