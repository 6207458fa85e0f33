import math

import pytest
import torch

from freerein_imitation.model import action_code
from freerein_imitation.model.recognizer import closeness
from freerein_imitation.objectives import action_cross_entropy, masked_mean, recognition, squared_error


def test_the_action_loss_of_a_uniform_guess_is_the_logarithm_of_the_categories() -> None:
    executed = action_code.encode(torch.tensor([[0.3, -1.0]]), choices=0)
    loss = action_cross_entropy(torch.zeros(1, 2, action_code.BINS), executed)
    assert loss.item() == pytest.approx(math.log(action_code.BINS))


def test_the_action_loss_is_least_where_the_executed_action_is_predicted() -> None:
    executed = action_code.encode(torch.tensor([[0.3]]), choices=0)
    scores = executed.clamp(min=1e-9).log().requires_grad_()
    (slope,) = torch.autograd.grad(action_cross_entropy(scores, executed).sum(), scores)
    torch.testing.assert_close(slope, torch.zeros_like(slope), atol=1e-6, rtol=0)


def test_the_forward_terms_are_mean_squares_over_features() -> None:
    assert squared_error(torch.tensor([[1.0, 3.0]]), torch.tensor([[1.0, 1.0]])).tolist() == [2.0]


def test_close_pairs_weigh_as_much_as_all_others_however_many_there_are() -> None:
    scores = torch.zeros(4, 4)
    close, far, elsewhere = (torch.zeros(4, 4, dtype=torch.bool) for _ in range(3))
    close[0, 1], far[0, 2], elsewhere[1:, 3] = True, True, True
    assert recognition(scores, close, far, elsewhere).item() == pytest.approx(math.log(2))
    certain = torch.where(close, 50.0, -50.0)
    assert recognition(certain, close, far, elsewhere).item() == pytest.approx(0.0, abs=1e-6)
    wrong_about_close = recognition(certain - 100 * close, close, far, elsewhere).item()
    assert wrong_about_close == pytest.approx(
        recognition(certain + 100 * (far | elsewhere), close, far, elsewhere).item()
    )


def test_a_mean_over_nothing_is_nothing() -> None:
    assert masked_mean(torch.ones(2), torch.tensor([False, False])).item() == 0.0


def test_nothing_is_closer_to_a_goal_than_the_goal() -> None:
    goal = torch.randn(1, 8, generator=torch.Generator().manual_seed(0))
    others = goal + torch.randn(20, 8, generator=torch.Generator().manual_seed(1))
    assert (closeness(others, goal) < closeness(goal, goal)).all()
    assert closeness(torch.zeros(2), torch.tensor([1.0, 0.0])).item() == pytest.approx(0.0)
