"""The method `criterion_captions`: captions of keypoints, keypoints by phrase, and fits to scenes of three cameras."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.criteria import CRITERIA, View
from freerein.criterion_text import Claim, CriterionCaption
from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.training_loop import fit
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_reward.core import GroundingModel, RewardModel
from freerein_reward.methods.criterion_captions.augmented_moments import augment_moments
from freerein_reward.methods.criterion_captions.captions import (
    FALSE,
    HIDDEN,
    NO_NOUN,
    SHOWN,
    TRUE,
    UNKNOWN,
    UNSURE,
    label_captions,
    phrase_tuples,
    sampled_tuples,
)
from freerein_reward.methods.criterion_captions.config import CriterionConfig
from freerein_reward.methods.criterion_captions.criterion_model import CriterionModel
from freerein_reward.methods.criterion_captions.distractors import add_distractors
from freerein_reward.methods.criterion_captions.evaluation import evaluate_criteria
from freerein_reward.methods.criterion_captions.keypoint_dataset import KeypointDataset, find_keypoints, view_layout
from freerein_reward.methods.criterion_captions.locator import Locator, target_distribution
from freerein_reward.methods.criterion_captions.losses import CriterionLearner, caption_loss
from freerein_reward.methods.criterion_captions.method import criterion_warnings, network_spec
from freerein_reward.methods.criterion_captions.network import STATEMENTS
from freerein_reward.methods.criterion_captions.recoloured_moments import recolour_moments
from freerein_reward.methods.criterion_captions.spec import CriterionSpec
from freerein_reward.model import GradCamModel, load_grounding

CPU = torch.device("cpu")
SHIPPED = Path(__file__).parents[2] / "models" / "reward"
CAMERAS = ("front", "left", "tilt")
PHRASES = ("a red block", "a green block", "a blue block")
COLOURS = {"red": (220, 25, 20), "green": (30, 170, 40), "blue": (25, 75, 235), "magenta": (230, 30, 200)}
SIDE = 8
CONFIG = CriterionConfig(
    cameras=CAMERAS,
    views=CAMERAS,
    phrases=PHRASES,
    object_widths=(SIDE / 64,),
    steps=80,
    batch_size=4,
    lr=8e-3,
    warmup_steps=10,
    evaluate_every=80,
    checkpoint_every=80,
    augmentation=0.0,
)

Array = npt.NDArray[np.float64]


def views_of(scene: Array) -> Array:
    """Returns the keypoints of things in the three cameras, as fractions, of positions (..., 3): right, front, up."""
    right, front, up = np.moveaxis(scene, -1, 0)
    down = 1 - up
    return np.stack([np.stack(each, axis=-1) for each in ((right, down), (front, down), (right, (front + down) / 2))])


def draw(keypoints: Array, is_shown: npt.NDArray[np.bool_], colours: Sequence[str]) -> npt.NDArray[np.uint8]:
    """Returns frames, uint8 (N, 64, 64, 3), with squares of colours at keypoints (N, P, 2)."""
    frames = np.full((len(keypoints), 64, 64, 3), 110, np.uint8)
    for frame, middles, shown in zip(frames, (64 * keypoints).round().astype(int), is_shown, strict=True):
        for (x, y), name in zip(middles[shown], np.array(colours)[shown], strict=True):
            frame[max(0, y - SIDE // 2) : y + SIDE // 2, max(0, x - SIDE // 2) : x + SIDE // 2] = COLOURS[name]
    return frames


def scenes(
    count: int, *, seed: int, colours: Sequence[str] = ("red", "green", "blue")
) -> dict[str, npt.NDArray[np.uint8]]:
    """Returns frames by camera of things anywhere in a box; a fifth of them is missing."""
    rng = np.random.default_rng(seed)
    keypoints = views_of(rng.uniform(0.1, 0.9, size=(count, len(colours), 3)))
    is_shown = rng.random((count, len(colours))) < 0.8
    return {name: draw(view, is_shown, colours) for name, view in zip(CAMERAS, keypoints, strict=True)}


@pytest.fixture(scope="module")
def grounding() -> GradCamModel:
    store = ModelStore(SHIPPED)
    return load_grounding(store.folder(ModelRef("grounding", store.active_version("grounding"))), "cpu")


def located(frames: dict[str, npt.NDArray[np.uint8]], grounding: GradCamModel) -> KeypointDataset:
    layout = view_layout(CAMERAS, CAMERAS, CONFIG.object_widths, 1.0)
    views = tuple(frames.values())
    return KeypointDataset(views, *find_keypoints(views, grounding, CONFIG, layout), layout)


@pytest.fixture(scope="module")
def learner(grounding: GradCamModel) -> CriterionLearner:
    training, validation = (located(scenes(count, seed=count), grounding) for count in (240, 60))
    return CriterionLearner(
        CONFIG, network_spec(grounding, CONFIG, training.layout), training, validation, grounding, "", "", CPU
    )


@pytest.fixture(scope="module")
def model(learner: CriterionLearner, tmp_path_factory: pytest.TempPathFactory) -> CriterionModel:
    fitted = fit(learner, tmp_path_factory.mktemp("fit"))
    assert fitted is not None
    learner.calibrate(fitted.network)
    return CriterionModel(fitted.network)


def label(labels: npt.NDArray[np.int8], claim: Claim, name: str, nouns: tuple[int, ...], count: int) -> int:
    """Returns the label of a caption in the first image; `count` is the number of phrases."""
    wanted = (*nouns, NO_NOUN)[:3]
    (at,) = np.flatnonzero((phrase_tuples(count) == wanted).all(axis=1))
    return int(labels[0, at, STATEMENTS.index((claim, name))])


def labels_of(keypoints: Array, shown: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
    return label_captions(
        keypoints,
        shown,
        phrase_tuples(keypoints.shape[2]),
        criteria=CRITERIA.values(),
        views=tuple(View),
        tolerance=0.1,
    )


def test_an_image_has_the_caption_of_every_criterion_that_holds_at_the_places_of_its_view() -> None:
    keypoints = np.zeros((1, 3, 3, 2))
    keypoints[0, View.FRONT] = [(0, 0), (0.3, 1), (-2, 0.05)]
    keypoints[0, View.SIDE] = [(1, 0), (0, 1), (1.05, 0)]
    keypoints[0, View.TILTED] = [(0, 0), (0.3, 0.2), (5, 5)]
    labels = labels_of(keypoints, np.full((1, 3, 3), SHOWN, np.int8))
    of_pair = {
        name for name in CRITERIA if name != "in_between" and label(labels, Claim.HOLDS, name, (0, 1), 3) == TRUE
    }
    assert of_pair == {"left_of", "on_top_of", "in_front_of", "close_to", "inside_of"}
    assert label(labels, Claim.HOLDS, "in_between", (0, 1, 2), 3) == TRUE
    assert label(labels, Claim.HOLDS, "in_between", (1, 0, 2), 3) == FALSE
    assert label(labels, Claim.FAILS, "in_between", (1, 2, 0), 3) == TRUE
    assert label(labels, Claim.HOLDS, "in_front_of", (0, 2), 3) == UNKNOWN  # nearer than the tolerance
    assert label(labels, Claim.MISSING, "", (0, 1), 3) == FALSE


def test_what_is_mostly_covered_is_not_taken_for_hidden(grounding: GradCamModel) -> None:
    rng, count = np.random.default_rng(0), 60
    keypoints = rng.uniform(0.15, 0.85, size=(count, 3, 2))
    is_shown, covered = np.ones((count, 3), np.bool_), np.arange(count) % 3 == 0
    is_shown[1::3, 0] = False
    keypoints[covered, 1] = keypoints[covered, 0] - (0, 0.25 * SIDE / 64)  # a quarter of it is seen
    frames = draw(keypoints, is_shown, ("red", "green", "blue"))
    layout = view_layout(("front",), ("front", "", "front"), CONFIG.object_widths, 1.0)
    _, shown = find_keypoints([frames], grounding, CONFIG, layout)
    assert (shown[covered, 0, 0] == HIDDEN).mean() < 0.4
    assert (shown[1::3, 0, 0] == HIDDEN).mean() > 0.8


def test_a_slanting_camera_shows_things_nearer_to_each_other_in_depth_than_they_are() -> None:
    keypoints = np.array([[[0.5, 0.5], [0.5, 0.62]], [[0.5, 0.5], [0.62, 0.5]]])  # apart in depth, and across
    frames = np.zeros((2, 64, 64, 3), np.uint8)

    def close(**depth: float) -> list[bool]:
        layout = view_layout(("front",), ("front", "", "front"), (0.1,), 1.0, **depth)
        shown = np.full((2, 1, 2), SHOWN, np.int8)
        seen = KeypointDataset((frames,), keypoints[:, None].astype(np.float32), shown, layout)
        labels = seen.captions(phrase_tuples(2), tolerance=0.0)
        return [bool(label(labels[i : i + 1], Claim.HOLDS, "close_to", (0, 1), 2) == TRUE) for i in range(2)]

    assert close() == [True, True]
    assert close(depth=0.06) == [False, True]


def test_of_many_phrases_some_pairs_and_triples_are_scored_at_once_and_of_few_all() -> None:
    assert np.array_equal(sampled_tuples(4, np.random.default_rng(0)), phrase_tuples(4))
    some = sampled_tuples(16, np.random.default_rng(0))
    assert (len(some), int((some[:, -1] == NO_NOUN).sum())) == (64, 32)
    assert len(sampled_tuples(2, np.random.default_rng(0))) == 2


def test_what_a_view_does_not_show_is_in_no_criterion_and_what_none_shows_is_missing() -> None:
    keypoints, shown = np.zeros((1, 3, 2, 2)), np.full((1, 3, 2), SHOWN, np.int8)
    keypoints[0, :, 1] = (1, 0)
    shown[0, View.SIDE, 0] = HIDDEN
    hidden = labels_of(keypoints, shown)
    assert label(hidden, Claim.HOLDS, "left_of", (0, 1), 2) == TRUE
    assert label(hidden, Claim.HOLDS, "behind", (0, 1), 2) == FALSE
    assert label(hidden, Claim.FAILS, "behind", (0, 1), 2) == UNKNOWN
    assert label(hidden, Claim.MISSING, "", (0, 1), 2) == FALSE
    shown[0, :, 0] = HIDDEN
    missing = labels_of(keypoints, shown)
    assert label(missing, Claim.MISSING, "", (0, 1), 2) == TRUE
    assert (missing[..., :-1].max(), missing[..., -1].min()) == (FALSE, TRUE)
    shown[0, :, 0] = UNSURE
    assert (labels_of(keypoints, shown) == UNKNOWN).all()


def test_the_loss_of_captions_leaves_out_what_is_not_sure() -> None:
    scores = torch.tensor([[[50.0]], [[-50.0]], [[50.0]]])
    labels = torch.tensor([[[TRUE]], [[FALSE]], [[UNKNOWN]]], dtype=torch.int8)
    assert caption_loss(scores, labels).item() == pytest.approx(0.0, abs=1e-6)
    assert caption_loss(torch.zeros(3, 1, 1), labels).item() == pytest.approx(np.log(2), abs=1e-6)
    assert caption_loss(scores, torch.full_like(labels, UNKNOWN)).item() == 0.0


def test_captions_that_seldom_hold_weigh_as_much_as_those_that_often_do_not() -> None:
    labels = torch.tensor([TRUE, FALSE, FALSE, FALSE], dtype=torch.int8)[:, None, None]
    always_false, always_true = torch.full((4, 1, 1), -5.0), torch.full((4, 1, 1), 5.0)
    assert caption_loss(always_false, labels).item() == pytest.approx(caption_loss(always_true, labels).item())


def test_the_mean_of_a_target_is_the_place() -> None:
    keypoints = torch.tensor([[0.5, 0.5], [0.31, 0.77], [0.2, 0.9]])
    target = target_distribution(keypoints, height=16, width=16).view(3, 16, 16)
    centres = (torch.arange(16) + 0.5) / 16
    means = torch.stack([(target.sum(dim=1) * centres).sum(dim=1), (target.sum(dim=2) * centres).sum(dim=1)], dim=1)
    assert torch.allclose(target.sum(dim=(1, 2)), torch.ones(3))
    assert torch.allclose(means, keypoints, atol=1e-6)


def test_of_two_things_alike_one_is_the_place_and_not_the_middle_between_them() -> None:
    locator, cells = Locator(2), torch.zeros(1, 16, 16, 2)
    weights.initialise(locator, generator=torch.Generator())
    cells[0, 4, 2, 0], cells[0, 4, 3, 0], cells[0, 9, 12, 0] = 20.0, 20.0, 20.5
    found = locator(cells, torch.eye(2))
    assert found.keypoints[0, 0].tolist() == pytest.approx([3 / 16, 4.5 / 16], abs=1e-3)
    assert found.presence[0].tolist() == pytest.approx([1.0, 0.08], abs=0.05)  # 256 cells without heat against nowhere


def test_distractors_cover_nothing_that_is_kept_and_half_of_the_colours_are_its() -> None:
    frames, keypoints = torch.full((200, 64, 64, 3), 110, dtype=torch.uint8), torch.full((200, 1, 2), 0.5)
    frames[:, 29:35, 29:35] = torch.tensor(COLOURS["red"], dtype=torch.uint8)
    kept, clearance = torch.ones(200, 1, dtype=torch.bool), torch.full((2,), 3 / 64)

    def strewn(strength: float) -> torch.Tensor:
        generator = torch.Generator().manual_seed(0)
        return add_distractors(frames, keypoints, kept, clearance=clearance, strength=strength, generator=generator)

    seen = strewn(1.0)
    assert torch.equal(seen[:, 29:35, 29:35], frames[:, 29:35, 29:35])
    assert (seen != frames).any(dim=3).float().mean() > 0.02
    is_red = (seen == torch.tensor(COLOURS["red"], dtype=torch.uint8)).all(dim=3).sum(dim=(1, 2)) > 36
    assert 0.1 < is_red.float().mean() < 0.9
    assert torch.equal(strewn(0.0), frames)


def test_places_move_with_the_frames_and_captions_stay(learner: CriterionLearner) -> None:
    batch = learner.training.subset(np.arange(40))
    seen = augment_moments(batch, 1.0, distractors=1.0, generator=torch.Generator().manual_seed(0))
    moved = 64 * (seen.keypoints - batch.keypoints)
    assert np.ptp(moved, axis=(1, 2)).max() < 1e-3  # all views and phrases of a moment alike
    assert np.abs(moved).max() > 4
    assert np.abs(moved - moved.round()).max() < 1e-3
    tuples = phrase_tuples(3)
    before, after = (each.captions(tuples, tolerance=0.1) for each in (batch, seen))
    is_known = (before != UNKNOWN) & (after != UNKNOWN)
    assert np.array_equal(before[is_known], after[is_known])


def test_in_other_colours_things_have_other_names_at_the_places_that_they_have(learner: CriterionLearner) -> None:
    batch, names = learner.training.subset(np.arange(40)), [f"a {name} thing" for name in learner.grounding.names]
    turned = recolour_moments(batch, learner.grounding, names, least=0.95, generator=torch.Generator().manual_seed(0))
    assert all((then != now).any() for then, now in zip(turned.frames, batch.frames, strict=True))
    found = turned.shown == SHOWN
    assert found.any(axis=(0, 1)).sum() > 5  # names, of three phrases
    assert found.sum() > 0.5 * (batch.shown == SHOWN).sum()
    distance = np.linalg.norm(turned.keypoints[:, :, :, None] - batch.keypoints[:, :, None], axis=4)
    nearest = np.where(batch.shown[:, :, None] == SHOWN, distance, np.inf).min(axis=3)
    assert 64 * nearest[found].max() <= SIDE


def test_a_mirrored_moment_has_the_mirrored_captions_and_only_one_view_is_mirrored(learner: CriterionLearner) -> None:
    assert not learner.training.layout.is_mirrored
    layout = view_layout(("front",), ("front", "", "front"), (0.125,), 1.0)
    assert layout.is_mirrored
    batch = learner.training
    front = KeypointDataset(batch.frames[:1], batch.keypoints[:, :1], batch.shown[:, :1], layout)
    there, back = (
        each.captions(phrase_tuples(3), tolerance=0.1) for each in (front, front.mirrored(np.ones(len(front), bool)))
    )
    left, right = (STATEMENTS.index((Claim.HOLDS, name)) for name in ("left_of", "right_of"))
    assert np.array_equal(there[..., left], back[..., right])
    others = [each for each in range(len(STATEMENTS)) if STATEMENTS[each][1] not in ("left_of", "right_of")]
    assert np.array_equal(there[..., others], back[..., others])


def test_a_fit_that_is_stopped_goes_on_to_the_same_bits(learner: CriterionLearner, tmp_path: Path) -> None:
    short = replace(learner, config=replace(CONFIG, steps=4, warmup_steps=1, evaluate_every=4, checkpoint_every=2))
    asked = iter([False, False, False, True])
    assert fit(short, tmp_path / "parts", stop=lambda: next(asked)) is None
    parts, whole = (fit(short, tmp_path / name) for name in ("parts", "whole"))
    assert parts is not None
    assert whole is not None
    assert weights.sha256(parts.network) == weights.sha256(whole.network)


def test_a_fit_to_three_cameras_learns_the_criteria_of_each(model: CriterionModel, learner: CriterionLearner) -> None:
    figures = evaluate_criteria(model.network, learner.validation, tolerance=0.1)
    told = {name: figures[f"{name}.balanced_accuracy"] for name in ("left_of", "in_between", "behind")}
    assert min(told.values()) > 0.85, told
    assert figures["close_to.balanced_accuracy"] > 0.6  # of the tilted camera; its limit is a circle, and takes longer
    assert figures["absent_rewarded"] < 0.1


def test_a_goal_wins_in_a_scene_that_shows_it_and_none_wins_where_a_noun_is_missing(model: CriterionModel) -> None:
    shown = views_of(np.array([[[0.3, 0.8, 0.2], [0.7, 0.3, 0.6], [0.5, 0.5, 0.9]]]))
    views = {
        name: draw(each, np.ones((1, 3), bool), ("red", "green", "blue"))
        for name, each in zip(CAMERAS, shown, strict=True)
    }

    def winners(frames: dict[str, npt.NDArray[np.uint8]], text: str) -> int:
        goal = model.grammar.read(text)
        texts, _ = model.embed_texts((goal.text, *goal.rivals))
        similarities = model.similarities(model.embed_images(frames).vectors, texts)
        assert np.abs(similarities).max() <= 1 + 1e-5
        return int(similarities.argmax())

    assert winners(views, "the red block is to the left of the green one") == 0
    assert winners(views, "the red block is in front of the green one") == 0
    assert winners(views, "the blue block is between the red one and the green one") == 0
    assert winners(views, "the green block is to the left of the red one") != 0
    assert winners(views, "the red block is close to the green one") != 0
    empty = {name: np.full((1, 64, 64, 3), 110, np.uint8) for name in CAMERAS}
    for criterion in CRITERIA.values():
        for nouns in permutations(PHRASES, criterion.nouns):
            assert winners(empty, CriterionCaption(Claim.HOLDS, criterion, nouns).text) != 0


def test_a_noun_outside_the_fit_is_found_in_each_camera(model: CriterionModel) -> None:
    assert "a magenta block" in model.network.spec.other_phrases
    keypoints = views_of(np.random.default_rng(5).uniform(0.1, 0.9, size=(20, 1, 3)))
    for view in keypoints:
        found = model.locate(draw(view, np.ones((20, 1), bool), ("magenta",)), ["a magenta block", "a green block"])
        error = 64 * np.hypot(found.x[:, 0] - view[:, 0, 0], found.y[:, 0] - view[:, 0, 1])
        assert np.median(error) < 3
        assert np.median(found.presence[:, 0]) > 0.5 > np.median(found.presence[:, 1])


def test_the_model_is_both_kinds_of_the_core_and_alone_or_in_a_batch_answers_the_same(model: CriterionModel) -> None:
    assert isinstance(model, RewardModel)
    assert isinstance(model, GroundingModel)
    frames = scenes(20, seed=9)
    texts, truncated = model.embed_texts(
        ["a red block behind a blue block", "a red block in between a green block and a blue block", "red"]
    )
    lengths = np.linalg.norm(texts, axis=1)
    assert (lengths.round(5).tolist(), truncated.tolist()) == ([1, 1, 0], [False] * 3)
    together = model.similarities(model.embed_images(frames).vectors, texts)
    alone = [
        model.similarities(model.embed_images({k: v[i : i + 1] for k, v in frames.items()}).vectors, texts)
        for i in range(20)
    ]
    np.testing.assert_allclose(together, np.concatenate(alone), atol=1e-5)
    assert (together[:, 2] == 0).all()


def test_the_text_encoder_stays_the_grounding_models(model: CriterionModel, learner: CriterionLearner) -> None:
    theirs = learner.grounding.network.text.state_dict()
    assert all(torch.equal(tensor, theirs[name]) for name, tensor in model.network.text.state_dict().items())


@pytest.mark.parametrize(
    "views", [(), ("front", "left"), ("", "left", "tilt"), ("front", "front", "front"), ("front", "left", "top")]
)
def test_views_that_are_no_cameras_are_refused(views: tuple[str, ...]) -> None:
    with pytest.raises(InvalidInput, match="`views` must name") as refused:
        CriterionSpec(
            cameras=CAMERAS, views=views, phrases=PHRASES, other_phrases=(), vocabulary=("a",), units=(0.1,) * 6
        )
    assert refused.value.field == "config.views"


def test_a_criterion_that_is_never_decided_or_was_not_learned_is_warned_of(model: CriterionModel) -> None:
    told = {f"{name}.balanced_accuracy": 0.9 for name in CRITERIA}
    assert criterion_warnings(model.network, told) == []
    behind, inside = criterion_warnings(
        model.network, {k: 0.55 if k.startswith("behind") else v for k, v in told.items() if not k.startswith("inside")}
    )
    assert "tells `behind` with a balanced accuracy of 55%" in behind
    assert "say the same of `inside_of`" in inside
