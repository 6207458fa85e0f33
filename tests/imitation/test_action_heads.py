"""Action heads: what they execute, what they learn, and how actions are drawn."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.shared.action_heads import HEADS, head_of
from freerein_imitation.methods.shared.action_heads.action_head import choose
from freerein_imitation.methods.shared.action_heads.pick_and_place import (
    DIRECTIONS,
    LENGTHS,
    PARTS,
    decode,
    encode,
    places_around,
)

PICK = ActionSpec(4, 0, ("x", "y", "dx", "dy"), "m", (0.33, 0.33, 0.15, 0.15))
MOVE, CHOICE = ActionSpec(2, 0, ("x", "y")), ActionSpec(1, 3, ("a", "b", "c"))
SIDE, HIDDEN = 16, 8
CAMERAS = (Camera("above", SIDE, SIDE, 1),)
TWO_PICKS = torch.tensor([[-0.7, 0.6, 0.5, 0.0], [0.7, -0.6, 0.0, -0.5]])


def made(name: str, action: ActionSpec, hidden: int = HIDDEN) -> Any:
    head = head_of(name, action)(hidden, action, CAMERAS)
    weights.initialise(head, generator=torch.Generator().manual_seed(0))  # type: ignore[arg-type]
    return head


def dots(places: Tensor) -> Tensor:
    """Returns frames with a soft white dot at x and y in [-1, 1], y up: uint8 (N, SIDE, SIDE, 1)."""
    axis = torch.linspace(-1, 1, SIDE)
    columns, rows = (torch.exp(-(((axis - each[:, None]) / 0.2) ** 2)) for each in (places[:, 0], -places[:, 1]))
    return (255 * rows[:, :, None] * columns[:, None])[..., None].to(torch.uint8)


def trained(head: Any, contexts: Callable[[], Tensor], actions: Tensor, *, steps: int) -> None:
    optimiser = torch.optim.Adam(head.parameters(), 1e-2)
    for _ in range(steps):
        executed = head.target(actions)
        loss = head.loss(head.logits(contexts(), executed), executed).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


@pytest.mark.parametrize(
    ("name", "action", "fits"),
    [
        ("bins", CHOICE, "categorical"),
        ("categorical", MOVE, "bins"),
        ("map", MOVE, "bins"),
        ("autoregressive", CHOICE, ""),
    ],
)
def test_a_head_of_other_actions_is_refused_by_those_that_fit(name: str, action: ActionSpec, fits: str) -> None:
    with pytest.raises(InvalidInput, match=f"`head` must be {fits}.*got {name}") as error:
        head_of(name, action)
    assert error.value.field == "config.head"
    assert head_of("auto", action) is HEADS[fits or "categorical"]


def test_a_pick_and_place_is_read_back_from_its_bins() -> None:
    rng = np.random.default_rng(0)
    picks = torch.from_numpy(rng.uniform(-1, 1, (64, 2)))
    lengths, directions = torch.from_numpy(rng.uniform(0.2, 1, 64)), torch.from_numpy(rng.integers(DIRECTIONS, size=64))
    actions = decode(picks, directions, lengths)

    location, direction, length = torch.split(encode(actions), list(PARTS), dim=1)

    torch.testing.assert_close(places_around(location.log().float(), location.argmax(dim=1)).double(), picks)
    assert direction.argmax(dim=1).tolist() == directions.tolist()
    torch.testing.assert_close(length @ torch.linspace(0, 1, LENGTHS).double(), lengths)
    assert encode(torch.zeros(1, 4)).sum().item() == pytest.approx(3)


@pytest.mark.parametrize("name", ["bins", "autoregressive", "map"])
def test_none_executes_the_mean_of_two_pick_points(name: str) -> None:
    head, count = made(name, PICK), 32
    actions, both = TWO_PICKS.repeat(count // 2, 1), {"above": dots(TWO_PICKS[:, :2]).amax(dim=0, keepdim=True)}

    def contexts() -> Tensor:  # nothing tells one from the other
        code = head.encode(both)
        return torch.cat([torch.zeros(1, HIDDEN), code, code], dim=1).expand(count, -1)

    trained(head, contexts, actions, steps=40)
    context = contexts()

    (likeliest,) = head.act(context[:1], None, temperature=1.0)

    assert (likeliest[:2] - TWO_PICKS[:, :2]).abs().min(dim=0).values.max() < 0.15
    if name != "bins":  # whose numbers do not know of each other
        assert (likeliest[:2] - TWO_PICKS[:, :2]).abs().amax(dim=1).min() < 0.15
        drawn = head.act(
            context, torch.rand(count, head.draws, generator=torch.Generator().manual_seed(0)), temperature=1
        )
        apart = (drawn[:, None, :2] - TWO_PICKS[:, :2]).abs().amax(dim=2)  # (N, 2)
        assert apart.min(dim=1).values.max() < 0.25
        assert 0.2 < (apart.argmin(dim=1) == 0).float().mean() < 0.8
        moved = drawn[:, 2:] - TWO_PICKS[apart.argmin(dim=1), 2:]
        assert moved.norm(dim=1).median() < 0.15  # the displacement goes with the place


def test_a_map_finds_what_differs_between_the_images() -> None:
    head, generator = made("map", PICK), torch.Generator().manual_seed(1)
    places = 1.4 * torch.rand(48, 2, generator=generator) - 0.7
    actions = torch.cat([places, torch.full_like(places, 0.3)], dim=1)
    here, there = {"above": dots(places)}, {"above": dots(places + 0.3)}

    def contexts() -> Tensor:
        return torch.cat([torch.zeros(len(places), HIDDEN), head.encode(here), head.encode(there)], dim=1)

    trained(head, contexts, actions, steps=40)

    apart = (head.act(contexts(), None, temperature=1.0) - actions).abs()
    assert apart[:, :2].median() < 0.1
    assert apart[:, 2:].median() < 0.1


def test_a_draw_selects_by_the_probabilities_at_a_temperature() -> None:
    logits = torch.tensor([0.5, 0.2, 0.3]).log().expand(1000, 3)
    draws = (torch.arange(1000) + 0.5).double() / 1000

    shares = [torch.bincount(choose(logits, draws, temperature=each), minlength=3) / 1000 for each in (1.0, 0.01)]

    torch.testing.assert_close(shares[0], torch.tensor([0.5, 0.2, 0.3]), atol=0.002, rtol=0)
    assert shares[1].tolist() == [1, 0, 0]
    assert choose(logits[:2], torch.tensor([0.0, math.nextafter(1, 0)]).double(), temperature=1.0).tolist() == [0, 2]


def test_categorical_and_bins_execute_the_likeliest_and_the_mean() -> None:
    for name, action in (("categorical", CHOICE), ("bins", MOVE)):
        head, context = made(name, action), torch.randn(5, HIDDEN, generator=torch.Generator().manual_seed(2))
        distributions = head.distribution(head.logits(context)).view(5, *head.shape)
        acted = head.act(context, None, temperature=1.0)
        values = torch.linspace(-1, 1, head.shape[1])
        expected = distributions.argmax(dim=-1) if action.choices else distributions @ values
        torch.testing.assert_close(acted, expected)
