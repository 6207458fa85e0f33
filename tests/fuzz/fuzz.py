"""Sends generated requests to every REST door: `python tests/fuzz/fuzz.py [EXAMPLES]`, for each call 300 unless told.

No answer may be a 5xx, undocumented, or other than its schema says, and no service may have to be started again.
"""

import asyncio
import os
import sys
import tempfile
from pathlib import Path

from freerein.cli.services import choose, free_ports
from freerein.cli.supervisor import Stack

_CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"


async def main(examples: str = "300") -> int:
    """Returns 0 when every service stood it."""
    services = choose(())
    with tempfile.TemporaryDirectory() as folder:
        stack = Stack(services, data_dir=Path(folder), environ=os.environ, ports=free_ports(services))
        async with stack:
            await stack.ready(timeout_s=60)
            codes = [await _fuzz(url, examples) for url in stack.urls.values()]
            restarts = sum(status.restarts for status in stack.statuses)
    sys.stdout.write(f"{restarts} restarts\n")
    return int(any(codes) or restarts > 0)


async def _fuzz(url: str, examples: str) -> int:
    command = (Path(sys.executable).parent / "schemathesis", "run", f"{url}/openapi.json")
    options = ("--checks", _CHECKS, "--max-examples", examples, "--warnings", "off")
    return await (await asyncio.create_subprocess_exec(*command, *options)).wait()


if __name__ == "__main__":
    sys.exit(asyncio.run(main(*sys.argv[1:])))
