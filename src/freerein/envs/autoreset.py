"""Vector environments that reset in the step that ends an episode (Gymnasium's `AutoresetMode.SAME_STEP`)."""

from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv

from freerein.envs.env_session import Observation
from freerein.errors import InvalidInput


def check_same_step(envs: VectorEnv[Any, Any, Any]) -> None:
    """Raises InvalidInput if environments reset in another step."""
    mode = envs.metadata.get("autoreset_mode")
    if mode is not AutoresetMode.SAME_STEP:
        raise InvalidInput(
            f"The environments must reset in the step that ends an episode (AutoresetMode.SAME_STEP); got {mode}.",
            field="env",
            hint="Write: SyncVectorEnv(..., autoreset_mode=AutoresetMode.SAME_STEP).",
        )


def last_observations(observations: Observation, ended: npt.NDArray[np.bool_], info: dict[str, Any]) -> Observation:
    """Returns the observations of a step before any reset.

    Args:
        observations: Of N environments, after resets.
        ended: bool (N,), where an episode ended.
        info: Of the step; `final_obs` holds what was observed last.
    """
    if not ended.any():
        return observations
    last = deepcopy(observations)
    for index in np.flatnonzero(ended):
        final = info["final_obs"][index]
        if isinstance(last, dict):
            for name, values in last.items():
                values[index] = final[name]
        else:
            last[index] = final
    return last
