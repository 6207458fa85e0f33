"""Asks the reward service for a reward, both in a network namespace that has a loopback device and nothing else."""

import asyncio
import json
import os
import subprocess
import sys

import numpy as np

from freerein.clients import Channel, RewardClient
from freerein.errors import Unavailable
from freerein.types.reward import RewardRequest

ASKED = RewardRequest("a red block on top of a yellow block", {"front": np.zeros((1, 64, 64, 3), np.uint8)})


async def reward(address: str) -> float:
    """Returns the reward of a black image, once the service is ready."""
    async with RewardClient(Channel(address)) as client, asyncio.timeout(300):
        while True:
            try:
                return float((await client.reward(ASKED)).rewards[0])
            except Unavailable:
                await asyncio.sleep(0.1)


if __name__ == "__main__":
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    settings = {"FREEREIN_HTTP_PORT": "0", "FREEREIN_GRPC_PORT": "0", "FREEREIN_DATA_DIR": sys.argv[1]}
    command = [sys.executable, "-m", "freerein_reward"]
    service = subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, **settings})
    try:
        port = json.loads(service.stdout.readline())["grpc_port"]
        sys.stdout.write(f"reward {asyncio.run(reward(f'127.0.0.1:{port}'))}\n")
    finally:
        service.terminate()
        service.wait()
