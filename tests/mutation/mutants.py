"""The mutants of one module: every small change of its text that a test should notice.

Pure: source in, mutants out. Docstrings, texts of messages, annotations, imports and `__str__` are never changed. A
mutant replaces one node of the syntax tree in the text; everything else stays as written.
"""

import ast
from collections.abc import Sequence
from copy import copy
from typing import Any, NamedTuple, TypeVar

Node = TypeVar("Node", bound=ast.AST)


class Mutant(NamedTuple):
    """One change. `where`, `line` (text) and `mutation` (words) name it in the table of survivors."""

    module: str  # path from the root of the checkout
    where: str  # qualified name of the class or function, "" on module level
    number: int  # of the line that changes
    line: str
    mutation: str
    statement: range  # line numbers of the statement, or of its header: a test that runs none of them cannot notice
    source: str  # the whole mutated module


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
OPPOSITES = {"min": "max", "max": "min", "any": "all", "all": "any"}
TRANSPARENT = {"abs", "round"}  # the call becomes its argument
TEXT_FUNCTIONS = {"__str__", "__repr__"}
LOGGER = "logger"
UNTOUCHED_NAMES = {"__slots__", "__all__"}
TYPE_WORDS = {"Callable", "Literal", "dict", "frozenset", "list", "set", "tuple"}  # subscripted: a type, no value
CONSTANTS_OF_MATH = {"pi", "tau"}


class Change(NamedTuple):
    """A node, what replaces it, the change in words, where and on which line, and the lines of its statement."""

    where: str
    node: ast.expr | ast.stmt
    replacement: ast.AST
    words: str
    number: int
    statement: range


def mutants(module: str, source: str) -> list[Mutant]:
    """All mutants of a module in the order of its lines, no two with the same text. Raises SyntaxError."""
    finder = _Finder()
    finder.visit(ast.parse(source))
    text = _Text(source)
    by_source = {text.replaced(change): change for change in reversed(finder.found)}
    by_source.pop(source, None)
    found = [
        Mutant(module, change.where, change.number, text.line(change.number), change.words, change.statement, mutated)
        for mutated, change in by_source.items()
    ]
    return sorted(found, key=lambda mutant: (mutant.number, mutant.mutation))


class _Text:
    """The source by the positions of the syntax tree, whose columns count bytes."""

    def __init__(self, source: str) -> None:
        self._lines = source.encode().splitlines(keepends=True)

    def line(self, number: int) -> str:
        return self._lines[number - 1].decode().strip()

    def replaced(self, change: Change) -> str:
        node, new = change.node, ast.unparse(change.replacement)
        if isinstance(change.replacement, ast.expr) and not isinstance(change.replacement, ast.Name | ast.Constant):
            new = f"({new})"
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        before = [*self._lines[: node.lineno - 1], self._lines[node.lineno - 1][: node.col_offset]]
        after = [self._lines[node.end_lineno - 1][node.end_col_offset :], *self._lines[node.end_lineno :]]
        return b"".join([*before, new.encode(), *after]).decode()


