"""Stable-Baselines3 learns from a sentence: PPO sees camera frames, and the reward service judges them.

    freerein up
    python examples/train_sb3.py "a yellow block to the left of a green block"

The gripper is moved left, right, up or down, eight timesteps each time, and rewarded after each of the five moves of
an episode. One call steps all environments, another rewards them.

With --log, TensorBoard's curves and a checkpoint every 1,600 moves are written there (`tensorboard --logdir DIR`). With
--resume, the training of an earlier policy or checkpoint goes on:

    python examples/train_sb3.py --log logs --out policy.zip
    python examples/train_sb3.py --log logs --resume policy.zip --out policy.zip
"""

import argparse
import logging
from pathlib import Path

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete
from gymnasium.vector import VectorActionWrapper, VectorEnv
from gymnasium.vector.utils import batch_space
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CheckpointCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

from freerein.envs import VectorTextReward  # freerein.envs registers the environments, too
from freerein.envs.sb3 import SB3VecEnv

_log = logging.getLogger(__name__)
_TIMESTEPS, _MOVES = 8, 5
_EVALUATED_EPISODES = 32
_CHECKPOINT_MOVES = 1600


class Moves(VectorActionWrapper):
    """Four moves of the gripper in place of its continuous actions."""

    table = np.array([(-0.5, 0, 0), (0.5, 0, 0), (0, 1, 0), (0, -1, 0)], np.float32)

    def __init__(self, envs: VectorEnv) -> None:
        super().__init__(envs)
        self.single_action_space = Discrete(len(self.table))
        self.action_space = batch_space(self.single_action_space, envs.num_envs)

    def actions(self, actions: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns the actions, float32 (N, 3), of moves, int64 (N,)."""
        return self.table[actions]


def main(
    text: str,
    task: str,
    *,
    steps: int,
    num_envs: int,
    seed: int,
    sim: str,
    reward: str,
    out: Path,
    log: Path | None,
    resume: Path | None,
) -> None:
    """Trains a policy, or trains one on, and saves it; logs its mean return before and after."""
    envs = gymnasium.make_vec(
        f"freerein/{task}-v0",
        num_envs,
        address=sim,
        episode_timesteps=_TIMESTEPS * _MOVES,
        action_repeat=_TIMESTEPS,
    )
    rewarded = VectorTextReward(Moves(envs), text, address=reward)
    vec_env = VecMonitor(SB3VecEnv(rewarded))
    if resume:
        model = PPO.load(resume, vec_env, device="cpu", tensorboard_log=log and str(log))
    else:
        model = PPO(
            "CnnPolicy",
            vec_env,
            n_steps=4 * _MOVES,
            batch_size=80,
            n_epochs=8,
            learning_rate=5e-4,
            gamma=0.9,
            seed=seed,
            device="cpu",
            verbose=1,
            tensorboard_log=log and str(log),
        )
    checkpoints = CheckpointCallback(max(1, _CHECKPOINT_MOVES // num_envs), str(log / "checkpoints")) if log else None
    before, _ = evaluate_policy(model, vec_env, _EVALUATED_EPISODES, deterministic=False)
    model.learn(steps, checkpoints, reset_num_timesteps=not resume)
    after, _ = evaluate_policy(model, vec_env, _EVALUATED_EPISODES, deterministic=False)
    _log.info("return, of %d: %.2f before, %.2f after %d moves", _MOVES, before, after, model.num_timesteps)
    model.save(out)
    vec_env.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Trains a policy on a reward from language with Stable-Baselines3.")
    parser.add_argument("text", nargs="?", default="a yellow block to the left of a green block", help="what to do")
    parser.add_argument("--task", default="blocks.yellow-left-of-green", help="a task of the sim service")
    parser.add_argument("--steps", type=int, default=8_000, help="moves to train for, in all environments")
    parser.add_argument("--envs", type=int, default=16, help="environments, stepped together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sim", default="127.0.0.1:9104", help="gRPC address of the sim service")
    parser.add_argument("--reward", default="127.0.0.1:9103", help="gRPC address of the reward service")
    parser.add_argument("--out", type=Path, default=Path("policy.zip"), help="file of the policy")
    parser.add_argument("--log", type=Path, help="folder for TensorBoard's curves and checkpoints; none by default")
    parser.add_argument("--resume", type=Path, help="policy or checkpoint to train on, with as many environments")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    main(
        arguments.text,
        arguments.task,
        steps=arguments.steps,
        num_envs=arguments.envs,
        seed=arguments.seed,
        sim=arguments.sim,
        reward=arguments.reward,
        out=arguments.out,
        log=arguments.log,
        resume=arguments.resume,
    )
