"""What it takes to load a network from a folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

MODELS = Path(__file__).parents[2] / "models"
LOAD = """
import sys
from pathlib import Path

import torch
from freerein_imitation.methods import METHODS
from freerein_reward.model.loading import load_grounding

for name in [each for each in sys.modules if each.split(".")[:2] == ["torch", "_dynamo"]]:
    del sys.modules[name]  # as of a process that has imported no compiler
if hasattr(torch, "_dynamo"):
    del torch._dynamo
state = torch.random.get_rng_state()
METHODS.load(Path(sys.argv[1]), "cpu")
load_grounding(Path(sys.argv[2]), "cpu")
print(torch.equal(state, torch.random.get_rng_state()), "torch._dynamo" in sys.modules)
"""


def test_to_load_a_network_draws_no_numbers_and_imports_no_compiler(fork_program: Callable[..., Any]) -> None:
    folders = [next((MODELS / name).glob("*/")) for name in ("imitation/default", "reward/grounding")]
    assert fork_program("tests.code", LOAD, *folders).stdout.read().split() == ["True", "False"]