class _Finder(ast.NodeVisitor):
    """Walks a module and collects the changes; a node it has no method for is only walked through."""

    def __init__(self) -> None:
        self.found: list[Change] = []
        self._functions: list[ast.FunctionDef] = []
        self._names: list[str] = []  # of the classes and functions around
        self._statement = range(0)

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.stmt):
            self._statement = _header(node)
        super().visit(node)

    def _change(self, node: ast.expr | ast.stmt, replacement: ast.AST) -> None:
        words = f"{ast.unparse(node)} -> {ast.unparse(replacement)}"
        self._note(node, replacement, words, node.lineno)

    def _without(self, statement: ast.stmt) -> None:
        words = f"without {ast.unparse(statement)}"
        self._note(statement, ast.Pass(), words, statement.lineno)

    def _drop(self, element: ast.expr, words: str, node: ast.expr, rest: ast.expr) -> None:
        self._note(node, rest, f"without {words}", element.lineno)

    def _note(self, node: ast.expr | ast.stmt, replacement: ast.AST, words: str, number: int) -> None:
        self.found.append(Change(".".join(self._names), node, replacement, words, number, self._statement))

    # definitions: only what runs

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name in TEXT_FUNCTIONS:
            return
        for default in [*node.args.defaults, *node.args.kw_defaults]:
            if default is not None:
                self.visit(default)
        self._functions.append(node)
        self._inside(node)
        self._functions.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._inside(node)

    def _inside(self, node: ast.ClassDef | ast.FunctionDef) -> None:
        self._names.append(node.name)
        for statement in node.body:
            self.visit(statement)
        self._names.pop()

    def visit_Lambda(self, node: ast.Lambda) -> None:
        self.visit(node.body)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self._assigned(node.target, node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        if any(isinstance(target, ast.Name) and target.id in UNTOUCHED_NAMES for target in node.targets):
            return
        if all(isinstance(target, ast.Attribute | ast.Subscript) for target in node.targets) and not self._in_init():
            self._without(node)
        self._assigned(node.targets[0], node.value)

    def _assigned(self, target: ast.expr, value: ast.expr) -> None:
        if _is_type(value):
            return
        named = not self._functions and isinstance(target, ast.Name)
        if named and _is_quantity(value) and not (isinstance(value, ast.Constant) and value.value == 0):
            self._scale(value)
            return
        self.visit(value)

    def _in_init(self) -> bool:
        # What __init__ does not set cannot be read: every test notices, and nothing is learnt.
        return bool(self._functions) and self._functions[-1].name == "__init__"

    def _scale(self, value: ast.expr) -> None:
        whole = all(isinstance(leaf.value, int) for leaf in ast.walk(value) if isinstance(leaf, ast.Constant))
        whole = whole and not any(isinstance(part, ast.Div) or _of_math(part) for part in ast.walk(value))
        for operator in (ast.Mult(), ast.FloorDiv() if whole else ast.Div()):
            self._change(value, ast.BinOp(value, operator, ast.Constant(2)))

    # statements

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant) or _is_log(node.value):
            return
        self._without(node)
        self.visit(node.value)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._without(node)
        opposite = ARITHMETIC.get(type(node.op))
        if opposite is not None and not _is_text(node.value):
            self._change(node, _with(node, op=opposite()))
        self._drop_elements(node.value)
        self.visit(node.value)

    def visit_Return(self, node: ast.Return) -> None:
        if node.value is None:
            self._without(node)
            return
        returns = self._functions[-1].returns
        predicate = isinstance(returns, ast.Name) and returns.id == "bool"
        for value in (True, False) if predicate else (None,):
            self._change(node.value, ast.Constant(value))
        self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        self._without(node)

    def visit_Break(self, node: ast.Break) -> None:
        self._without(node)

    def visit_Continue(self, node: ast.Continue) -> None:
        self._without(node)

    def visit_Delete(self, node: ast.Delete) -> None:
        self._without(node)

    def visit_Assert(self, node: ast.Assert) -> None:
        pass

    def visit_Import(self, node: ast.Import) -> None:
        pass

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        pass

    def visit_For(self, node: ast.For) -> None:
        self._drop_elements(node.iter)
        self.generic_visit(node)

    # conditions

    def _decide(self, condition: ast.expr, *values: bool) -> None:
        for value in values:
            self._change(condition, ast.Constant(value))

    def visit_If(self, node: ast.If) -> None:
        self._decide(node.test, True, False)
        self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        self._decide(node.test, False)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        if _is_text(node.body) and _is_text(node.orelse):
            return
        self._decide(node.test, True, False)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for condition in node.ifs:
            self._decide(condition, True, False)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self._change(node, _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And()))
        for index in range(len(node.values)):
            rest = [*node.values[:index], *node.values[index + 1 :]]
            self._change(node, rest[0] if len(rest) == 1 else _with(node, values=rest))
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for index, operator in enumerate(node.ops):
            for other in COMPARISONS[type(operator)]:
                self._change(node, _with(node, ops=[*node.ops[:index], other(), *node.ops[index + 1 :]]))
        for part in [node.left, *node.comparators]:
            self._drop_elements(part)
            if not (isinstance(part, ast.Constant) and part.value is None):
                self.visit(part)

    # values

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not | ast.USub):
            self._change(node, node.operand)
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        opposite = ARITHMETIC.get(type(node.op))
        if _is_text(node.left) or _is_text(node.right):
            return
        if opposite is not None:
            self._change(node, _with(node, op=opposite()))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        for value in _other_values(node.value):
            self._change(node, ast.Constant(value))

    def visit_Call(self, node: ast.Call) -> None:
        if isinstance(node.func, ast.Name):
            opposite = OPPOSITES.get(node.func.id)
            if opposite is not None:
                self._change(node, _with(node, func=ast.Name(opposite)))
            if node.func.id in TRANSPARENT:
                self._change(node, node.args[0])
        self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg != "strict":  # of zip: an assertion
            self.visit(node.value)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pass

    # tables

    def visit_Tuple(self, node: ast.Tuple) -> None:
        if isinstance(node.ctx, ast.Load):
            if not self._functions and _are_rows(node.elts):
                self._drop_elements(node)
            self.generic_visit(node)

    def visit_List(self, node: ast.List) -> None:
        if isinstance(node.ctx, ast.Load):
            self._drop_elements(node)
            self.generic_visit(node)

    def visit_Set(self, node: ast.Set) -> None:
        self._drop_elements(node)
        self.generic_visit(node)

    def visit_Dict(self, node: ast.Dict) -> None:
        for index, (key, value) in enumerate(zip(node.keys, node.values, strict=True)):
            rest = _with(node, keys=_less(node.keys, index), values=_less(node.values, index))
            row = ast.unparse(value) if key is None else f"{ast.unparse(key)}: {ast.unparse(value)}"
            self._drop(key or value, row, node, rest)
        self.generic_visit(node)

    def _drop_elements(self, node: ast.expr) -> None:
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            for index, element in enumerate(node.elts):
                rest = _with(node, elts=_less(node.elts, index))
                self._drop(element, ast.unparse(element), node, rest)


