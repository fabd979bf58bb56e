"""Static search for NumPy calls on traced values in jitted code.

Jitted code is every function that is decorated with, or passed to, a JAX transformation in `TRACING`, and every
function that such a function refers to, as far as `call_graph` resolves it.

A NumPy call is allowed if all its arguments are static: literals, module constants, shapes and dtypes, results of
`concrete`, parameters and results of functions annotated as `int`, `float`, `bool`, `str` or `np.ndarray` (the tests
check annotations at run time), and what is computed from them.
"""

from __future__ import annotations

import ast
import builtins
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from support.call_graph import Function, Module, Package, body_of, last_name

# Last names of decorators and callees that make their function traced code.
TRACING = {"jit", "filter_jit", "custom_jvp", "custom_vjp", "custom_vmap", "defjvp", "defvjp", "def_vmap"}
TRACING |= {"quick_jit", "quick_filter_jit", "batch_filter_jit", "long_run_jit", "long_run_filter_jit"}
ALLOWED = {"ndarray", "dtype", "iinfo", "finfo", "newaxis", "s_", "shape", "ndim"}  # besides dtypes and numbers
STATIC_ATTRIBUTES = {"shape", "ndim", "dtype", "size"}
STATIC_RESULTS = {"concrete", "len", "isinstance", "hasattr", "shape", "ndim"}
STATIC_TYPES = {"int", "float", "bool", "str", "np.ndarray"}


class Use(NamedTuple):
    """A NumPy call in jitted code: its place, and the jitted function through which the search reached it."""

    path: str
    line: int
    function: str
    call: str
    root: str

    def __str__(self) -> str:
        where = f"{self.path}:{self.line}"
        return f"{where}: {self.call} on a traced value in {self.function}, jitted through {self.root}"


def numpy_in_jitted_code(sources: Mapping[str, str]) -> list[Use]:
    """All NumPy calls on traced values in a package, from its sources by path ("jaxgeo/sensor/camera.py")."""
    package = Package(sources)
    waiting = [((name, root), root) for name, module in package.modules.items() for root in _roots(module)]
    reached, found = set(), []
    while waiting:
        node, root = waiting.pop()
        if node in reached:
            continue
        reached.add(node)
        path = package.modules[node[0]].path
        found += [Use(path, line, node[1], call, root) for line, call in _numpy_uses(package, *node)]
        waiting += [(other, root) for other in package.references(node)]
    return sorted(found)


def _roots(module: Module) -> list[str]:
    """Names of a module's traced functions; arguments of calls such as `jit(f)` are added to it as functions."""
    functions = dict(module.functions)
    roots = [name for name, f in functions.items() if any(map(_is_tracing, getattr(f, "decorator_list", ())))]
    scopes = [("", ast.walk(module.tree)), *((f"{name}.", body_of(f)) for name, f in functions.items())]
    for prefix, nodes in scopes:
        for node in nodes:
            if isinstance(node, ast.Call) and _traces_arguments(node):
                passed = ast.Tuple([*node.args, *(keyword.value for keyword in node.keywords)], ast.Load())
                name = f"{prefix}<call line {node.lineno}>"
                module.functions[name] = ast.Lambda(ast.arguments([], [], None, [], [], None, []), passed)
                roots.append(name)
    return roots


def _is_tracing(node: ast.AST) -> bool:
    """Whether an expression is a transformation: `jax.jit`, `jax.jit(static_argnums=0)`, `partial(jax.jit, ...)`."""
    if isinstance(node, ast.Call):
        if last_name(node.func) == "partial":
            return bool(node.args) and _is_tracing(node.args[0])
        return not node.args and _is_tracing(node.func)
    return last_name(node) in TRACING


def _traces_arguments(call: ast.Call) -> bool:
    """Whether a call transforms functions: `jax.jit(f)`, `map(jax.jit, (f, g))`."""
    if last_name(call.func) == "map":
        return bool(call.args) and _is_tracing(call.args[0])
    return bool(call.args) and _is_tracing(call.func)


