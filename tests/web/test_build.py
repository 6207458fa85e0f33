"""The built page is that of its sources, small, and without an address of another machine."""

import filecmp
import gzip
import re
import subprocess
from pathlib import Path

import pytest
from tests.web.conftest import ROOT, WEB

PAGE = ROOT / "services/orchestrator/freerein_orchestrator/page"
NAMESPACES = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xhtml", "http://www.w3.org/1998/Math/MathML"}


def compressed(*suffixes: str) -> int:
    return sum(len(gzip.compress(path.read_bytes())) for path in PAGE.iterdir() if path.suffix in suffixes)


def test_the_page_is_built_from_its_sources(node: str, tmp_path: Path) -> None:
    subprocess.run([node, "tools/build.mjs", tmp_path], cwd=WEB, check=True, capture_output=True, timeout=60)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == sorted(path.name for path in PAGE.iterdir()), "The page is stale: run `npm run build` in web/"
    assert filecmp.cmpfiles(tmp_path, PAGE, names, shallow=False)[0] == names


def test_its_types_are_right_and_its_logic_passes_its_tests(node: str) -> None:
    for command in (["node_modules/.bin/tsc"], [node, "tools/test.mjs"]):
        ran = subprocess.run(command, cwd=WEB, check=False, capture_output=True, text=True, timeout=120)
        assert ran.returncode == 0, ran.stdout[-3000:] + ran.stderr[-3000:]


def test_it_is_small() -> None:
    assert compressed(".js") < 90_000
    assert compressed(".css") < 10_000
    assert compressed(".js", ".css", ".html") < 110_000
    assert compressed(".webp", ".json") < 150_000


@pytest.mark.parametrize("suffix", [".js", ".css", ".html"])
def test_it_names_no_other_machine(suffix: str) -> None:
    for path in PAGE.glob(f"*{suffix}"):
        urls = set(re.findall(r"https?://[\w./-]+", path.read_text()))
        assert {url for url in urls if not url.startswith(("http://127.0.0.1", "http://localhost"))} <= NAMESPACES, path
