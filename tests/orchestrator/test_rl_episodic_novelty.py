"""Episodic novelty: what is new in an episode earns, and what it has shown does not."""

import torch
from torch import Tensor

from freerein_orchestrator.rl.episodic_novelty import episodic_bonuses, first_inverse

RIDGE = 0.1


def drawn(*shape: int) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def test_a_bonus_is_that_of_all_that_the_episode_has_shown_and_of_nothing_before_it() -> None:
    seen, starts = drawn(13, 2, 5), torch.zeros(12, 2, dtype=torch.bool)
    starts[0], starts[7, 1] = True, True
    bonuses, _ = episodic_bonuses(
        seen[:-1], seen[1:], starts, first_inverse(5, ridge=RIDGE).repeat(2, 1, 1), ridge=RIDGE
    )

    for env, begin, time in ((0, 0, 0), (0, 0, 11), (1, 0, 6), (1, 7, 7), (1, 7, 11)):
        shown, new = seen[begin : time + 1, env], seen[time + 1, env]
        expected = new @ torch.linalg.solve(RIDGE * torch.eye(5, dtype=torch.float64) + shown.T @ shown, new)
        torch.testing.assert_close(bonuses[time, env], expected)


def test_an_episode_goes_on_from_one_rollout_to_the_next() -> None:
    seen, starts, fresh = drawn(9, 3, 4), torch.zeros(8, 3, dtype=torch.bool), first_inverse(4, ridge=RIDGE)
    starts[0] = True
    whole, end = episodic_bonuses(seen[:-1], seen[1:], starts, fresh.repeat(3, 1, 1), ridge=RIDGE)
    first, between = episodic_bonuses(seen[:5], seen[1:6], starts[:5], fresh.repeat(3, 1, 1), ridge=RIDGE)
    rest, after = episodic_bonuses(seen[5:8], seen[6:], starts[5:], between, ridge=RIDGE)

    torch.testing.assert_close(torch.cat([first, rest]), whole)
    torch.testing.assert_close(after, end)


def test_what_turns_on_the_spot_earns_less_than_what_goes_on() -> None:
    views = torch.nn.functional.normalize(drawn(60, 40), dim=1)
    turning = torch.stack([views[torch.arange(61) % 6], views[torch.arange(61) % 60]], dim=1)
    starts = torch.zeros(60, 2, dtype=torch.bool)
    starts[0] = True
    bonuses, _ = episodic_bonuses(
        turning[:-1], turning[1:], starts, first_inverse(40, ridge=RIDGE).repeat(2, 1, 1), ridge=RIDGE
    )
    assert bonuses[30:, 1].mean() > 5 * bonuses[30:, 0].mean()
