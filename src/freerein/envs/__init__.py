"""Gymnasium environments over the sim service, rewards from language, and their adapter to Stable-Baselines3.

Importing this package registers the tasks that come with freerein:

    import gymnasium
    import freerein.envs

    env = gymnasium.make("freerein/blocks-v0", address="localhost:9104")
    envs = gymnasium.make_vec("freerein/blocks-v0", num_envs=8, address="localhost:9104")

`make_vec` makes one session with all environments, stepped by one call. `freerein.envs.sb3` (extra `sb3`) has what
Stable-Baselines3 trains on.
"""

try:
    import gymnasium as gymnasium
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "freerein.envs needs gymnasium, which is not installed: pip install 'freerein[envs]'", name=error.name
    ) from error

from freerein.envs.registration import TASKS, register
from freerein.envs.sim_env import SimEnv as SimEnv
from freerein.envs.sim_vector_env import SimVectorEnv as SimVectorEnv
from freerein.envs.text_reward import TextReward as TextReward
from freerein.envs.text_reward import VectorTextReward as VectorTextReward

register(*TASKS)  # Gymnasium finds what the import of a package registers
