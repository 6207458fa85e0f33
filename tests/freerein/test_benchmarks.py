"""The benchmarks run, and what is promised of speed has a bar."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.long]
ROOT = Path(__file__).parents[2]
KINDS = {"sim", "envs", "segment", "reward", "criteria", "act", "control", "ppo"}
PROMISED = {
    "act.control-bytes_adds_vs_bare_policy.64px",
    "act.control-bytes_adds_vs_bare_policy.224px",
    "control.p99_vs_bare.32x50hz",
    "reward.images32_vs_1.grpc",
    "criteria.three_cameras_vs_one",
    "ppo.network_vs_in_process",
}


@pytest.mark.fault("G1")
@pytest.mark.fault("G3")
def test_benchmarks_run_and_what_is_promised_has_a_bar(tmp_path: Path) -> None:
    out = tmp_path / "summary.json"

    command = [sys.executable, "-m", "benchmarks", "--quick", "--out", out]
    subprocess.run(command, cwd=ROOT, check=True)

    summary = json.loads(out.read_bytes())
    assert {name.partition(".")[0] for name in summary["ratios"]} == KINDS
    assert all(math.isfinite(ratio["value"]) for ratio in summary["ratios"].values())
    with_bar = {name for name, ratio in summary["ratios"].items() if ratio["bar"] is not None}
    assert with_bar == PROMISED
