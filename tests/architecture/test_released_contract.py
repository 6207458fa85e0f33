"""The contract may grow; what a released client sends and reads stays."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROTO = Path(__file__).parents[2] / "proto"
LIST_SKILLS = "  rpc ListSkills(ListSkillsRequest) returns (ListSkillsResponse);"
BUF = Path(sys.executable).with_name("buf")


def breaks(proto: Path) -> str:
    """Returns what a contract would break of the released one."""
    command = [BUF, "breaking", proto, "--against", PROTO / "released.binpb"]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120).stdout


@pytest.mark.fault("N4")
def test_the_contract_breaks_no_released_client() -> None:
    assert breaks(PROTO) == ""


@pytest.mark.fault("N4")
@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("double smoothing = 6", "double smoothing = 60"), "Previously present field"),
        (("double smoothing = 6", "string smoothing = 6"), "changed type"),
        (("double smoothing = 6", "double smoothness = 6"), "changed name"),
        ((LIST_SKILLS, ""), "Previously present RPC"),
        (("service SegmentationService", "service Segmenter"), "Previously present service"),
        (("double smoothing = 6", "// New.\n  bool added = 99;\n  double smoothing = 6"), ""),
    ],
    ids=["renumbered", "another type", "renamed", "without an RPC", "without a service", "added"],
)
def test_a_change_that_would_is_found(tmp_path: Path, change: tuple[str, str], found: str) -> None:
    changed = shutil.copytree(PROTO, tmp_path / "proto")
    path = changed / "freerein/api/segmentation/v1/segmentation.proto"
    assert change[0] in path.read_text()
    path.write_text(path.read_text().replace(*change))
    broken = breaks(changed)
    assert found in broken
    assert bool(found) == bool(broken)
