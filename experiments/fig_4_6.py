"""Figure 4.6: policies trained on the learned reward, on the oracle's, and on those that stand beside them.

Pushing, stacking and placing. The dissertation's row has its configuration of PPO.
"""

from experiments.chapter4 import rewards_report
from experiments.chapter4.trained_on import (
    BASE,
    CONSTANT,
    CURIOSITY,
    DISSERTATION,
    LEARNED,
    ORACLE,
    OURS,
    PLACE,
    PUSH,
    RULE,
    STACK,
    TUNING,
    VICE,
)
from experiments.chapter4.trainings import Trainings
from experiments.workbench.arms import Arm

_TASKS = (PUSH, STACK, PLACE)
_SEEDS = {LEARNED: 5, ORACLE: 5, RULE: 3, VICE: 3, BASE: 3, CURIOSITY: 1, CONSTANT: 3}
_FEWER = {(STACK, VICE): 1}
"""Where nothing is earned, as by curiosity."""


def _seeds(task: str, reward: str) -> int:
    return _FEWER.get((task, reward), _SEEDS[reward])


EXPERIMENT = Trainings(
    (
        *(
            Arm(task, reward, {TUNING: OURS}, seed)
            for seed in range(max(_SEEDS.values()))
            for reward in _SEEDS
            for task in _TASKS
            if seed < _seeds(task, reward)
        ),
        *(Arm(task, reward, {TUNING: DISSERTATION}) for reward in (LEARNED, ORACLE) for task in _TASKS),
    ),
    rewards_report.manipulation,
)
