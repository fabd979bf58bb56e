"""Static call graph of a package: its functions, and which functions each of them refers to.

References are resolved by name (functions, classes, imports, tables of functions) and, for methods, by the classes of
parameters, fields and results as they are annotated, with all their subclasses. Calls of objects of unknown class are
not resolved.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator, Mapping
from typing import NamedTuple

Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
Node = tuple[str, str]  # module ("jaxgeo.sensor.camera") and qualified name ("FrameCamera.ray"); "" is the module


class Module(NamedTuple):
    """A parsed module: functions and classes by qualified name, module-level values, imports as (module, name)."""

    path: str
    tree: ast.Module
    functions: dict[str, Function]
    classes: dict[str, ast.ClassDef]
    values: dict[str, ast.expr]
    imports: dict[str, tuple[str, str | None]]

    @classmethod
    def parsed(cls, path: str, source: str) -> Module:
        tree = ast.parse(source)
        module = cls(path, tree, {}, {}, {}, {})
        module.collect(tree, "")
        for node in ast.walk(tree):  # imports within functions too
            if isinstance(node, ast.ImportFrom) and node.module:
                module.imports.update({a.asname or a.name: (node.module, a.name) for a in node.names})
            elif isinstance(node, ast.Import):
                module.imports.update({a.asname or a.name.split(".")[0]: (a.name, None) for a in node.names})
        for statement in tree.body:
            if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
                targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
                names = [n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
                module.values.update(dict.fromkeys(names, statement.value))
        return module

    def collect(self, tree: ast.AST, prefix: str) -> None:
        """Record the functions and classes below a node by their qualified names."""
        for node in ast.iter_child_nodes(tree):
            inner = prefix
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                name = f"{prefix}{node.name}"
                name = f"{name} line {node.lineno}" if name in self.functions else name  # several "_" of defjvp
                self.functions[name] = node
                inner = f"{name}."
            elif isinstance(node, ast.ClassDef):
                self.classes[f"{prefix}{node.name}"] = node
                inner = f"{prefix}{node.name}."
            self.collect(node, inner)


def body_of(function: Function) -> Iterator[ast.AST]:
    """All nodes that run when a function is called, those of nested functions too; not annotations and decorators."""
    waiting: list[ast.AST] = [function.body] if isinstance(function, ast.Lambda) else list(function.body)
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.AnnAssign):
            waiting += [part for part in (node.target, node.value) if part is not None]
        elif isinstance(node, ast.FunctionDef | ast.Lambda):
            waiting += [node.body] if isinstance(node, ast.Lambda) else node.body
        else:
            waiting += ast.iter_child_nodes(node)


def last_name(node: ast.AST) -> str:
    """`c` of the expression a.b.c."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


