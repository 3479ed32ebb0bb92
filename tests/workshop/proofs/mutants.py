"""Mutants of a Python module: small changes of its functions, each as an edit of the source text.

Mutated are the bodies and the default arguments of functions. Not mutated: code at module and class
level, docstrings, other strings, annotations, decorators, log and print calls, and the arguments of
a `raise` statement.
"""

import ast
import io
import tokenize
from bisect import bisect
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "/", "%": "*", "**": "*"}
BITWISE = {"&": "|", "|": "&", "^": "&", "<<": ">>", ">>": "<<"}
COMPARISON = {
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==",
    "is": "is not", "is not": "is", "in": "not in", "not in": "in",
}  # fmt: skip
BOOLEAN = {"and": "or", "or": "and"}
LOGGING = {
    *("debug", "info", "warning", "warn", "error", "fatal", "log", "print"),
    *("print_error", "print_line", "log_change", "set_description"),
}
"""Names of functions and methods whose calls are not mutated."""
NEGATED_RETURNS = {"bool": "not ({})", "float": "-({})", "int": "-({})"}
"""Change of a return value, by the annotation of the function."""


class Mutant(NamedTuple):
    """One edit of a module's source text."""

    line: int
    """First line of the edit, from 1."""
    kind: str
    start: int
    """Offset of the replaced text in the source [bytes]."""
    end: int
    text: str
    """Text in place of the replaced one."""

    def apply(self, source: bytes) -> bytes:
        """Return the mutated source."""
        return source[: self.start] + self.text.encode() + source[self.end :]

    def lines(self, source: bytes) -> tuple[str, str]:
        """Return the changed lines before and after, without indentation, joined by a space."""
        first = source.rfind(b"\n", 0, self.start) + 1
        last = source.find(b"\n", self.end)
        before = source[first : last if last >= 0 else len(source)]
        after = Mutant(0, "", self.start - first, self.end - first, self.text).apply(before)
        return joined(before), joined(after)


def joined(text: bytes) -> str:
    """Return text on one line, with single spaces."""
    return " ".join(text.decode().split())


def mutants_of(source: bytes) -> list[Mutant]:
    """Return all mutants of a module, in the order of the source."""
    visitor = Mutator(source)
    visitor.visit(ast.parse(source))
    return sorted(set(visitor.mutants), key=lambda each: (each.start, each.end, each.text))


