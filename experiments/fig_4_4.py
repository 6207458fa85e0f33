"""Figure 4.4: the double inverted pendulum, trained on the oracle's reward and on a constant one.

An episode ends where the pendulum falls, so that any constant teaches balance. The dissertation's base reward is
CLIP's. It is not measurable here, for the built-in grounding model has no word for a pendulum.
"""

from experiments.chapter4 import rewards_report
from experiments.chapter4.trained_on import ALIVE, ORACLE, PENDULUM
from experiments.chapter4.trainings import Trainings
from experiments.workbench.arms import Arm

_SEEDS = 3

EXPERIMENT = Trainings(
    tuple(Arm(PENDULUM, reward, seed=seed) for seed in range(_SEEDS) for reward in (ORACLE, ALIVE)),
    rewards_report.balance,
)