class Package:
    """The modules of a package, from its sources by path ("jaxgeo/sensor/camera.py")."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        names = {path: path.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for path in sources}
        self.modules = {names[path]: Module.parsed(path, source) for path, source in sources.items()}

    def references(self, node: Node) -> Iterator[Node]:
        """Functions that a function refers to."""
        module_name, name = node
        module = self.modules[module_name]
        nodes = list(body_of(module.functions[name]))
        types = self._local_types(node, nodes)
        for part in nodes:
            if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Load):
                scopes = name.split(".")
                nested = (".".join([*scopes[:depth], part.id]) for depth in range(len(scopes), 0, -1))
                inner = next((scope for scope in nested if scope in module.functions), None)
                yield from self._functions(module_name, part.id) if inner is None else [(module_name, inner)]
            elif isinstance(part, ast.Attribute):
                owners = self._types(module_name, types, part.value)
                if isinstance(part.value, ast.Name) and part.value.id not in types:
                    owners = owners | set(self.targets(module_name, part.value.id))
                for owner in owners:
                    yield from self._member(owner, part.attr)

    def targets(self, module_name: str, name: str) -> Iterator[Node]:
        """Where a name of a module is defined in the package: followed through imports, at most one."""
        seen = set()
        while (module_name, name) not in seen:
            seen.add((module_name, name))
            module = self.modules[module_name]
            if name in module.functions or name in module.classes or name in module.values:
                yield module_name, name
                return
            if name not in module.imports:
                return
            source, imported = module.imports[name]
            whole = source if imported is None else f"{source}.{imported}"
            if whole in self.modules:
                yield whole, ""
                return
            if source not in self.modules or imported is None:
                return
            module_name, name = source, imported

    def returns(self, module_name: str, name: str) -> Iterator[tuple[str, ast.expr]]:
        """(module, annotation) of what a function returns."""
        for where, target in self.targets(module_name, name):
            annotation = getattr(self.modules[where].functions.get(target), "returns", None)
            if annotation is not None:
                yield where, annotation

    def _functions(self, module_name: str, name: str) -> Iterator[Node]:
        """Functions behind a name: itself, the constructor of a class, or the functions in a module-level value."""
        for where, target in self.targets(module_name, name):
            module = self.modules[where]
            if target in module.functions:
                yield where, target
            elif target in module.classes:
                for method in ("__init__", "__post_init__", "__new__"):
                    yield from self._member((where, target), method)
            elif target in module.values:
                yield from self._of_value(where, module.values[target])

    def _member(self, owner: Node, attribute: str) -> Iterator[Node]:
        """A function of a module (owner ""), or a method of a class or of its bases."""
        module_name, name = owner
        module = self.modules[module_name]
        if not name:
            yield from self._functions(module_name, attribute)
        elif f"{name}.{attribute}" in module.functions:
            yield module_name, f"{name}.{attribute}"
        else:
            for base in self._bases(owner):
                yield from self._member(base, attribute)

    def _of_value(self, module_name: str, value: ast.expr) -> Iterator[Node]:
        """Functions in a module-level value, such as a table of them; not the callees, which run at import."""
        callees = {id(node.func) for node in ast.walk(value) if isinstance(node, ast.Call)}
        values = self.modules[module_name].values
        for node in ast.walk(value):
            if isinstance(node, ast.Name) and id(node) not in callees and node.id not in values:
                yield from self._functions(module_name, node.id)

    def _local_types(self, node: Node, nodes: list[ast.AST]) -> dict[str, set[Node]]:
        """Classes of a function's parameters and local names, by annotations and assignments."""
        module_name, name = node
        module = self.modules[module_name]
        own = [(module_name, c) for c in module.classes if name.startswith(f"{c}.")]
        own += [sub for c in own for sub in self.subclasses(c)]
        types = {"self": set(own), "cls": set(own)}
        for function in (module.functions[name], *(n for n in nodes if isinstance(n, ast.FunctionDef))):
            for argument in ast.walk(function.args):
                if isinstance(argument, ast.arg) and argument.annotation is not None:
                    types[argument.arg] = set(self._annotated(module_name, argument.annotation))
        for assignment in reversed([n for n in nodes if isinstance(n, ast.Assign)]):
            target, value = assignment.targets[0], assignment.value
            if isinstance(value, ast.Call) and value.args and isinstance(value.args[0], ast.Tuple):
                value = value.args[0]  # as_float64((self, uv), ...)
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=False))
            for one, part in pairs:
                if isinstance(one, ast.Name):
                    types.setdefault(one.id, set()).update(self._types(module_name, types, part))
        return types

    def _types(self, module_name: str, types: dict[str, set[Node]], node: ast.AST) -> set[Node]:
        """Classes that an expression may have."""
        if isinstance(node, ast.Name):
            return types.get(node.id, set())
        if isinstance(node, ast.Attribute):
            owners = self._types(module_name, types, node.value)
            declared = {found for owner in owners for found in self._declared(owner, node.attr)}
            return {found for where, annotation in declared for found in self._annotated(where, annotation)}
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            return self._types(module_name, types, node.func)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            made = {t for t in self.targets(module_name, node.func.id) if t[1] in self.modules[t[0]].classes}
            declared = self.returns(module_name, node.func.id)
            return made | {found for where, annotation in declared for found in self._annotated(where, annotation)}
        return set()

    def _declared(self, owner: Node, attribute: str) -> Iterator[tuple[str, ast.expr]]:
        """(module, annotation) of a field, or of what a method returns."""
        module_name, name = owner
        definition = self.modules[module_name].classes.get(name)
        for member in definition.body if definition else ():
            if isinstance(member, ast.AnnAssign) and last_name(member.target) == attribute:
                yield module_name, member.annotation
        for where, method in self._member(owner, attribute):
            annotation = getattr(self.modules[where].functions[method], "returns", None)
            if annotation is not None:
                yield where, annotation
        for base in self._bases(owner):
            yield from self._declared(base, attribute)

    def _annotated(self, module_name: str, annotation: ast.expr) -> Iterator[Node]:
        """Classes that an annotation names, and their subclasses."""
        for node in ast.walk(annotation):
            for target in self.targets(module_name, node.id) if isinstance(node, ast.Name) else ():
                if target[1] in self.modules[target[0]].classes:
                    yield target
                    yield from self.subclasses(target)

    def _bases(self, owner: Node) -> Iterator[Node]:
        definition = self.modules[owner[0]].classes.get(owner[1])
        for base in definition.bases if definition else ():
            yield from self.targets(owner[0], last_name(base.value if isinstance(base, ast.Subscript) else base))

    @functools.cached_property
    def _direct_subclasses(self) -> dict[Node, list[Node]]:
        found: dict[Node, list[Node]] = {}
        for module_name, module in self.modules.items():
            for name in module.classes:
                for base in self._bases((module_name, name)):
                    found.setdefault(base, []).append((module_name, name))
        return found

    def subclasses(self, owner: Node) -> list[Node]:
        """All subclasses of a class in the package."""
        direct = self._direct_subclasses.get(owner, [])
        return [*direct, *(sub for one in direct for sub in self.subclasses(one))]
