"""Arithmetic expressions of parameter paths: `1.5 * joints.pitch_stiffness`.

The parser of Python reads the text, but the text is never executed as Python.
"""

import ast
import dataclasses
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, Self

from ..runtime.text import InputError, shown

# Functions that an expression may call; `Expression.value` receives their implementations.
_FUNCTIONS = ("sqrt", "exp", "log")

_LONGEST = 1_000
_DEEPEST = 100

# Numbers as elsewhere in files and on the command line: `1_0` is not accepted.
_DIGITS = r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_NUMBER = re.compile(_DIGITS)
_NAME = r"[A-Za-z_][A-Za-z0-9_]*(?![A-Za-z0-9_])"
_WORDS = re.compile(rf"(?:\s*(?:{_DIGITS}(?![A-Za-z0-9_.])|{_NAME}|[-+*/()\[\].]))+\s*")
_SIGNS: dict[type[ast.AST], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_OPERATORS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}

_MADE_OF = (
    f"numbers, parameter paths, + - * /, parentheses and {', '.join(_FUNCTIONS)}: remove "
    "everything else"
)

# A number, ("path", name), or an operator or function with its operands.
_Node = float | tuple[Any, ...]


@dataclasses.dataclass(frozen=True)
class Expression:
    """An expression of parameters, made by `Expression.parse`.

    Attributes:
        text: the original text.
        paths: paths of the parameters in it, each once, in order.
        tree: syntax tree that `value` evaluates.

    Example:
        >>> twice = Expression.parse("2 * links.mass[0]")
        >>> twice.paths
        ('links.mass[0]',)
        >>> twice.value({"links.mass[0]": 0.25}.__getitem__, {})
        0.5
    """

    text: str
    paths: tuple[str, ...]
    tree: _Node = dataclasses.field(repr=False)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a text as an expression.

        Raises:
            InputError: the text is not arithmetic, contains no parameter, or is too long.
        """
        text = text.strip()
        if len(text) > _LONGEST or not text.isascii() or not _WORDS.fullmatch(text):
            raise _wrong(text)
        paths: dict[str, None] = {}
        try:
            tree = _node(ast.parse(text, mode="eval").body, text, paths, 0)
        except (SyntaxError, ValueError, MemoryError, RecursionError):
            raise _wrong(text) from None
        if not paths:
            raise InputError(
                f"the expression {shown(text)} contains no parameter: include a parameter, or fix "
                f"the value"
            )
        return cls(text, tuple(paths), tree)

    def value(self, of: Callable[[str], Any], functions: Mapping[str, Callable[[Any], Any]]) -> Any:
        """Evaluate the expression for parameter values (SI), with these `sqrt`, `exp` and `log`."""
        return _value(self.tree, of, functions)


def _wrong(text: str) -> InputError:
    return InputError(f"the expression {shown(text)} may contain only {_MADE_OF}")


def _node(node: ast.AST, text: str, paths: dict[str, None], depth: int) -> _Node:
    """Convert a part of the parsed text; raise `ValueError` if it is not arithmetic."""
    if depth > _DEEPEST:
        raise ValueError
    if isinstance(node, ast.BinOp) and type(node.op) in _SIGNS:
        left = _node(node.left, text, paths, depth + 1)
        return _SIGNS[type(node.op)], left, _node(node.right, text, paths, depth + 1)
    if isinstance(node, ast.UnaryOp) and type(node.op) in (ast.UAdd, ast.USub):
        operand = _node(node.operand, text, paths, depth + 1)
        return operand if isinstance(node.op, ast.UAdd) else ("-", 0.0, operand)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        if node.func.id not in _FUNCTIONS or node.keywords or len(node.args) != 1:
            raise ValueError
        return node.func.id, _node(node.args[0], text, paths, depth + 1)
    if isinstance(node, ast.Constant):
        number = ast.get_source_segment(text, node) or ""
        if not _NUMBER.fullmatch(number) or not math.isfinite(float(number)):
            raise ValueError
        return float(number)
    path = _path(node, text)
    paths[path] = None
    return "path", path


def _path(node: ast.AST, text: str) -> str:
    """Return a path such as `links.mass[2]`."""
    if isinstance(node, ast.Subscript):
        digits = ast.get_source_segment(text, node.slice) or ""
        if isinstance(node.value, ast.Subscript) or not re.fullmatch("[0-9]{1,9}", digits):
            raise ValueError
        return f"{_path(node.value, text)}[{int(digits)}]"
    if isinstance(node, ast.Attribute):
        return f"{_path(node.value, text)}.{node.attr}"
    if isinstance(node, ast.Name):
        return node.id
    raise ValueError


def _value(
    node: _Node, of: Callable[[str], Any], functions: Mapping[str, Callable[[Any], Any]]
) -> Any:
    if isinstance(node, float):
        return node
    kind, *operands = node
    if kind == "path":
        return of(operands[0])
    values = [_value(operand, of, functions) for operand in operands]
    if kind in functions:
        return functions[kind](values[0])
    return _OPERATORS[kind](*values)
