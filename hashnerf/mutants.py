"""Mutants: copies of a module with one small fault each, to show whether its tests notice.

Mutated are comparisons, arithmetic, `and`/`or`, dropped `not` and minus, numbers, truth values, conditions, returned
values, strings that are compared or returned, and statements that are left out. What only people read is left alone:
docstrings, annotations, f-strings, calls that print or log, and the arguments of `@dataclass`.
"""

import ast
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

LONGEST_SHOWN = 100
"""Characters of an expression that is shown around a mutated constant."""
# the boundary moved, then the answer turned round
COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
LOG_LEVELS = {"debug", "info", "warning", "warn", "error", "exception", "critical", "log"}
HIDDEN_FIELDS = {"annotation", "returns", "type_comment"}


@dataclass(frozen=True)
class Mutant:
    """A module with one fault."""

    line: int
    """Where the fault lies in the original file."""
    before: str
    """The expression or statement as it was."""
    after: str
    """What stands there instead."""
    source: str
    """The whole mutated module."""


@dataclass(frozen=True)
class _Place:
    """Where a node hangs in the tree."""

    holder: ast.AST
    field: str
    index: int | None = None

    def put(self, new: object) -> object:
        """Hangs another node there and returns the one that hung there."""
        if self.index is None:
            old = getattr(self.holder, self.field)
            setattr(self.holder, self.field, new)
            return old
        nodes = getattr(self.holder, self.field)
        old, nodes[self.index] = nodes[self.index], new
        return old


@dataclass(frozen=True)
class _Edit:
    """A change that can be made to the tree and taken back."""

    line: int
    shown: ast.AST
    place: _Place
    new: ast.AST


def mutants_of(source: str) -> Iterator[Mutant]:
    """Yields every mutant of a module in the order of its lines; each compiles, and no two are the same text.

    Raises SyntaxError where the source is no module.
    """
    tree = ast.parse(source)
    seen = {ast.unparse(tree)}
    for edit in sorted(_edits(tree, _texts_that_matter(tree)), key=lambda edit: edit.line):
        before = ast.unparse(edit.shown)
        old = edit.place.put(edit.new)
        mutated = ast.unparse(tree)
        after = ast.unparse(edit.new if edit.shown is old else edit.shown)
        edit.place.put(old)
        if mutated not in seen and _compiles(mutated):
            seen.add(mutated)
            yield Mutant(edit.line, before, after, mutated)


def _compiles(source: str) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # such as `is` with a number
        try:
            compile(source, "<mutant>", "exec")
        except (SyntaxError, ValueError):
            return False
    return True


def _edits(node: ast.AST, texts: set[int]) -> Iterator[_Edit]:
    """The changes below a node, in the order of the source."""
    for field, value in ast.iter_fields(node):
        if field in HIDDEN_FIELDS:
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST) and not _for_people(child):
                place = _Place(node, field, index)
                yield from _conditions(place, child)
                yield from _changes(place, child, texts)
                yield from _edits(child, texts)


def _for_people(node: ast.AST) -> bool:
    """Whether nothing in a node is run for what it does: text, logs, and what only type checkers see."""
    if isinstance(node, ast.JoinedStr):
        return True
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant) or _logs(node.value)
    if isinstance(node, ast.If):
        return ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
    if isinstance(node, ast.Assign):
        names = [target.id for target in node.targets if isinstance(target, ast.Name)]
        return any(name.startswith("__") and name.endswith("__") for name in names)
    return isinstance(node, ast.Call) and ast.unparse(node.func) in ("dataclass", "dataclasses.dataclass")


def _logs(node: ast.AST) -> bool:
    if not isinstance(node, ast.Call):
        return False
    if isinstance(node.func, ast.Attribute):
        owner = ast.unparse(node.func.value).lower()
        return node.func.attr in LOG_LEVELS and ("log" in owner or owner == "warnings")
    return isinstance(node.func, ast.Name) and node.func.id == "print"


def _texts_that_matter(tree: ast.AST) -> set[int]:
    """The ids of the string and bytes constants that are compared or returned, alone or as part of a tuple."""
    roots: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            roots += [node.left, *node.comparators]
        elif isinstance(node, ast.Return | ast.MatchValue) and node.value is not None:
            roots.append(node.value)
    found = set()
    while roots:
        node = roots.pop()
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            roots += node.elts
        elif isinstance(node, ast.IfExp):
            roots += [node.body, node.orelse]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str | bytes):
            found.add(id(node))
    return found


def _conditions(place: _Place, node: ast.AST) -> Iterator[_Edit]:
    """A negated condition, unless another change of it says the same: one comparison, a `not`, a constant."""
    if place.field in ("test", "ifs", "guard") and not isinstance(place.holder, ast.Assert):
        single = isinstance(node, ast.Compare) and len(node.ops) == 1
        dropped = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
        if not single and not dropped and not isinstance(node, ast.Constant):
            yield _Edit(node.lineno, node, place, ast.UnaryOp(ast.Not(), node))


def _changes(place: _Place, node: ast.AST, texts: set[int]) -> Iterator[_Edit]:
    if isinstance(node, ast.Compare):
        for index, operator in enumerate(node.ops):
            for other in COMPARISONS[type(operator)]:
                yield _Edit(node.lineno, node, _Place(node, "ops", index), other())
    elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in ARITHMETIC:
        yield _Edit(node.lineno, node, _Place(node, "op"), ARITHMETIC[type(node.op)]())
    elif isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield _Edit(node.lineno, node, _Place(node, "op"), other)
    elif isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.UAdd):
        yield _Edit(node.lineno, node, place, node.operand)
    elif isinstance(node, ast.Constant):
        for value in _other_values(node, texts):
            yield _Edit(node.lineno, _around(place.holder, node), place, ast.Constant(value))
    if isinstance(node, ast.Return) and node.value is not None:
        yield _Edit(node.lineno, node, _Place(node, "value"), ast.Constant(None))
    elif _can_be_left_out(node):
        yield _Edit(node.lineno, node, place, ast.Pass())


def _other_values(node: ast.Constant, texts: set[int]) -> list[object]:
    value = node.value
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int):
        return [0 if value == 1 else value + 1]
    if isinstance(value, float):
        return [2 * value if value else 1.0]
    if id(node) in texts:
        return [value + (b"!" if isinstance(value, bytes) else "!")]
    return []


def _around(holder: ast.AST, node: ast.Constant) -> ast.AST:
    """What is shown of a mutated constant: the expression or short statement that it stands in."""
    shown = isinstance(holder, ast.expr | ast.keyword | ast.Assign | ast.AnnAssign | ast.AugAssign | ast.Return)
    return holder if shown and len(ast.unparse(holder)) <= LONGEST_SHOWN else node


def _can_be_left_out(node: ast.AST) -> bool:
    if isinstance(node, ast.Assign | ast.AnnAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        return node.value is not None and any(isinstance(target, ast.Attribute | ast.Subscript) for target in targets)
    if isinstance(node, ast.Expr):
        return isinstance(node.value.value if isinstance(node.value, ast.Await) else node.value, ast.Call)
    return isinstance(node, ast.AugAssign | ast.Break | ast.Continue | ast.Raise | ast.Delete | ast.Return)
