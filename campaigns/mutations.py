"""Mutations: every small change of a module that a test should notice.

Not drawn, since no test can or should notice them: docstrings, messages of errors, log lines, type
hints, `__repr__`, assertions (`assert`, `strict=` of `zip`), decorators, `if TYPE_CHECKING` and the
order of the arguments of `min` and `max`. Strings are never changed.
"""

from __future__ import annotations

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
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
_ORDER = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_LOGS = ("_log", "log", "logger", "warnings")
_HINTS = ("annotation", "returns", "decorator_list")


@dataclass(frozen=True, order=True)
class Mutation:
    """One change of a module's text.

    Parameters
    ----------
    line : int
        The line where the changed code starts, from 1.
    column : int
        Its column in UTF-8 bytes, from 0.
    kind : str
        What is done: "comparison", "arithmetic", "boolean", "constant", "negated condition",
        "removed statement", "swapped arguments", "returned None" or "jump".
    end : tuple of int
        The line and the column where the changed code ends.
    code : str
        The new code.
    """

    line: int
    column: int
    kind: str
    end: tuple[int, int]
    code: str

    def apply(self, text: str) -> str:
        """Return the text of the module with this change."""
        lines = text.encode().splitlines(keepends=True)
        last, column = self.end
        before = b"".join(lines[: self.line - 1]) + lines[self.line - 1][: self.column]
        after = lines[last - 1][column:] + b"".join(lines[last:])
        return (before + self.code.encode() + after).decode()

    def original(self, text: str) -> str:
        """Return the code that is replaced, on one line."""
        lines = text.encode().splitlines(keepends=True)
        last, column = self.end
        taken = [*lines[self.line - 1 : last - 1], lines[last - 1][:column]]
        taken[0] = taken[0][self.column :]
        return " ".join(b"".join(taken).decode().split())


def mutations(text: str) -> list[Mutation]:
    """List all mutations of a module, in the order of its text."""
    return sorted(set(_of_node(ast.parse(text))))


def _of_node(node: ast.AST) -> Iterator[Mutation]:
    """List the mutations of a node and of the nodes below it."""
    if _is_hidden(node):
        return
    for kind, replaced, code in _changes(node):
        assert replaced.end_lineno is not None and replaced.end_col_offset is not None
        end = (replaced.end_lineno, replaced.end_col_offset)
        yield Mutation(replaced.lineno, replaced.col_offset, kind, end, code)
    for field, value in ast.iter_fields(node):
        if field not in _HINTS:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _of_node(child)


def _is_hidden(node: ast.AST) -> bool:
    """Return whether a node is not drawn, with all that is below it."""
    match node:
        case ast.Assert() | ast.JoinedStr() | ast.Import() | ast.ImportFrom():
            return True
        case ast.FunctionDef(name="__repr__"):
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id=name)))):
            return name in _LOGS
        case ast.Expr(value=ast.Constant()):
            return True
        case ast.keyword(arg="strict"):
            return True
        case ast.Call(func=ast.Name(id="TypeVar" | "cast")):
            return True
        case ast.Call(func=ast.Name(id=name)):
            return name.endswith(("Error", "Warning"))
        case ast.BinOp(op=ast.BitOr(), right=ast.Constant(value=None)):
            return True
    return False


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.expr | ast.stmt, str]]:
    """List the kinds of changes of one node, the node that is replaced, and the new code."""
    match node:
        case ast.Compare():
            for n, old in enumerate(node.ops):
                ops = [*node.ops[:n], _COMPARISONS[type(old)](), *node.ops[n + 1 :]]
                yield "comparison", node, _code(ast.Compare(node.left, ops, node.comparators))
        case ast.BinOp():
            operator = _ARITHMETIC[type(node.op)]()
            yield "arithmetic", node, _code(ast.BinOp(node.left, operator, node.right))
        case ast.AugAssign():
            operator = _ARITHMETIC[type(node.op)]()
            changed = ast.AugAssign(node.target, operator, node.value)
            yield "arithmetic", node, ast.unparse(changed)
            yield "removed statement", node, "pass"
        case ast.BoolOp():
            other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield "boolean", node, _code(ast.BoolOp(other, node.values))
        case ast.UnaryOp(op=ast.Not()):
            yield "boolean", node, _code(node.operand)
        case ast.UnaryOp(op=ast.USub() | ast.Invert()):
            yield "arithmetic", node, _code(node.operand)
        case ast.Constant(value=bool()):
            yield "constant", node, str(not node.value)
        case ast.Constant(value=int() | float() as value):
            more = value + 1
            yield "constant", node, repr(more if more != value else value / 2)
        case ast.Call(args=[first, second, *others]):
            starred = isinstance(first, ast.Starred) or isinstance(second, ast.Starred)
            same = ast.dump(first) == ast.dump(second)
            if not starred and not same and ast.unparse(node.func) not in ("max", "min"):
                call = ast.Call(node.func, [second, first, *others], node.keywords)
                yield "swapped arguments", node, _code(call)
        case ast.Return(value=ast.expr() as value) if ast.unparse(value) != "None":
            yield "returned None", node, "return None"
        case ast.Break() | ast.Continue():
            yield "jump", node, "continue" if isinstance(node, ast.Break) else "break"
        case ast.Raise() | ast.Delete() | ast.Expr(value=ast.Call()):
            yield "removed statement", node, "pass"
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield "removed statement", node, "pass"
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            if not _is_inverted(test):
                yield "negated condition", test, _code(ast.UnaryOp(ast.Not(), test))


def _code(node: ast.expr) -> str:
    return f"({ast.unparse(node)})"


def _is_inverted(test: ast.expr) -> bool:
    """Return whether another kind of change negates a condition already."""
    match test:
        case ast.UnaryOp(op=ast.Not()):
            return True
        case ast.Compare(ops=[operator]):
            return not isinstance(operator, _ORDER)
    return False
