"""The text of a syntax tree, which is the same in all versions of Python: that of `ast.dump` in 3.11.

Since 3.12 `ast.dump` writes type parameters, since 3.13 no empty lists; 3.12 parses an empty string after a computed
format.
"""

import ast
from collections.abc import Iterator
from typing import Any


def syntax_text(part: Any) -> str:
    """Returns the text of a syntax tree, or of a part of one."""
    if isinstance(part, list):
        return f"[{', '.join(map(syntax_text, part))}]"
    if not isinstance(part, ast.AST):
        return repr(part)
    shown = (f"{name}={syntax_text(value)}" for name, value in _fields(part))
    return f"{type(part).__name__}({', '.join(shown)})"


def _fields(node: ast.AST) -> Iterator[tuple[str, Any]]:
    for name, value in ast.iter_fields(node):
        if isinstance(node, ast.JoinedStr):
            yield name, [each for each in value if not (isinstance(each, ast.Constant) and each.value == "")]
        elif not _is_left_out(node, name, value):
            yield name, value


def _is_left_out(node: ast.AST, name: str, value: Any) -> bool:
    may_be_none = getattr(type(node), name, ...) is None
    return (value is None and may_be_none) or (name == "type_params" and not value)