class Mutator(ast.NodeVisitor):
    """Collects the mutants of a module."""

    def __init__(self, source: bytes) -> None:
        """Prepare the conversion from lines and columns to offsets."""
        self.source = source
        self.mutants: list[Mutant] = []
        self.offsets = [0]
        for line in source.splitlines(keepends=True):
            self.offsets.append(self.offsets[-1] + len(line))
        self.tokens = list(self.words())
        self.returns: list[str] = []
        """Annotations of the return values of the functions around the current node."""

    def add(self, kind: str, start: int, end: int, text: str) -> None:
        """Add a mutant where the node lies in a function."""
        if self.returns:
            line = self.source.count(b"\n", 0, start) + 1
            self.mutants.append(Mutant(line, kind, start, end, text))

    def words(self) -> Iterator[tuple[int, int, str]]:
        """Return the first offset, the one behind, and the text of each operator and name."""
        lines = self.source.decode().splitlines(keepends=True)
        for token in tokenize.tokenize(io.BytesIO(self.source).readline):
            if token.type in (tokenize.OP, tokenize.NAME):
                start, end = (
                    self.offsets[row - 1] + len(lines[row - 1][:column].encode())
                    for row, column in (token.start, token.end)
                )
                yield start, end, token.string

    def span(self, node: ast.AST) -> tuple[int, int]:
        """Return the first offset of a node and the one behind it."""
        place: ast.expr = node  # type: ignore[assignment]
        assert place.end_lineno is not None
        assert place.end_col_offset is not None
        start = self.offsets[place.lineno - 1] + place.col_offset
        return start, self.offsets[place.end_lineno - 1] + place.end_col_offset

    def replace(self, kind: str, node: ast.AST, pattern: str) -> None:
        """Add a mutant in which a node is replaced; `{}` stands for its text."""
        start, end = self.span(node)
        self.add(kind, start, end, pattern.replace("{}", self.source[start:end].decode()))

    def replace_operator(
        self, kind: str, left: ast.AST, right: ast.AST, changes: dict[str, str]
    ) -> None:
        """Add a mutant of the operator between two operands."""
        start, end = self.span(left)[1], self.span(right)[0]
        first = bisect(self.tokens, (start,))
        words = self.tokens[first : bisect(self.tokens, (end,))]
        words = [each for each in words if each[2] not in ("(", ")")]
        operator = " ".join(text for _, _, text in words)
        if operator in changes:
            self.add(kind, words[0][0], words[-1][1], changes[operator])

    # Nodes whose parts are not all mutated

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        """Visit defaults and body, without docstring, decorators and annotations."""
        self.returns.append(ast.unparse(node.returns) if node.returns else "")
        defaults = [*node.args.defaults, *filter(None, node.args.kw_defaults)]
        for child in [*defaults, *without_docstring(node.body)]:
            self.visit(child)
        self.returns.pop()

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        """Visit the methods."""
        for child in node.body:
            if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
                self.visit(child)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Visit the value, without the annotation."""
        if node.value is not None:
            self.visit(node.value)
            if not isinstance(node.target, ast.Name):
                self.replace("deleted statement", node, "pass")

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Leave text as it is."""

    def visit_Raise(self, node: ast.Raise) -> None:
        """Delete the statement; leave its text as it is."""
        self.replace("deleted statement", node, "pass")

    def visit_Call(self, node: ast.Call) -> None:
        """Visit the call, except where it logs."""
        function = node.func
        name = getattr(function, "attr", getattr(function, "id", ""))
        if name not in LOGGING:
            self.generic_visit(node)

    # Mutated nodes

    def visit_BinOp(self, node: ast.BinOp) -> None:
        """Change the operator, except in the formatting of strings."""
        if not is_text(node.left):
            self.replace_operator("operator", node.left, node.right, ARITHMETIC | BITWISE)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        """Change the operator, and delete the statement."""
        changes = {f"{a}=": f"{b}=" for a, b in (ARITHMETIC | BITWISE).items()}
        self.replace_operator("operator", node.target, node.value, changes)
        self.replace("deleted statement", node, "pass")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        """Change each operator."""
        operands = [node.left, *node.comparators]
        for left, right in pairwise(operands):
            self.replace_operator("comparison", left, right, COMPARISON)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        """Change each operator."""
        for left, right in pairwise(node.values):
            self.replace_operator("boolean", left, right, BOOLEAN)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        """Remove the sign or the `not`."""
        if isinstance(node.op, (ast.USub, ast.Not)):
            start, end = self.span(node)
            kind = "sign" if isinstance(node.op, ast.USub) else "boolean"
            operand = self.source[slice(*self.span(node.operand))].decode()
            self.add(kind, start, end, f"({operand})")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Increase a number, invert a boolean."""
        if isinstance(node.value, bool):
            self.replace("constant", node, str(not node.value))
        elif isinstance(node.value, (int, float)):
            self.replace("constant", node, repr(node.value + 1))

    def visit_Return(self, node: ast.Return) -> None:
        """Negate a number or a boolean."""
        pattern = NEGATED_RETURNS.get(self.returns[-1]) if self.returns else None
        if node.value is not None and pattern:
            self.replace("return value", node.value, pattern)
        self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> None:
        """Delete an assignment to an attribute or an element."""
        if all(isinstance(each, (ast.Attribute, ast.Subscript)) for each in node.targets):
            self.replace("deleted statement", node, "pass")
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        """Delete a call."""
        before = len(self.mutants)
        self.visit(node.value)
        name = getattr(node.value, "func", None)
        called = getattr(name, "attr", getattr(name, "id", ""))
        if isinstance(node.value, ast.Call) and called not in LOGGING:
            self.replace("deleted statement", node, "pass")
        elif isinstance(node.value, ast.Constant):
            del self.mutants[before:]

    def visit_Break(self, node: ast.Break) -> None:
        """Leave out the end of a loop."""
        self.replace("deleted statement", node, "pass")

    def visit_Continue(self, node: ast.Continue) -> None:
        """Run the rest of a loop's body."""
        self.replace("deleted statement", node, "pass")


def without_docstring(body: list[ast.stmt]) -> list[ast.stmt]:
    """Return the statements of a function behind its docstring."""
    first = body[0]
    return body[1:] if isinstance(first, ast.Expr) and is_text(first.value) else body


def is_text(node: ast.expr) -> bool:
    """Check whether a node is a string."""
    if isinstance(node, ast.JoinedStr):
        return True
    return isinstance(node, ast.Constant) and isinstance(node.value, str)
