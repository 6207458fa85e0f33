import math

import pytest
import torch

from freerein_imitation.objectives import absolute_error, ending


def test_the_best_single_action_is_the_median_of_what_was_executed() -> None:
    executed = torch.tensor([[-1.0], [0.9], [1.0]])
    errors = {guess: absolute_error(torch.full((3, 1), guess), executed).mean().item() for guess in (0.3, 0.9, 1.0)}
    assert min(errors, key=errors.__getitem__) == 0.9
    assert errors[0.9] == pytest.approx((1.9 + 0.1) / 3)


def test_ends_weigh_as_much_as_all_other_timesteps() -> None:
    ends = torch.tensor([True, *[False] * 9])
    unsure = ending(torch.zeros(10), ends, ~ends)
    assert unsure.item() == pytest.approx(math.log(2))
    never = ending(torch.full((10,), -20.0), ends, ~ends)
    assert never.item() == pytest.approx(10, abs=1e-3)


def test_timesteps_that_are_neither_do_not_count() -> None:
    logits = torch.tensor([3.0, -3.0, 50.0], requires_grad=True)
    ending(logits, torch.tensor([True, False, False]), torch.tensor([False, True, False])).backward()  # type: ignore[no-untyped-call]
    assert logits.grad is not None
    assert logits.grad[2] == 0
