import math

import pytest
import torch
from torch import Tensor

from freerein_segmentation.objectives import OBJECTIVES, Objective
from freerein_segmentation.objectives.ccnn import LEAST_SHARE, SLACK_WEIGHT, ccnn, nearest_distribution
from freerein_segmentation.objectives.lse import lse, lse_per_timestep
from freerein_segmentation.objectives.mil import fcn_mil, mil

B, T, K = 3, 7, 4
MASK = torch.arange(T) < torch.tensor([[7], [5], [1]])
TAGS = torch.tensor([[1, 1, 0, 0], [0, 1, 1, 1], [0, 0, 0, 1]], dtype=torch.bool)

each = pytest.mark.parametrize("objective", OBJECTIVES.values(), ids=OBJECTIVES.keys())


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


def test_fcn_mil_is_mil_with_the_mean_of_the_highest_score_and_its_neighbours() -> None:
    inside = scores().requires_grad_()
    loss = fcn_mil(inside, MASK, TAGS)
    loss[1].backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    peaks = inside[1, :5].argmax(dim=0).tolist()
    near = [list(range(max(0, peak - 1), min(5, peak + 2))) for peak in peaks]
    pooled = torch.stack([inside[1, times, skill].mean() for skill, times in enumerate(near)])
    torch.testing.assert_close(loss[1], -pooled.log_softmax(dim=0)[TAGS[1]].mean())
    assert inside.grad is not None
    trained = [inside.grad[1, :, skill].nonzero()[:, 0].tolist() for skill in range(K)]
    assert trained == near
    assert {0, 4} & set(peaks)  # at an end, too


def test_the_gradient_of_ccnn_is_the_networks_distribution_less_the_nearest_one() -> None:
    inside = scores().requires_grad_()
    ccnn(inside, MASK, TAGS).sum().backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    nearest = nearest_distribution(inside, MASK, TAGS, least_share=LEAST_SHARE).exp()
    expected = (inside.softmax(dim=2) - nearest) * (MASK / MASK.sum(dim=1, keepdim=True))[:, :, None]
    assert inside.grad is not None
    torch.testing.assert_close(inside.grad, expected)


@pytest.mark.parametrize(("mass", "multiplier"), [(0.2, 0.0), (0.05, 0.0), (0.01, None), (1e-3, SLACK_WEIGHT)])
def test_of_two_tags_the_rare_one_gets_its_least_share_unless_slack_is_cheaper(
    mass: float, multiplier: float | None
) -> None:
    certain = torch.tensor([mass, 1 - mass]).log().expand(1, 9, 2)
    mask, tags = torch.ones(1, 9, dtype=torch.bool), torch.ones(1, 2, dtype=torch.bool)
    found = nearest_distribution(certain, mask, tags, least_share=LEAST_SHARE).exp()
    lifted = mass * math.exp(multiplier or 0.0)
    share = LEAST_SHARE if multiplier is None else lifted / (lifted + 1 - mass)
    torch.testing.assert_close(found, torch.tensor([share, 1 - share]).expand(1, 9, 2))


def test_a_tag_is_lifted_to_its_least_share_and_no_higher() -> None:
    inside = scores(scale=4.0)
    log_p = nearest_distribution(inside, MASK, TAGS, least_share=0.2)
    assert log_p.exp().masked_select(~TAGS[:, None]).eq(0).all()
    kinds = set()
    for inputs, outputs, mask, tags in zip(inside, log_p, MASK, TAGS, strict=True):
        shares = outputs[mask].exp().mean(dim=0)[tags]
        lifts = (outputs - inputs)[mask][:, tags]  # by the multipliers, and by what normalises a timestep
        for share, lift in zip(shares.tolist(), (lifts - lifts.amin(dim=1, keepdim=True)).mean(dim=0), strict=True):
            assert share > 0.199
            assert lift < 1e-5 or share < 0.201
            kinds.add(bool(lift < 1e-5))
    assert kinds == {True, False}


def test_ccnn_without_a_share_is_satisfied_by_any_of_the_tags() -> None:
    loss = OBJECTIVES["ccnn_without_share"](scores(), MASK, TAGS)
    mass = scores().softmax(dim=2).masked_fill(~TAGS[:, None], 0.0).sum(dim=2)
    expected = torch.stack([-mass[row, MASK[row]].log().mean() for row in range(B)])
    torch.testing.assert_close(loss, expected)


@pytest.mark.parametrize("objective", [name for name in OBJECTIVES if name != "fcn_mil"])
def test_the_order_of_timesteps_does_not_matter(objective: str) -> None:
    order, loss = torch.tensor([3, 0, 6, 1, 5, 2, 4]), OBJECTIVES[objective]
    torch.testing.assert_close(loss(scores()[:, order], MASK[:, order], TAGS), loss(scores(), MASK, TAGS))


@each
def test_what_stands_in_the_padding_does_not_matter_and_gets_no_gradient(objective: Objective) -> None:
    inside = scores().requires_grad_()
    loss = objective(inside, MASK, TAGS)
    torch.testing.assert_close(objective(inside.where(MASK[:, :, None], 1e4), MASK, TAGS), loss)
    loss.sum().backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    assert inside.grad is not None
    assert inside.grad[~MASK].eq(0).all()
    assert inside.grad[MASK].isfinite().all()


@each
def test_more_padding_does_not_matter(objective: Objective) -> None:
    padded = torch.cat([scores(), torch.randn(B, 5, K)], dim=1)
    mask = torch.cat([MASK, torch.zeros(B, 5, dtype=torch.bool)], dim=1)
    torch.testing.assert_close(objective(padded, mask, TAGS), objective(scores(), MASK, TAGS))


@each
def test_renaming_the_skills_does_not_matter(objective: Objective) -> None:
    order = torch.tensor([2, 0, 3, 1])
    torch.testing.assert_close(objective(scores()[..., order], MASK, TAGS[:, order]), objective(scores(), MASK, TAGS))


@each
def test_a_trajectory_is_judged_alone(objective: Objective) -> None:
    torch.testing.assert_close(objective(scores()[1:2], MASK[1:2], TAGS[1:2]), objective(scores(), MASK, TAGS)[1:2])


@pytest.mark.parametrize("objective", [lse, lse_per_timestep, mil])
def test_no_pooled_loss_is_below_the_log_of_the_number_of_tags_and_the_truth_reaches_it(objective: Objective) -> None:
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


@each
def test_losses_and_gradients_stay_finite_for_huge_scores(objective: Objective) -> None:
    huge = scores(scale=1e4).requires_grad_()
    loss = objective(huge, MASK, TAGS).sum()
    loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    assert loss.isfinite()
    assert huge.grad is not None
    assert huge.grad.isfinite().all()
