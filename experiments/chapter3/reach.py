"""How much a robot explored, and how far it gets so: distances between its places a few actions apart."""

import asyncio
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.workbench.pipelines import run_folder
from freerein.cli.connection import channel_to
from freerein.cli.settings import CliSettings
from freerein.clients import SimClient, SyncClient
from freerein.clients.tasks import find_task
from freerein.data import Dataset, dataset_path
from freerein.learning.actor_critic.policy_files import load_policy
from freerein.stack import Stack, choose, free_ports, isolated_environ
from freerein.types.sim import CreateSessionRequest
from freerein_orchestrator.envs.episodes import Episode, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle, explorer_policy, stored_policy

ACTIONS = (5, 10, 15, 20)
"""Between two places."""

QUANTILES = {"median": 50, "p90": 90}
EXPLORED, LEARNED, STILL = "explored", "learned", "still"
"""Names of the numbers of actions in the data with an image before and after, of those, not among them, that the
policies which made the data had learned from, and of the share of the former that changed no pixel."""

_ROUNDS, _NUM_ENVS, _SEED = 4, 16, 2_000_003
"""Rounds of episodes, and episodes at a time: 64 engines of `doom` at once may take longer to begin than a call waits.
"""

_READY_TIMEOUT_S = 300.0


def amounts(collected: Mapping[str, Any], *, made: Path) -> dict[str, float]:
    """Returns how many actions a dataset holds, and how many the policies that made it had learned from.

    Args:
        collected: Configuration of the run that collects the data.
        made: Folder of the pipeline that has made them.
    """
    name = collected["dataset"]
    dataset = Dataset(dataset_path(made / "data", name))
    explored = float((dataset.lengths - 1).sum())
    still = sum(_still(frames) for trajectory in dataset for frames in trajectory.frames.values())
    card = json.loads((run_folder(made) / "parts" / name / "artifacts" / "dataset.json").read_bytes())
    learned = {each["sha256"]: each["learned_timesteps"] for each in card.get("parts", ())}
    cameras = len(dataset.spec.cameras)
    return {EXPLORED: explored, LEARNED: float(sum(learned.values())), STILL: still / (explored * cameras)}


def measure(collected: Mapping[str, Any], *, places: int, made: Path, folder: Path) -> dict[str, float]:
    """Returns quantiles of the distances over all parts in their shares, by name, and over each, such as `part.0.NAME`.

    Args:
        collected: Configuration of the run that collects the data.
        places: Numbers of a true state that say where the robot is; they come first.
        made: Folder of the pipeline that has trained the policies.
        folder: For the services' data.
    """
    parts = collected.get("parts") or [{"policy": "random"}]

    async def explore() -> list[Sequence[Episode]]:
        environ, ports = isolated_environ(os.environ), free_ports(("sim",))
        async with Stack(choose(("sim",)), data_dir=folder / "data", environ=environ, ports=ports) as stack:
            await stack.ready(timeout_s=_READY_TIMEOUT_S)
            sim = SyncClient(SimClient(channel_to(stack.addresses["sim"], CliSettings())))
            return [await asyncio.to_thread(_explored, sim, collected["task"], part, made) for part in parts]

    shares = [part.get("share", 1.0) for part in parts]
    walked = [[each.states[:, :places] for each in part] for part in asyncio.run(explore())]
    found = distances(walked, shares)
    for number, part in enumerate(walked):
        found |= {f"part.{number}.{name}": value for name, value in distances([part], [1.0]).items()}
    return found


def distances(parts: Sequence[Sequence[npt.NDArray[np.float64]]], shares: Sequence[float]) -> dict[str, float]:
    """Returns quantiles of distances by number of actions.

    Args:
        parts: Of each part of the data, the places of some episodes, float64 (T + 1, P) each.
        shares: Of each part, of all timesteps.
    """
    found = {}
    for actions in ACTIONS:
        moved = [np.concatenate([_moved(each, actions) for each in part]) for part in parts]
        values = np.concatenate(moved)
        weights = np.concatenate(
            [np.full(len(each), share / len(each)) for each, share in zip(moved, shares, strict=True)]
        )
        order = np.argsort(values)
        below = np.cumsum(weights[order]) / weights.sum()
        for name, percent in QUANTILES.items():
            found[f"moved.{actions}.{name}"] = float(values[order][np.searchsorted(below, percent / 100)])
    return found


def _still(frames: npt.NDArray[np.uint8]) -> int:
    """Returns how many frames, uint8 (T, H, W, C), equal the one before."""
    return int((frames[1:] == frames[:-1]).all(axis=(1, 2, 3)).sum())


def _moved(places: npt.NDArray[np.float64], actions: int) -> npt.NDArray[np.float64]:
    """Returns the distances between places so many actions apart; none in a shorter episode."""
    apart: npt.NDArray[np.float64] = np.linalg.norm(places[actions:] - places[: max(0, len(places) - actions)], axis=1)
    return apart


def _explored(sim: SyncClient, task: str, part: Mapping[str, Any], made: Path) -> Sequence[Episode]:
    name = part.get("task") or task
    policy = _policy(sim, name, part, made)
    rounds = (
        CreateSessionRequest(
            name,
            num_envs=_NUM_ENVS,
            seed=_SEED + number,
            height=policy.height,
            width=policy.width,
            privileged=True,
            conditions=tuple(part.get("conditions", ())),
        )
        for number in range(_ROUNDS)
    )
    return [episode for session in rounds for episode in run_episodes(sim, session, policy, lambda: None)]


def _policy(sim: SyncClient, task: str, part: Mapping[str, Any], made: Path) -> PolicyHandle:
    if part["policy"] == "random":
        return explorer_policy(sim)
    folder = run_folder(made) / "parts" / part["policy"] / "artifacts"
    stored = load_policy(folder, device="cpu")
    return stored_policy(stored, find_task(sim, task), stochastic=part.get("stochastic", False))
