"""The policy of skills."""

import torch

from freerein_imitation.methods.shared.skill_policy import SkillPolicy
from freerein_imitation.methods.skills.network import SkillsNetwork
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import StepInputs, StepOutputs, confidence

_STATE = 3  # x and y of the chosen goal position, and 1 once it is chosen


class SkillsPolicy(SkillPolicy[SkillsNetwork]):
    """Executes skills by name. Where a skill puts its object is chosen when it begins, and kept as recurrent state."""

    def __init__(self, network: SkillsNetwork, control: ControlSpec) -> None:
        spec = network.spec
        super().__init__(network, control, goal_form="recipe", skills=spec.skills, recurrent_size=_STATE)

    def _step(self, inputs: StepInputs) -> StepOutputs:
        network, state = self._network, inputs.recurrent
        pixels = network.pixels(inputs.frames)
        targets, places = network.maps(pixels, inputs.goals)
        cells, is_chosen = network.maps.cells, state[:, 2:] > 0
        place = torch.where(is_chosen, state[:, :2], cells.likeliest_place(places))
        displacement, termination = network(pixels, network.hand(pixels), cells.mode(targets), place, inputs.previous)
        reached, later = termination.sigmoid(), torch.cat([place, torch.ones_like(place[:, :1])], dim=1)
        return StepOutputs(network.actions(displacement)[:, None], reached, later, confidence(reached))
