"""Maps as text, in the Universal Doom Map Format: blocks such as `thing { x = 240.0; type = 9001; }`.

Lengths are in map units. x points east, y north.
"""

import re
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

_BLOCK = re.compile(r"(\w+)\s*(?://[^\n]*)?\s*\{([^}]*)\}")
_VALUE = re.compile(r'(\w+)\s*=\s*"?([^";]*)"?;')
_TEXTURE = re.compile(r'(?<=texture)(\w+\s*=\s*)"(\w+)"')

Block = Mapping[str, str]

Point = tuple[int, int]
"""x and y in map units."""


def read_walls(text: str) -> npt.NDArray[np.float64]:
    """Returns both ends of each line with one side, which nobody passes: float64 (L, 2, 2)."""
    vertices = [_place(block) for block in _blocks(text, "vertex")]
    lines = [line for line in _blocks(text, "linedef") if "sideback" not in line]
    return np.array([[vertices[int(line[end])] for end in ("v1", "v2")] for line in lines])


def replace_textures(text: str, names: Mapping[str, str]) -> str:
    """Returns the map with other textures; each that occurs must have a successor in `names`."""
    return _TEXTURE.sub(lambda found: f'{found[1]}"{names[found[2]]}"', text)


def write_block(kind: str, **values: object) -> str:
    """Returns a block."""
    fields = (f"{key} = {_literal(value)};" for key, value in values.items())
    return f"{kind} {{ {' '.join(fields)} }}\n"


def _blocks(text: str, kind: str) -> list[Block]:
    return [dict(_VALUE.findall(body)) for name, body in _BLOCK.findall(text) if name == kind]


def _place(block: Block) -> tuple[float, float]:
    return float(block["x"]), float(block["y"])


def _literal(value: object) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return str(value).lower() if isinstance(value, bool) else str(value)
