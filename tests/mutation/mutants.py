"""Every place of a module at which one small mistake can be put in, found on its syntax tree."""

from __future__ import annotations

import ast
import copy
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

_COMPARISONS = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
_ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
_EXTREMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
_NUMBERS = ("float", "int", "Float[", "Int[")
_NEVER_MUTATED = {"annotation", "returns", "decorator_list", "type_params"}
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")


@dataclass(frozen=True)
class Mutant:
    """One small mistake, named so that it is found again after its module has moved.

    Attributes:
        module: File of the module, relative to the tree.
        function: Qualified name inside the module of the function or class; empty at the module's level.
        statement: Source of the innermost statement, without the block that it may head.
        operator: Kind of mistake.
        occurrence: Number of the mistake among those of the same operator in the same statement.
        before: Source of the expression.
        after: Source of what replaces it.
    """

    module: str
    function: str
    statement: str
    operator: str
    occurrence: int
    before: str
    after: str

    @property
    def package(self) -> str:
        """Package of prbench that holds the module."""
        return Path(self.module).parts[1].removesuffix(".py")


@dataclass(frozen=True)
class _Site:
    """A node that can be replaced, and where it hangs in the tree."""

    parent: ast.AST
    field: str
    index: int | None
    function: str
    statement: str
    returns: str

    @property
    def node(self) -> ast.AST:
        value = getattr(self.parent, self.field)
        return value if self.index is None else value[self.index]

    def put(self, node: ast.AST) -> None:
        if self.index is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.index] = node


def draw(mutants: list[Mutant], *, packages: tuple[str, ...], seed: int, count: int) -> list[Mutant]:
    """Draw mutants in turn from each package, each of a kind of mistake that is drawn first.

    Args:
        mutants: All mutants of the tree.
        packages: Packages to draw from.
        seed: Of the draw.
        count: How many.
    """
    random = Random(seed)
    pools: dict[str, dict[str, list[Mutant]]] = {package: defaultdict(list) for package in packages}
    for mutant in mutants:
        if mutant.package in pools:
            pools[mutant.package][mutant.operator].append(mutant)
    drawn = []
    for number in range(count):
        pool = pools[packages[number % len(packages)]]
        operator = random.choice(sorted(pool))
        left = pool[operator]
        drawn.append(left.pop(random.randrange(len(left))))
        if not left:
            del pool[operator]
    return drawn


def mutants_of(tree: Path, module: Path) -> list[Mutant]:
    """List every mutant of one module.

    Args:
        tree: Root of the checkout.
        module: File below it.
    """
    return [mutant for mutant, _, _ in _mutants_with_sites(tree, module, _parse(module))]


def mutated_source(tree: Path, wanted: Mutant) -> str:
    """Return the source of the mutant's whole module, with the mistake in it.

    Args:
        tree: Root of the checkout.
        wanted: One of ``mutants_of`` the module.

    Raises:
        ValueError: if the module has no such mutant.
    """
    module = tree / wanted.module
    parsed = _parse(module)
    for mutant, site, replacement in _mutants_with_sites(tree, module, parsed):
        if mutant == wanted:
            site.put(replacement)
            return ast.unparse(ast.fix_missing_locations(parsed))
    raise ValueError(f"{module} has no such mutant: {wanted}")


def _parse(module: Path) -> ast.Module:
    return ast.parse(module.read_text(encoding="utf-8"))


def _mutants_with_sites(tree: Path, module: Path, parsed: ast.Module) -> Iterator[tuple[Mutant, _Site, ast.AST]]:
    name = module.relative_to(tree).as_posix()
    seen: Counter[tuple[str, str, str]] = Counter()
    for site in list(_sites(parsed, "", "", "")):
        for operator, replacement in _replacements(site.node, site):
            place = (site.function, site.statement, operator)
            yield Mutant(name, *place, seen[place], ast.unparse(site.node), ast.unparse(replacement)), site, replacement
            seen[place] += 1


def _sites(parent: ast.AST, function: str, statement: str, returns: str) -> Iterator[_Site]:
    for field, value in ast.iter_fields(parent):
        if field in _NEVER_MUTATED:
            continue
        nodes = enumerate(value) if isinstance(value, list) else [(None, value)]
        for index, node in nodes:
            if not isinstance(node, ast.AST) or isinstance(node, ast.Assert):
                continue
            here, within, result = statement, function, returns
            if isinstance(node, ast.stmt):
                here = _header(node)
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                within = f"{function}.{node.name}".lstrip(".")
            if isinstance(node, ast.FunctionDef):
                result = ast.unparse(node.returns) if node.returns else ""
            yield _Site(parent, field, index, within, here, result)
            yield from _sites(node, within, here, result)


def _header(statement: ast.stmt) -> str:
    bare = copy.copy(statement)
    for block in _BLOCKS:
        if hasattr(bare, block):
            setattr(bare, block, [])
    return ast.unparse(bare).strip()


def _replacements(node: ast.AST, site: _Site) -> Iterator[tuple[str, ast.AST]]:
    match node:
        case ast.Compare(ops=ops):
            for number, kind in enumerate(ops):
                if type(kind) in _COMPARISONS:
                    changed = copy.deepcopy(node)
                    changed.ops[number] = _COMPARISONS[type(kind)]()
                    yield "comparison", changed
        case ast.BinOp(left=left, op=kind, right=right) if type(kind) in _ARITHMETIC:
            if not (_is_text(left) or _is_text(right)):
                yield "arithmetic", ast.BinOp(left, _ARITHMETIC[type(kind)](), right)
        case ast.BoolOp(op=kind, values=values):
            yield "and/or", ast.BoolOp(ast.Or() if isinstance(kind, ast.And) else ast.And(), values)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "not", operand
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            yield "constant", ast.Constant(0 if value == 1 else value + 1)
        case ast.Name(id=name, ctx=context) if name in _EXTREMES and site.field == "func":
            yield "min/max", ast.Name(_EXTREMES[name], context)
        case ast.Attribute(value=value, attr=name, ctx=context) if name in _EXTREMES and site.field == "func":
            yield "min/max", ast.Attribute(value, _EXTREMES[name], context)
        case ast.Return(value=ast.expr() as value) if site.returns == "bool":
            yield "return", ast.Return(ast.UnaryOp(ast.Not(), value))
        case ast.Return(value=ast.expr() as value) if site.returns.startswith(_NUMBERS):
            yield "return", ast.Return(ast.UnaryOp(ast.USub(), value))
        case ast.Slice(lower=lower, upper=upper, step=step):
            if upper is not None:
                yield "slice", ast.Slice(lower, ast.BinOp(upper, ast.Sub(), ast.Constant(1)), step)
            if lower is not None:
                yield "slice", ast.Slice(ast.BinOp(lower, ast.Add(), ast.Constant(1)), upper, step)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
