import numpy as np
import pytest
import torch

from freerein.learning.action_scaling import ActionScaling, UnscaledActionSpec
from freerein.types.common import ActionSpec

RNG = np.random.default_rng(0)


def test_quantiles_become_the_ends_and_the_card_s_numbers_undo_it() -> None:
    actions = RNG.uniform([-300, 0.001], [900, 0.002], (5000, 2)).astype(np.float32)
    scaling = ActionScaling.of(actions)
    scaled = scaling.scaled(torch.from_numpy(actions)).numpy()
    np.testing.assert_allclose(np.quantile(scaled, (0.01, 0.99), axis=0), [[-1, -1], [1, 1]], atol=1e-3)
    low, high = np.array(scaling.low), np.array(scaling.high)
    np.testing.assert_allclose((scaled + 1) / 2 * (high - low) + low, actions, rtol=1e-4)


def test_a_gripper_that_seldom_closes_and_a_joint_that_never_moves_have_a_scale() -> None:
    actions = np.zeros((1000, 2), np.float32)
    actions[5, 0], actions[:, 1] = 80, 7
    scaled = ActionScaling.of(actions).scaled(torch.from_numpy(actions))
    assert (scaled[0].tolist(), scaled[5].tolist()) == ([-1, 0], [1, 0])


def test_a_broken_sensor_is_cut_off() -> None:
    actions = RNG.normal(0, 1, (1000, 1)).astype(np.float32)
    actions[3] = 1e38
    assert ActionScaling.of(actions).scaled(torch.from_numpy(actions)).max() == 10


def test_actions_in_their_own_unit_are_bounded_by_what_is_finite_alone() -> None:
    low, high = UnscaledActionSpec(2, 0, ("x", "y")).bounds
    assert low < -1e38 < 1e38 < high < np.inf
    assert ActionSpec(2, 0, ("x", "y")).bounds == (-1, 1)


@pytest.mark.parametrize("constant", [0.3, -(2.0**24), 1.7e7, -3e9, 1e30])
def test_a_constant_of_any_magnitude_becomes_0(constant: float) -> None:
    actions = torch.full((50, 1), constant)
    scaled = ActionScaling.of(actions.numpy()).scaled(torch.cat([actions, -actions]))
    torch.testing.assert_close(scaled[:50], torch.zeros(50, 1), atol=1e-6, rtol=0)
    assert torch.isfinite(scaled).all()


@pytest.mark.parametrize(
    ("value", "other"),
    [(0.5, np.nextafter(np.float32(0.5), np.float32(1))), (np.finfo(np.float32).min, np.finfo(np.float32).min)],
)
def test_what_float32_hardly_tells_apart_is_scaled_to_finite_numbers(value: float, other: float) -> None:
    actions = np.full((1000, 1), value, np.float32)
    actions[:10] = other
    assert torch.isfinite(ActionScaling.of(actions).scaled(torch.from_numpy(actions))).all()
