"""A client of the sim service at a name: one call for each line of its input, with retries until there is a reply.

It runs where only it sees a hosts file of its own, which this script puts in place of the machine's.
"""

import asyncio
import subprocess
import sys

from freerein.clients import Channel, SimClient
from freerein.errors import Unavailable
from freerein.types.sim import ListTasksRequest


async def main(address: str) -> None:
    """Writes a line for each reply."""
    async with SimClient(Channel(address)) as client:
        while await asyncio.to_thread(sys.stdin.readline):
            await call(client)
            sys.stdout.write("answered\n")
            sys.stdout.flush()


async def call(client: SimClient) -> None:
    """Makes a call, again and again until there is a reply."""
    while True:
        try:
            await client.list_tasks(ListTasksRequest())
            return
        except Unavailable:
            await asyncio.sleep(0.1)


if __name__ == "__main__":
    _, hosts, address = sys.argv
    subprocess.run(["mount", "--bind", hosts, "/etc/hosts"], check=True)
    asyncio.run(main(address))