def _header(statement: ast.stmt) -> range:
    """Line numbers of a statement, without those of the statements in it."""
    body = getattr(statement, "body", None)
    last = body[0].lineno - 1 if body else statement.end_lineno or statement.lineno
    return range(statement.lineno, max(last, statement.lineno) + 1)


def _with(node: Node, **fields: object) -> Node:
    """A copy of the node with other fields."""
    changed = copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _less(elements: Sequence[Any], index: int) -> list[Any]:
    return [*elements[:index], *elements[index + 1 :]]


def _other_values(value: object) -> tuple[bool | int | float, ...]:
    """What a constant of this value is changed to; nothing for texts."""
    if value is None:
        return (0,)
    if isinstance(value, bool):
        return (not value,)
    if not isinstance(value, int | float):
        return ()
    number = type(value)
    if value in (0, 1):
        return (number(1),) if value == 0 else (number(0), number(2))
    return (value + 1,) if isinstance(value, int) and value < 10 else (2 * value,)  # one more of many is no change


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_log(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func).startswith(f"{LOGGER}.")


def _is_type(node: ast.expr) -> bool:
    return isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id in TYPE_WORDS


def _is_quantity(node: ast.expr) -> bool:
    """A number, or an expression of numbers and constants."""
    match node:
        case ast.Constant():
            return isinstance(node.value, int | float) and not isinstance(node.value, bool)
        case ast.UnaryOp():
            return _is_quantity(node.operand)
        case ast.BinOp():
            return _is_quantity(node.left) and _is_quantity(node.right)
        case ast.Name():
            return node.id.isupper() or _of_math(node)
    return False


def _of_math(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and node.id in CONSTANTS_OF_MATH


def _are_rows(elements: Sequence[ast.expr]) -> bool:
    """Elements of one sort, as the rows of a table are and the fields of a row are not."""
    return len({type(element) for element in elements}) == 1