def _numpy_uses(package: Package, module_name: str, name: str) -> Iterator[tuple[int, str]]:
    """(line, "np.sum") of NumPy calls on values that are not static, and of NumPy functions passed as values."""
    function = package.modules[module_name].functions[name]
    nodes = list(body_of(function))
    static = _Static(package, module_name, function, nodes)
    callees: set[int] = set()
    for node in nodes:
        if isinstance(node, ast.Call) and static.is_numpy(node.func):
            callees |= {id(part) for part in ast.walk(node.func)}
            if not _is_constant(last_name(node.func)) and not static.arguments(node):
                yield node.lineno, ast.unparse(node.func)
    for node in nodes:
        if isinstance(node, ast.Attribute | ast.Name) and id(node) not in callees and static.is_numpy(node):
            callees |= {id(part) for part in ast.walk(node)}
            if not _is_constant(last_name(node)):
                yield node.lineno, ast.unparse(node)


class _Static:
    """Which expressions of a function have values that are known while it is traced."""

    def __init__(self, package: Package, module_name: str, function: Function, nodes: list[ast.AST]) -> None:
        self.package, self.module_name = package, module_name
        self.traced: set[str] = set()
        for inner in [function, *(n for n in nodes if isinstance(n, ast.FunctionDef | ast.Lambda))]:
            arguments = [n for n in ast.walk(inner.args) if isinstance(n, ast.arg)]
            self.traced |= {a.arg for a in arguments if not a.annotation or not _is_static_type(a.annotation)}
        values = list(_assignments(nodes))
        before = -1
        while before != len(self.traced):
            before = len(self.traced)
            for targets, value in values:
                if not self(value):
                    self.traced |= targets

    def __call__(self, node: ast.AST) -> bool:
        if isinstance(node, ast.Name):
            return node.id not in self.traced and self._source(node).split(".")[0] != "jax"
        if isinstance(node, ast.Attribute):
            return node.attr in STATIC_ATTRIBUTES or self(node.value)
        if isinstance(node, ast.Call):
            return self._call(node)
        return isinstance(node, ast.Lambda) or all(self(child) for child in ast.iter_child_nodes(node))

    def arguments(self, call: ast.Call) -> bool:
        return all(self(part) for part in (*call.args, *(keyword.value for keyword in call.keywords)))

    def is_numpy(self, node: ast.AST) -> bool:
        while isinstance(node, ast.Attribute):
            node = node.value
        return isinstance(node, ast.Name) and self._source(node).split(".")[0] == "numpy"

    def _call(self, node: ast.Call) -> bool:
        name = last_name(node.func)
        if name in STATIC_RESULTS:
            return True
        if isinstance(node.func, ast.Name) and not self.is_numpy(node.func) and not hasattr(builtins, name):
            annotations = [annotation for _, annotation in self.package.returns(self.module_name, name)]
            return bool(annotations) and all(map(_is_static_type, annotations))
        return self(node.func) and self.arguments(node)

    def _source(self, node: ast.Name) -> str:
        return self.package.modules[self.module_name].imports.get(node.id, ("", None))[0]


def _is_static_type(annotation: ast.expr) -> bool:
    """Whether an annotation, or each part of a container's, is one of STATIC_TYPES."""
    if isinstance(annotation, ast.Subscript):
        parts = annotation.slice.elts if isinstance(annotation.slice, ast.Tuple) else [annotation.slice]
        return all(_is_static_type(part) for part in parts)
    if isinstance(annotation, ast.BinOp):
        return _is_static_type(annotation.left) and _is_static_type(annotation.right)
    return ast.unparse(annotation) in STATIC_TYPES | {"None", "..."}


def _assignments(nodes: list[ast.AST]) -> Iterator[tuple[set[str], ast.expr]]:
    """(names, value) of assignments, loops and comprehensions."""
    for node in nodes:
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign | ast.AugAssign | ast.NamedExpr) and node.value is not None:
            targets, value = [node.target], node.value
        elif isinstance(node, ast.For | ast.comprehension):
            targets, value = [node.target], node.iter
        else:
            continue
        pairs = [(target, value) for target in targets]
        if isinstance(value, ast.Tuple) and isinstance(targets[0], ast.Tuple) and isinstance(node, ast.Assign):
            pairs = list(zip(targets[0].elts, value.elts, strict=False))
        for target, part in pairs:
            yield {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}, part


def _is_constant(name: str) -> bool:
    value = getattr(np, name, None)
    is_dtype = isinstance(value, type) and issubclass(value, np.generic)
    return name in ALLOWED or is_dtype or isinstance(value, float)
