import math

import pytest
import torch
from torch import Tensor

from freerein_segmentation.objectives import OBJECTIVES, Objective
from freerein_segmentation.objectives.lse import lse, lse_per_timestep
from freerein_segmentation.objectives.mil import mil

B, T, K = 3, 7, 4
MASK = torch.arange(T) < torch.tensor([[7], [5], [1]])
TAGS = torch.tensor([[1, 1, 0, 0], [0, 1, 1, 1], [0, 0, 0, 1]], dtype=torch.bool)

both = pytest.mark.parametrize("objective", OBJECTIVES.values(), ids=OBJECTIVES.keys())


def scores(*, scale: float = 1.0) -> Tensor:
    return scale * torch.randn(B, T, K, generator=torch.Generator().manual_seed(0))


def test_lse_is_eq_2_2_with_a_softmax_over_skills_and_an_equal_share_for_each_tag() -> None:
    one = torch.tensor([[[0.0, math.log(2.0)], [math.log(3.0), 0.0]]])  # exp: 1 2, 3 1; sums 4 and 3
    mask, tags = torch.ones(1, 2, dtype=torch.bool), torch.tensor([[True, True]])
    expected = -(math.log(4 / 7) + math.log(3 / 7)) / 2
    assert lse(one, mask, tags).item() == pytest.approx(expected)
    assert lse(one, mask, torch.tensor([[True, False]])).item() == pytest.approx(-math.log(4 / 7))


def test_lse_per_timestep_is_the_mean_over_time_of_each_timesteps_probabilities() -> None:
    one = torch.tensor([[[0.0, math.log(2.0)], [math.log(3.0), 0.0]]])  # probabilities 1/3 2/3, 3/4 1/4
    mask, tags = torch.ones(1, 2, dtype=torch.bool), torch.tensor([[True, False]])
    assert lse_per_timestep(one, mask, tags).item() == pytest.approx(-math.log((1 / 3 + 3 / 4) / 2))


def test_mil_is_the_softmax_of_each_skills_highest_score_and_trains_its_timestep_only() -> None:
    one = torch.tensor([[[0.0, math.log(2.0)], [math.log(3.0), 0.0]]], requires_grad=True)  # highest: log 3, log 2
    loss = mil(one, torch.ones(1, 2, dtype=torch.bool), torch.tensor([[True, False]]))
    loss.sum().backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    assert loss.item() == pytest.approx(-math.log(3 / 5))
    assert one.grad is not None
    assert one.grad.ne(0).tolist() == [[[False, True], [True, False]]]


@both
def test_the_order_of_timesteps_does_not_matter(objective: Objective) -> None:
    order = torch.tensor([3, 0, 6, 1, 5, 2, 4])
    torch.testing.assert_close(objective(scores()[:, order], MASK[:, order], TAGS), objective(scores(), MASK, TAGS))


@both
def test_what_stands_in_the_padding_does_not_matter_and_gets_no_gradient(objective: Objective) -> None:
    inside = scores().requires_grad_()
    loss = objective(inside, MASK, TAGS)
    torch.testing.assert_close(objective(inside.where(MASK[:, :, None], 1e4), MASK, TAGS), loss)
    loss.sum().backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    assert inside.grad is not None
    assert inside.grad[~MASK].eq(0).all()
    assert inside.grad[MASK].isfinite().all()


@both
def test_more_padding_does_not_matter(objective: Objective) -> None:
    padded = torch.cat([scores(), torch.randn(B, 5, K)], dim=1)
    mask = torch.cat([MASK, torch.zeros(B, 5, dtype=torch.bool)], dim=1)
    torch.testing.assert_close(objective(padded, mask, TAGS), objective(scores(), MASK, TAGS))


@both
def test_renaming_the_skills_does_not_matter(objective: Objective) -> None:
    order = torch.tensor([2, 0, 3, 1])
    torch.testing.assert_close(objective(scores()[..., order], MASK, TAGS[:, order]), objective(scores(), MASK, TAGS))


@both
def test_a_trajectory_is_judged_alone(objective: Objective) -> None:
    torch.testing.assert_close(objective(scores()[1:2], MASK[1:2], TAGS[1:2]), objective(scores(), MASK, TAGS)[1:2])


@both
def test_no_loss_is_below_the_log_of_the_number_of_tags_and_the_truth_reaches_it(objective: Objective) -> None:
    truth = torch.tensor([[0, 1, 0, 1, 0, 1]])
    certain = 50.0 * torch.nn.functional.one_hot(truth, K).float()
    mask, tags = torch.ones(1, 6, dtype=torch.bool), torch.tensor([[True, True, False, False]])
    assert objective(certain, mask, tags).item() == pytest.approx(math.log(2))
    assert (objective(scores(scale=5.0), MASK, TAGS) >= TAGS.sum(dim=1).log() - 1e-6).all()


def test_one_loud_timestep_satisfies_lse_but_not_lse_per_timestep() -> None:
    loud = scores()
    loud[0, 0, 0] = loud[0, 1, 1] = 40.0  # both tags, once each; the other five timesteps say anything
    assert lse(loud, MASK, TAGS)[0].item() == pytest.approx(math.log(2), abs=1e-3)
    assert lse_per_timestep(loud, MASK, TAGS)[0].item() > math.log(2) + 0.1


@both
def test_losses_and_gradients_stay_finite_for_huge_scores(objective: Objective) -> None:
    huge = scores(scale=1e4).requires_grad_()
    loss = objective(huge, MASK, TAGS).sum()
    loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    assert loss.isfinite()
    assert huge.grad is not None
    assert huge.grad.isfinite().all()
