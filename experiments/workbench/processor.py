"""The name of the processor that something was measured on."""

import platform
from pathlib import Path

_NAMED_BY = {"model name": "{}", "cpu family": "family {}", "model": "model {}", "stepping": "stepping {}"}


def processor() -> str:
    """Returns the processor's name, and the numbers that tell it apart where a cloud hides its name."""
    info = Path("/proc/cpuinfo")
    first = info.read_text().partition("\n\n")[0].splitlines() if info.is_file() else []
    told = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in first)}
    return ", ".join(text.format(told[key]) for key, text in _NAMED_BY.items() if key in told) or platform.machine()
