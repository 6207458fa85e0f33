"""Labels within the tags, action models, and the last objective of a fit."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_segmentation.model import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.model.action_model import ActionModel
from freerein_segmentation.objectives.labels import NO_SKILL, label_cross_entropy
from freerein_segmentation.objectives.set_likelihood import set_likelihood
from freerein_segmentation.training import SegmentationConfig, SegmentationLearner, held_out_action_loss
from freerein_segmentation.training.batches import TrajectoryBatch
from freerein_segmentation.training.self_training import Teacher, action_posterior
from freerein_segmentation.training.viterbi import viterbi

B, T, K = 3, 6, 4
LENGTHS = torch.tensor([6, 4, 1])
MASK = torch.arange(T) < LENGTHS[:, None]
TAGS = torch.tensor([[1, 1, 0, 0], [0, 1, 1, 1], [0, 0, 0, 1]], dtype=torch.bool)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("cost", [0.0, 0.7, 2.0])
def test_viterbi_finds_the_best_of_all_labels_within_the_tags(cost: float) -> None:
    emissions = random(B, T, K)
    found = viterbi(emissions.where(MASK[:, :, None], 1e3), MASK, TAGS, switching_cost=cost)
    for row, length in enumerate(LENGTHS.tolist()):
        tags = TAGS[row].nonzero()[:, 0].tolist()

        def value(labels: tuple[int, ...], row: int = row) -> float:
            switches = sum(before != after for before, after in itertools.pairwise(labels))
            return sum(emissions[row, t, label].item() for t, label in enumerate(labels)) - cost * switches

        assert tuple(found[row, :length].tolist()) == max(itertools.product(tags, repeat=length), key=value)
        assert found[row, length:].eq(NO_SKILL).all()


def test_labels_that_are_rejected_or_padding_count_for_nothing() -> None:
    scores, labels = random(B, T, K).requires_grad_(), torch.full((B, T), NO_SKILL)
    labels[0, :2] = torch.tensor([1, 3])
    loss = label_cross_entropy(scores, labels)
    expected = -(scores[0, 0].log_softmax(dim=0)[1] + scores[0, 1].log_softmax(dim=0)[3]) / 2
    assert loss.tolist() == pytest.approx([expected.item(), 0.0, 0.0])
    loss.sum().backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    assert scores.grad is not None
    assert scores.grad.ne(0).any(dim=2).nonzero().tolist() == [[0, 0], [0, 1]]


def test_set_likelihood_is_the_mass_of_the_tags_with_entropy_and_a_floor_of_shares() -> None:
    p = torch.tensor([[[0.6, 0.3, 0.1], [0.96, 0.02, 0.02]]])
    tags = torch.tensor([[True, True, False]])
    mass = -(math.log(0.9) + math.log(0.98)) / 2
    entropy = torch.special.entr(p).sum().item() / 2
    floor = math.log(0.175 / 0.16) / 2  # of the second tag, whose share is 0.16; that of the first is far above
    loss = set_likelihood(p.log(), torch.ones(1, 2, dtype=torch.bool), tags)
    assert loss.item() == pytest.approx(mass + 0.1 * entropy + floor, rel=1e-5)


def test_set_likelihood_does_not_mind_how_long_each_tag_lasts_above_the_floor() -> None:
    def loss(first: int) -> float:
        certain = 50.0 * torch.nn.functional.one_hot(torch.tensor([[0] * first + [1] * (20 - first)]), 3).float()
        mask, tags = torch.ones(1, 20, dtype=torch.bool), torch.tensor([[True, True, False]])
        return set_likelihood(certain, mask, tags).item()

    assert loss(10) == loss(5) == loss(16) == pytest.approx(0.0, abs=1e-6)
    assert loss(2) == pytest.approx(math.log(0.175 / 0.1) / 2)


def test_what_stands_in_the_padding_does_not_matter_to_set_likelihood_and_gets_no_gradient() -> None:
    inside = random(B, T, K).requires_grad_()
    loss = set_likelihood(inside, MASK, TAGS)
    torch.testing.assert_close(set_likelihood(inside.where(MASK[:, :, None], 1e4), MASK, TAGS), loss)
    loss.sum().backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    assert inside.grad is not None
    assert inside.grad[~MASK].eq(0).all()
    assert inside.grad[MASK].isfinite().all()


def action_model(action: ActionSpec) -> ActionModel:
    model = ActionModel(features=5, skills=K, action=action)
    weights.initialise(model, generator=torch.Generator().manual_seed(0))
    return model


def test_an_action_model_is_a_density_of_standardised_actions() -> None:
    model = action_model(ActionSpec(1, 0, ("dx",)))
    model.standardise("action", torch.tensor([[1.0], [3.0]]))  # mean 2, standard deviation 1
    grid = torch.linspace(-10, 14, 4001)[:, None]
    log_p = model(random(1, 5).expand(len(grid), 5), grid)  # (N, K)
    assert (log_p.exp().sum(dim=0) * 24 / 4000).tolist() == pytest.approx([1.0] * K, rel=1e-3)
    assert log_p.max() < -math.log(0.1)  # no density is higher than that of the least deviation


def test_an_action_model_of_choices_is_a_distribution() -> None:
    model = action_model(ActionSpec(1, 3, tuple("abc")))
    log_p = model(random(1, 5).expand(3, 5), torch.arange(3)[:, None])
    torch.testing.assert_close(log_p.exp().sum(dim=0), torch.ones(K))


def test_action_evidence_is_a_bounded_posterior() -> None:
    found = action_posterior(torch.tensor([[0.0, math.log(3.0)], [-1e6, 0.0]]))
    torch.testing.assert_close(found, torch.tensor([[math.log(0.25), math.log(0.75)], [-5.0, 0.0]]))


def stages_of(**settings: Any) -> list[tuple[str, int, Context]]:
    """Returns name, steps and context of each stage of a fit."""
    config = SegmentationConfig(**settings)
    spec = ModelSpec(skills=("a", "b"), cameras=(Camera("front", 4, 4, 1),), action=ActionSpec(1, 0, ("dx",)))
    seen, _ = walks(2, seed=0)
    learner = SegmentationLearner(config, spec, seen, seen, "fingerprint", torch.device("cpu"))
    return [(stage.name, stage.steps, stage.context) for stage in learner.stages()]


def test_a_final_objective_takes_its_share_of_the_steps() -> None:
    rounds = [(f"round-{number}", 15, "all") for number in (1, 2, 3, 4)]
    asked = {"steps": 100, "final_share": 0.6, "rounds": 4}
    assert stages_of(**asked, final_objective="self_training") == [("objective", 40, "all"), *rounds]
    assert stages_of(**asked, final_objective="set_likelihood") == [
        ("objective", 40, "all"),
        ("set_likelihood", 60, "all"),
    ]
    assert stages_of(**asked, final_objective="none") == [("objective", 100, "all")]
    assert stages_of(steps=1, final_objective="self_training") == [("objective", 0, "all"), ("round-1", 1, "all")]
    with pytest.raises(InvalidInput, match="self-training"):
        SegmentationConfig(action_evidence=0.3)


@pytest.mark.parametrize(
    ("context", "tag_context", "first", "then"),
    [("all", "all", "all", "all"), ("all", 3, 3, "all"), (5, 3, 3, 5), (3, 5, 3, 3), (0, "all", 0, 0)],
)
def test_less_of_the_future_may_be_seen_while_tags_are_learned(
    context: Context, tag_context: Context, first: Context, then: Context
) -> None:
    found = stages_of(final_objective="set_likelihood", context=context, tag_context=tag_context)
    assert [each for _, _, each in found] == [first, then]


def test_a_context_for_tags_needs_something_to_learn_after_them() -> None:
    with pytest.raises(InvalidInput, match="final objective"):
        SegmentationConfig(tag_context=0)


@pytest.mark.parametrize(("bias", "expected"), [(1.5, 1), (1.7, 0)])
def test_what_a_teacher_cannot_tell_is_as_likely_as_among_the_trajectories_with_the_skill(
    bias: float, expected: int
) -> None:
    spec = ModelSpec(
        skills=("always", "in a fifth"), cameras=(Camera("front", 4, 4, 1),), action=ActionSpec(1, 0, ("x",))
    )
    network = SegmentationNetwork(spec)
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    for name, tensor in network.head.named_parameters():
        torch.nn.init.zeros_(tensor)
        if name == "bias":
            tensor.data[0] = bias  # log 5 = 1.61
    config = SegmentationConfig(final_objective="self_training")
    teacher = Teacher(network, config, context=0, log_share=torch.tensor([1.0, 0.2]).log())
    batch = TrajectoryBatch(
        {"front": torch.zeros(3, 4, 4, 1, dtype=torch.uint8)},
        torch.zeros(3, 1),
        torch.tensor([3]),
        torch.ones(1, 2) > 0,
    )
    assert teacher.label(batch).tolist() == [[expected] * 3]
    loaded = Teacher.load(teacher.state_dict(), spec, config, context=0)
    assert loaded.label(batch).tolist() == [[expected] * 3]


def walks(count: int, *, seed: int) -> tuple[Trajectories, list[npt.NDArray[np.int64]]]:
    """Returns trajectories of frames that say nothing, whose actions depend on the skill, and the skills."""
    rng = np.random.default_rng(seed)
    labels = [np.repeat(rng.permutation(2), [6, 4]).astype(np.int64) for _ in range(count)]
    actions = [(np.sign(each[:, None] - 0.5) + 0.1 * rng.normal(size=(10, 1))).astype(np.float32) for each in labels]
    frames = [rng.integers(0, 256, (10, 4, 4, 1), np.uint8) for _ in labels]
    return Trajectories({"front": frames}, actions), labels


def test_the_action_loss_prefers_labels_whose_boundaries_are_right_and_gains_nothing_by_rejection() -> None:
    (training, labels), (validation, held_out) = walks(40, seed=0), walks(20, seed=1)
    spec = ModelSpec(
        skills=("a", "b"), cameras=(Camera("front", 4, 4, 1),), action=ActionSpec(1, 0, ("dx",)), features=8
    )

    def loss(change: Callable[[npt.NDArray[np.int64]], npt.NDArray[np.int64]]) -> float:
        parts = ([change(each) for each in labels], [change(each) for each in held_out])
        return held_out_action_loss(
            training, parts[0], validation, parts[1], spec=spec, steps=50, seed=0, device=torch.device("cpu")
        )

    exact, late = loss(lambda each: each), loss(lambda each: np.roll(each, 1))
    assert exact + 0.05 < late
    assert late + 0.02 < loss(np.zeros_like)
    assert exact + 0.05 < loss(lambda each: np.where(np.arange(10) < 5, NO_SKILL, each))
