import math

import pytest
import torch

from freerein_imitation.methods.goal_cloning.losses import absolute_error
from freerein_imitation.methods.goal_conditioned.losses import stop_loss
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.goal_images.recognizer import proximity_logit
from freerein_imitation.methods.shared.goal_images.recognizer_losses import recognizer_loss
from freerein_imitation.methods.shared.losses import (
    action_cross_entropy,
    masked_mean,
    squared_distance,
    squared_error,
    termination_loss,
)


def test_the_action_loss_of_a_uniform_guess_is_the_logarithm_of_the_categories() -> None:
    executed = action_bins.encode(torch.tensor([[0.3, -1.0]]), choices=0)
    loss = action_cross_entropy(torch.zeros(1, 2, action_bins.BINS), executed)
    assert loss.item() == pytest.approx(math.log(action_bins.BINS))


def test_the_action_loss_is_least_where_the_executed_action_is_predicted() -> None:
    executed = action_bins.encode(torch.tensor([[0.3]]), choices=0)
    scores = executed.clamp(min=1e-9).log().requires_grad_()
    (slope,) = torch.autograd.grad(action_cross_entropy(scores, executed).sum(), scores)
    torch.testing.assert_close(slope, torch.zeros_like(slope), atol=1e-6, rtol=0)


def test_forward_terms_are_sums_of_squares_and_the_loss_of_actions_is_their_mean() -> None:
    predicted, target = torch.tensor([[1.0, 3.0]]), torch.tensor([[1.0, 1.0]])
    assert squared_distance(predicted, target).tolist() == [4.0]
    assert squared_error(predicted, target).tolist() == [2.0]


def test_close_pairs_weigh_as_much_as_all_others_however_many_there_are() -> None:
    scores = torch.zeros(4, 4)
    close, far, elsewhere = (torch.zeros(4, 4, dtype=torch.bool) for _ in range(3))
    close[0, 1], far[0, 2], elsewhere[1:, 3] = True, True, True
    assert recognizer_loss(scores, close, far, elsewhere).item() == pytest.approx(math.log(2))
    certain = torch.where(close, 50.0, -50.0)
    assert recognizer_loss(certain, close, far, elsewhere).item() == pytest.approx(0.0, abs=1e-6)
    wrong_about_close = recognizer_loss(certain - 100 * close, close, far, elsewhere).item()
    assert wrong_about_close == pytest.approx(
        recognizer_loss(certain + 100 * (far | elsewhere), close, far, elsewhere).item()
    )


def test_a_masked_mean_over_nothing_is_0() -> None:
    assert masked_mean(torch.ones(2), torch.tensor([False, False])).item() == 0.0


def test_nothing_is_closer_to_a_goal_than_the_goal() -> None:
    goal = torch.randn(1, 8, generator=torch.Generator().manual_seed(0))
    others = goal + torch.randn(20, 8, generator=torch.Generator().manual_seed(1))
    assert (proximity_logit(others, goal) < proximity_logit(goal, goal)).all()
    assert proximity_logit(torch.zeros(2), torch.tensor([1.0, 0.0])).item() == pytest.approx(0.0)


def test_the_best_single_action_is_the_median_of_what_was_executed() -> None:
    executed = torch.tensor([[-1.0], [0.9], [1.0]])
    errors = {guess: absolute_error(torch.full((3, 1), guess), executed).mean().item() for guess in (0.3, 0.9, 1.0)}
    assert min(errors, key=errors.__getitem__) == 0.9
    assert errors[0.9] == pytest.approx((1.9 + 0.1) / 3)


def test_terminations_weigh_as_much_as_all_other_timesteps() -> None:
    ends = torch.tensor([True, *[False] * 9])
    unsure = termination_loss(torch.zeros(10), ends, ~ends)
    assert unsure.item() == pytest.approx(math.log(2))
    never = termination_loss(torch.full((10,), -20.0), ends, ~ends)
    assert never.item() == pytest.approx(10, abs=1e-3)


def test_timesteps_in_neither_mask_do_not_count() -> None:
    logits = torch.tensor([3.0, -3.0, 50.0], requires_grad=True)
    termination_loss(logits, torch.tensor([True, False, False]), torch.tensor([False, True, False])).backward()  # type: ignore[no-untyped-call]
    assert logits.grad is not None
    assert logits.grad[2] == 0


def test_stopping_is_right_at_the_goal_alone_and_padding_counts_for_nothing() -> None:
    logits = torch.tensor([[-50.0, -50.0, 50.0, 50.0], [-50.0, -50.0, -50.0, 50.0]])
    assert stop_loss(logits, torch.tensor([2, 3])).item() == pytest.approx(0, abs=1e-6)
    assert stop_loss(torch.zeros(2, 4), torch.tensor([1, 3])).item() == pytest.approx(math.log(2))
    assert stop_loss(logits, torch.tensor([3, 3])).item() == pytest.approx(50 / 8)
