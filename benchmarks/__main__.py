"""Runs the benchmarks, one thread each: `python -m benchmarks [--quick] [--only NAME ...] [--out FILE]`."""

import argparse
import asyncio
import importlib
import os
from collections.abc import Sequence
from ctypes.util import find_library
from pathlib import Path

_BENCHMARKS = ("rendering", "stepping", "segmenting", "batching", "acting", "streaming", "rewarding", "training")
_ENVIRON = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "0"}
"""For BLAS and torch, and for Mesa, whose 0 is no thread beside the caller's, as in the workers of the service."""

_OUT = Path("var/bench/summary.json")


def main() -> None:
    """Measures, prints and writes; whether a bar is met does not change the exit code, as the machine may be busy."""
    arguments = _parser().parse_args()
    os.environ.setdefault("MUJOCO_GL", "egl" if find_library("EGL") else "osmesa")  # its own default needs a screen
    os.environ |= _ENVIRON  # all of it is read once, by the imports to come
    asyncio.run(_run(arguments.only, quick=arguments.quick, out=arguments.out))


async def _run(names: Sequence[str], *, quick: bool, out: Path) -> None:
    import torch

    from benchmarks import report
    from benchmarks.rounds import QUICK, THOROUGH

    torch.set_num_threads(1)
    effort = QUICK if quick else THOROUGH
    load = os.getloadavg()
    found = report.Findings()
    for name in names:
        found += await importlib.import_module(f"benchmarks.{name}").measure(effort)
    report.show(found)
    report.write(found, out, load=load)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Measures freerein beside its peers.")
    parser.add_argument("--quick", action="store_true", help="run everything once; the figures mean nothing then")
    parser.add_argument("--only", nargs="+", choices=_BENCHMARKS, default=_BENCHMARKS, help="which benchmarks to run")
    parser.add_argument("--out", type=Path, default=_OUT, help="where the summary goes")
    return parser


if __name__ == "__main__":
    main()
