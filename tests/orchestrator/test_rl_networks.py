from typing import Any

import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.actor_critic.distributions import Categorical, Gaussian
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec


def make(**values: Any) -> ActorCritic:
    network = ActorCritic(ActorCriticSpec(**values))
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    return network


def test_gaussian_actions_are_those_of_torch() -> None:
    generator = torch.Generator().manual_seed(0)
    mean, log_std = torch.randn(5, 4, 3, generator=generator), torch.tensor([-1.0, 0.0, 0.5])
    ours = Gaussian(mean, log_std)
    theirs: Any = torch.distributions.Normal(mean, log_std.exp())
    actions = ours.sample(generator)
    torch.testing.assert_close(ours.log_prob(actions), theirs.log_prob(actions).sum(-1))
    torch.testing.assert_close(ours.entropy(), theirs.entropy().sum(-1))
    many = Gaussian(torch.ones(20_000, 3), log_std).sample(generator)
    torch.testing.assert_close(many.mean(0), torch.ones(3), atol=0.05, rtol=0)
    torch.testing.assert_close(many.std(0), log_std.exp(), atol=0.05, rtol=0)


def test_discrete_actions_are_those_of_torch() -> None:
    generator = torch.Generator().manual_seed(0)
    log_probs = torch.randn(5, 4, 3, generator=generator).log_softmax(-1)
    ours = Categorical(log_probs)
    theirs: Any = torch.distributions.Categorical(logits=log_probs)
    actions = ours.sample(generator)
    assert (actions.shape, actions.dtype) == ((5, 4, 1), torch.int64)
    torch.testing.assert_close(ours.log_prob(actions), theirs.log_prob(actions[..., 0]))
    torch.testing.assert_close(ours.entropy(), theirs.entropy())
    assert torch.equal(ours.mode(), log_probs.argmax(-1, keepdim=True))
    many = Categorical(torch.tensor([0.2, 0.5, 0.3]).log().expand(20_000, 3)).sample(generator)
    torch.testing.assert_close(many[:, 0].bincount() / 20_000, torch.tensor([0.2, 0.5, 0.3]), atol=0.02, rtol=0)


def test_a_sequence_gives_the_values_of_single_steps_and_an_episode_start_resets_the_state() -> None:
    network, generator = make(vector_size=3, recurrent=True), torch.Generator().manual_seed(1)
    observations = torch.randn(12, 4, 3, generator=generator)
    starts = torch.rand(12, 4, generator=generator) < 0.2
    initial = memory = torch.randn(4, network.spec.recurrent_size, generator=generator)
    values: list[torch.Tensor] = []
    for t in range(12):
        outputs = network(observations[t : t + 1], starts[t : t + 1], memory)
        memory, values = outputs.recurrent_state, [*values, outputs.values]
    whole = network(observations, starts, initial)
    torch.testing.assert_close(whole.values, torch.cat(values))
    torch.testing.assert_close(whole.recurrent_state, memory)
    forgotten = torch.where(starts[:1].T, torch.zeros_like(initial), initial)
    assert torch.equal(
        network(observations[:1], starts[:1], initial).values, network(observations[:1], starts[:1], forgotten).values
    )


def test_the_initial_policy_is_nearly_uniform() -> None:
    network = make(vector_size=3, action_choices=5)
    observations = torch.randn(1, 100, 3, generator=torch.Generator().manual_seed(1))
    outputs = network(observations, torch.zeros(1, 100, dtype=torch.bool), torch.zeros(100, 0))
    torch.testing.assert_close(outputs.actions.log_probs.exp(), torch.full((1, 100, 5), 0.2), atol=0.02, rtol=0)


@pytest.mark.parametrize("values", [{"channels": 2}, {"action_choices": 3, "action_size": 2}, {"height": 2}])
def test_invalid_specs_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput):
        ActorCriticSpec(**values)
