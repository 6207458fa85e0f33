"""JSON files that others wrote, parsed like a request: bounded, and no nesting or number that cannot be held."""

import json
import math
from pathlib import Path
from typing import Any, NoReturn

from freerein.regular_files import read_regular


def read(path: Path, *, name: str, allows_nan: bool = False) -> Any:
    """Returns the contents of a JSON file, called `name` in errors; numbers of statistics may be infinite or NaN.

    Raises:
        ValueError: It is no JSON in UTF-8, is nested too deeply, or has another number.
        InvalidInput: It is no regular file, or too large.
        OSError: It cannot be read.
    """
    return parse(read_regular(path, name=name), allows_nan=allows_nan)


def parse(data: bytes | str, *, allows_nan: bool = False) -> Any:
    """Returns the contents of a JSON document; raises ValueError as `read`."""
    try:
        if allows_nan:
            return json.loads(data)
        return json.loads(data, parse_constant=_not_finite, parse_float=_finite)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _not_finite(text)


def _not_finite(_: str) -> NoReturn:
    raise ValueError("not finite")
