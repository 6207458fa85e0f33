"""The example that learns from a sentence, over real services, for 1,280 timesteps, and trains on for as many.

That is one update each, too little to see it learn: `test_stable_baselines_learns_from_a_sentence` does, with an easier
judge.
"""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

EXAMPLE = Path(__file__).parents[2] / "examples" / "train_sb3.py"


@pytest.mark.e2e
@pytest.mark.long
def test_stable_baselines_trains_on_a_sentence(start_service: Callable[..., Any], tmp_path: Path) -> None:
    services = {name: start_service(f"freerein_{name}", tmp_path / name).until_ready() for name in ("sim", "reward")}
    addresses = [word for name, service in services.items() for word in (f"--{name}", service.address)]
    policy = tmp_path / "policy.zip"

    log = tmp_path / "log"
    command = [sys.executable, EXAMPLE, "--steps", "160", "--envs", "8", "--out", policy, "--log", log, *addresses]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)

    assert ran.returncode == 0, ran.stderr
    returns = re.search(r"return, of 5: ([\d.]+) before, ([\d.]+) after 160 moves", ran.stderr)
    assert returns is not None, ran.stderr
    assert all(0 < float(each) < 4 for each in returns.groups())  # some frames show what the sentence says, some do not
    assert is_zipfile(policy)

    more = subprocess.run([*command, "--resume", policy], capture_output=True, text=True, check=False)

    assert more.returncode == 0, more.stderr
    assert "after 320 moves" in more.stderr
    curve = EventAccumulator(str(log / "PPO_1")).Reload().Scalars("rollout/ep_rew_mean")  # goes on where it was
    assert [point.step for point in curve] == [160, 320]
