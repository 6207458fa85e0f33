"""Runs the benchmarks, one thread each: `python -m benchmarks [--quick] [--only NAME ...] [--out FILE]`."""

import argparse
import asyncio
import importlib
import os
from collections.abc import Sequence
from ctypes.util import find_library
from pathlib import Path

_BENCHMARKS = ("sim", "envs", "segment", "act", "control", "reward", "criteria", "ppo")

_ENVIRON = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "0"}
"""Threads of BLAS and torch, and of Mesa, where 0 means the calling thread only, as in the sim service's workers."""

_OUT = Path("var/bench/summary.json")


def main() -> None:
    """Measures, prints and writes. A missed bar does not change the exit code: the machine may be busy."""
    arguments = _parser().parse_args()
    os.environ.setdefault("MUJOCO_GL", "egl" if find_library("EGL") else "osmesa")  # MuJoCo's default needs a display
    os.environ |= _ENVIRON  # read once, by the imports below
    asyncio.run(_run(arguments.only, quick=arguments.quick, out=arguments.out))


async def _run(names: Sequence[str], *, quick: bool, out: Path) -> None:
    import torch

    from benchmarks import report
    from benchmarks.timing import QUICK, THOROUGH

    torch.set_num_threads(1)
    effort = QUICK if quick else THOROUGH
    load = os.getloadavg()
    results = report.Results()
    for name in names:
        results += await importlib.import_module(f"benchmarks.{name}").measure(effort)
    report.show(results)
    report.write(results, out, load=load)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Compare services with what they serve.")
    parser.add_argument("--quick", action="store_true", help="run everything once; figures are meaningless")
    parser.add_argument("--only", nargs="+", choices=_BENCHMARKS, default=_BENCHMARKS, help="which benchmarks to run")
    parser.add_argument("--out", type=Path, default=_OUT, help="file of the summary")
    return parser


if __name__ == "__main__":
    main()
