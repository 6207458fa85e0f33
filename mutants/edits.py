"""The small changes that are made to a source file: each replaces one statement or expression by another."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Add,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}

_LIKE_NONE = ("None", "False", "0", "''", "b''", "()", "[]", "{}")
"""Values that mostly serve as None does."""


@dataclass(frozen=True, order=True)
class Edit:
    """One change.

    Attributes:
        start: First byte of the replaced part of the file.
        end: The byte after it.
        where: Names of the class and function around it, such as `Batcher.submit`; empty at the top of the file.
        after: What takes its place.
    """

    start: int
    end: int
    where: str
    after: str

    def apply(self, source: bytes) -> bytes:
        """Returns the changed file."""
        return source[: self.start] + self.after.encode() + source[self.end :]


def find_edits(source: bytes) -> list[Edit]:
    """Returns all edits of a Python file, in the order of their places."""
    lines = source.splitlines(keepends=True)
    starts = [sum(map(len, lines[:i])) for i in range(len(lines))]
    found = set()
    for node, where in _walk(ast.parse(source), ""):
        for target, after in _alternatives(node):
            start = starts[target.lineno - 1] + target.col_offset
            end = starts[(target.end_lineno or 0) - 1] + (target.end_col_offset or 0)
            found.add(Edit(start, end, where, after))
    return sorted(found)


def _walk(node: ast.AST, where: str) -> Iterator[tuple[ast.AST, str]]:
    """Yields nodes and the names around them; passes over what only people and type checkers read."""
    match node:
        case ast.JoinedStr() | ast.Expr(ast.Constant()) | ast.Call(ast.Name("TypeVar")):
            return
        case ast.Expr(ast.Call(ast.Attribute(ast.Name("_log")))):
            return
        case ast.ClassDef(name) | ast.FunctionDef(name) | ast.AsyncFunctionDef(name):
            where = f"{where}.{name}".lstrip(".")
    yield node, where
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns", "decorator_list", "bases"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _walk(child, where)


def _alternatives(node: ast.AST) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """Yields what may be replaced at a node, and by what."""
    if isinstance(node, ast.expr):
        yield from ((node, after) for after in _other_expressions(node))
    elif isinstance(node, ast.stmt):
        yield from ((node, after) for after in _other_statements(node))
    match node:
        case ast.If(test) | ast.While(test) | ast.IfExp(test) | ast.comprehension(ifs=[test]):
            if not isinstance(test, ast.Compare | ast.UnaryOp):  # whose own change is the same
                yield test, f"(not {_bracketed(test)})"


def _other_expressions(node: ast.expr) -> Iterator[str]:
    match node:
        case ast.Compare(left, operators, comparators):
            for i, operator in enumerate(operators):
                changed = [*operators[:i], _COMPARISONS[type(operator)](), *operators[i + 1 :]]
                yield _bracketed(ast.Compare(left, changed, comparators))
        case ast.BoolOp(operator, values):
            yield _bracketed(ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values))
        case ast.BinOp(left, operator, right) if type(operator) in _OPERATORS:
            yield _bracketed(ast.BinOp(left, _OPERATORS[type(operator)](), right))
        case ast.UnaryOp(ast.Not(), operand):
            yield _bracketed(operand)
        case ast.Constant(value) if (after := _other_constant(value)) is not None:
            yield repr(after)


def _other_statements(node: ast.stmt) -> Iterator[str]:
    match node:
        case ast.AugAssign(target, operator, value) if type(operator) in _OPERATORS:
            yield ast.unparse(ast.AugAssign(target, _OPERATORS[type(operator)](), value))
            yield "pass"
        case ast.Return(value) if value is not None and ast.unparse(value) not in _LIKE_NONE:
            yield "return None"
        case ast.Raise() | ast.Break() | ast.Expr(ast.Call() | ast.Await()):
            yield "pass"
        case ast.Assign([ast.Attribute() | ast.Subscript()]):
            yield "pass"
        case ast.Continue():
            yield "break"


def _other_constant(value: object) -> object | None:
    """Returns another constant; None for one that is not changed: text with a space is for people."""
    match value:
        case bool():
            return not value
        case int() | float():
            return value + 1
        case str() | bytes() if len(value.split()) == 1:
            return value[:0]
    return None


def _bracketed(node: ast.expr) -> str:
    return f"({ast.unparse(node)})"
