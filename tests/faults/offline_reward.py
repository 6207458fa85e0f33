"""Asks the reward service for a reward, both in a network namespace that has a loopback device and nothing else."""

import asyncio
import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from freerein.clients import Channel, RewardClient
from freerein.errors import Unavailable
from freerein.fork_server import ForkServer, Program
from freerein.types.reward import RewardRequest

ASKED = RewardRequest("a red block on top of a yellow block", {"front": np.zeros((1, 64, 64, 3), np.uint8)})
NEW_USER, NEW_NETWORK = 0x10000000, 0x40000000  # of `unshare(2)`


def isolate() -> None:
    """Moves this process into namespaces of its own."""
    user = os.geteuid()
    if ctypes.CDLL(None, use_errno=True).unshare(NEW_USER | NEW_NETWORK):
        raise OSError(ctypes.get_errno(), "unshare")
    Path("/proc/self/uid_map").write_text(f"0 {user} 1")
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)


async def reward(address: str) -> float:
    """Returns the reward of a black image, once the service is ready."""
    async with RewardClient(Channel(address)) as client, asyncio.timeout(300):
        while True:
            try:
                return float((await client.reward(ASKED)).rewards[0])
            except Unavailable:
                await asyncio.sleep(0.1)


def main(data_dir: str) -> None:
    """Writes the reward to standard output."""
    isolate()
    settings = {"FREEREIN_HTTP_PORT": "0", "FREEREIN_GRPC_PORT": "0", "FREEREIN_DATA_DIR": data_dir}
    ports, written = os.pipe()
    service = ForkServer.fork().start(Program("freerein_reward", (), {**os.environ, **settings}, 0, written, 2))
    try:
        with os.fdopen(ports) as told:
            port = json.loads(told.readline())["grpc_port"]
            sys.stdout.write(f"reward {asyncio.run(reward(f'127.0.0.1:{port}'))}\n")
            sys.stdout.flush()
    finally:
        service.send_signal(15)
        service.wait(60)


if __name__ == "__main__":
    main(sys.argv[1])
