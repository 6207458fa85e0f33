"""What it takes to load a network from a folder."""

import subprocess
import sys
from pathlib import Path

MODELS = Path(__file__).parents[2] / "models"
LOAD = """
import sys
from pathlib import Path

import torch
from freerein_imitation.methods import METHODS
from freerein_reward.model.loading import load_grounding

state = torch.random.get_rng_state()
METHODS.load(Path(sys.argv[1]), "cpu")
load_grounding(Path(sys.argv[2]), "cpu")
print(torch.equal(state, torch.random.get_rng_state()), "torch._dynamo" in sys.modules)
"""


def test_to_load_a_network_draws_no_numbers_and_imports_no_compiler() -> None:
    folders = [next((MODELS / name).glob("*/")) for name in ("imitation/default", "reward/grounding")]
    loaded = subprocess.run([sys.executable, "-c", LOAD, *folders], capture_output=True, text=True, check=True)
    assert loaded.stdout.split() == ["True", "False"]
