"""Programs kept on disk and found again by what they are called with: a later process neither traces nor compiles.

JAX's own cache finds a program by its text, which takes seconds of tracing to make.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import os
import pathlib
import pickle
import sys
import tempfile
import types
import uuid
import zlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._native import identity, is_native

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

# Packages whose classes and functions may be part of a program's key: their versions are part of it as well.
KNOWN_PACKAGES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "lineax", "jaxtyping")
STANDARD = ("builtins", "functools", "collections", "pathlib", "types", "operator", "copyreg", "enum", "_operator")
FOR_EVER = 1e9  # s
# Settings of JAX for a part of a process; and words in the names of those that change no program.
SETTINGS = (
    "jax_enable_x64 jax_default_matmul_precision jax_numpy_dtype_promotion jax_default_prng_impl "
    "jax_threefry_partitionable jax_debug_nans jax_debug_infs jax_default_device"
).split()
WITHOUT_EFFECT = ("cache", "log", "traceback", "profil", "platforms", "dump")


class Program(NamedTuple):
    """A program of flat lists, and what puts its results together: numbers of arrays in the place of arrays."""

    run: Any
    results: Any
    has_lapack: bool

    def __call__(self, arrays: list[Any]) -> Any:
        found = self.run(arrays)
        return jax.tree.map(lambda leaf: found[leaf.number] if isinstance(leaf, _Number) else leaf, self.results)


class Programs:
    """The programs of a function, one for each kind of arguments, compiled ahead of their calls.

    `is_array` tells the leaves that are arguments and results of the program; the others are part of it.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        options_of: Callable[[], dict[str, Any]],
        is_array: Callable[[Any], bool],
    ) -> None:
        self._function, self._options_of, self._is_array = function, options_of, is_array
        self._programs: dict[Any, Program | None] = {}

    def call(self, folder: pathlib.Path, args: tuple[Any, ...], options: dict[str, Any]) -> Callable[[], Any] | None:
        """The call by a program that is read from `folder`, or written there; None if no program can be kept."""
        found = self._with_arrays(folder, args, options)
        return None if found is None else lambda: found[0](found[1])

    def find(self, folder: pathlib.Path, args: tuple[Any, ...], options: dict[str, Any]) -> Program | None:
        """The program of these arguments and of all of their kind; None if none can be kept."""
        found = self._with_arrays(folder, args, options)
        return None if found is None else found[0]

    def _with_arrays(
        self, folder: pathlib.Path, args: tuple[Any, ...], options: dict[str, Any]
    ) -> tuple[Program, list[Any]] | None:
        """The program and its arrays; None if none can be kept.

        So it is for arguments with a class or function that is not of a known package, on other backends than the CPU,
        and for arrays on several devices.
        """
        if jax.default_backend() != "cpu" or is_debugging():
            return None
        leaves: list[Any]
        leaves, structure = jax.tree.flatten((args, options))
        arrays = [leaf for leaf in leaves if self._is_array(leaf)]
        if not all(_is_on_first_device(array) for array in arrays):
            return None
        kinds = [_Kind.of(leaf) if self._is_array(leaf) else leaf for leaf in leaves]
        key = structure, tuple(kinds), tuple(type(kind) for kind in kinds), _settings()
        try:
            is_new = key not in self._programs
        except TypeError:  # not hashable
            return None
        if is_new:
            name = self._name(jax.tree.unflatten(structure, kinds))
            self._programs[key] = None if name is None else self._found(folder / name, structure, kinds, arrays)
        program = self._programs[key]
        return None if program is None else (program, arrays)

    def _found(self, path: pathlib.Path, structure: Any, kinds: list[Any], arrays: list[Any]) -> Program:
        program = _read(path)
        if program is not None:
            return program
        with _alone(path):
            program = _read(path)  # another process may have compiled it meanwhile
            if program is None:
                program = self._compiled(structure, kinds, arrays)
                _write(path, program)
        return program

    def _compiled(self, structure: Any, kinds: list[Any], arrays: list[Any]) -> Program:
        results: list[Any] = []

        def of_arrays(arrays: list[Any]) -> list[Any]:
            left = iter(arrays)
            leaves = [next(left) if isinstance(kind, _Kind) else kind for kind in kinds]
            args, options = jax.tree.unflatten(structure, leaves)
            found = self._function(*args, **options)
            leaves, form = jax.tree.flatten(found)
            places = [k for k, leaf in enumerate(leaves) if self._is_array(leaf)]
            numbered = [_Number(places.index(k)) if k in places else leaf for k, leaf in enumerate(leaves)]
            results.append(jax.tree.unflatten(form, numbered))
            return [leaves[k] for k in places]

        # Under a name of its own, JAX's cache does not have it: a program read from there cannot be written again.
        of_arrays.__name__ = f"{self._function.__name__}_{uuid.uuid4().hex[:8]}"
        lowered = jax.jit(of_arrays).lower(arrays)
        _forget_names(lowered)
        with _no_second_copy():
            program = lowered.compile(compiler_options=self._options_of())
        return Program(program, results[-1], "lapack" in lowered.as_text())

    def _name(self, described: Any) -> str | None:
        """File name of the program of these arguments; None if they hold what no other process can know."""
        function = self._function
        file = io.BytesIO()
        try:
            pickler = _Describing(file)
            pickler.fast = True  # by value: the same for equal arguments, however they share their parts
            pickler.dump((_described(function), described, sorted(self._options_of().items()), str(_settings())))
        except (pickle.PicklingError, TypeError, AttributeError, ValueError, RecursionError):
            return None
        return f"program-{hashlib.sha256(_environment().encode() + file.getvalue()).hexdigest()}"


def _no_second_copy() -> contextlib.AbstractContextManager[Any]:
    """A setting by which JAX's own cache does not keep what is compiled."""
    with contextlib.suppress(ImportError):  # of no stable interface
        from jax._src.config import persistent_cache_min_compile_time_secs

        return persistent_cache_min_compile_time_secs(FOR_EVER)
    return contextlib.nullcontext()


def _forget_names(lowered: jax.stages.Lowered) -> None:
    """Drop the names of operations, a fifth of a program's size and of the time to load it."""
    with contextlib.suppress(Exception):  # of no stable interface, and of no effect on results
        from jax._src.lib.mlir import passmanager  # pyright: ignore

        module: Any = lowered._lowering._hlo  # pyright: ignore
        with module.context:
            passmanager.PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)


def _described(function: Any) -> tuple[Any, ...]:
    """A function by its code's name and place, and by the values it is closed over: a derivative of a function has the
    function's own name. The code itself counts by versions. Raises `AttributeError` for what has no code."""
    if not isinstance(function, types.FunctionType):
        return _described(function.__wrapped__)
    code = function.__code__
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    values = [_described(value) if isinstance(value, types.FunctionType) else value for value in cells]
    return function.__module__, function.__globals__["__name__"], code.co_qualname, code.co_firstlineno, values


def is_debugging() -> bool:
    """Whether JAX is asked to find NaN or infinities, or to compile nothing: programs compiled ahead do not."""
    names = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit")
    return any(getattr(jax.config, name) for name in names)


class _Kind(NamedTuple):
    """What a program depends on of an array."""

    shape: tuple[int, ...]
    dtype: str
    is_weak: bool

    @classmethod
    def of(cls, array: Any) -> _Kind:
        array = array.aval if isinstance(array, jax.Array) else jax.typeof(array)
        return cls(tuple(array.shape), str(array.dtype), bool(array.weak_type))


class _Number:
    """Place of an array among the results of a program."""

    def __init__(self, number: int) -> None:
        self.number = number


class _Describing(pickle.Pickler):
    """Pickles classes and functions of known packages only, whose code is part of the key by their versions."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, jax.Device):
            return str, (f"{obj.platform} {obj.id}",)
        if isinstance(obj, types.ModuleType):
            return str, (obj.__name__,)
        if isinstance(obj, type | types.FunctionType | types.BuiltinFunctionType | types.MethodType):
            package = (getattr(obj, "__module__", None) or "builtins").partition(".")[0]
            if package not in ("jaxgeo", *KNOWN_PACKAGES, *STANDARD):
                raise pickle.PicklingError(f"{obj} is not of a known package")
        return NotImplemented


def _is_on_first_device(array: Any) -> bool:
    if not isinstance(array, jax.Array):
        return True
    return array.is_fully_addressable and array.devices() == {jax.devices()[0]}


def _settings() -> tuple[Any, ...]:
    """Settings of JAX that a program depends on and that may hold for a part of a process only."""
    return tuple(getattr(jax.config, name) for name in SETTINGS)


def _environment() -> str:
    """Versions, code of this package, compiler flags, settings, device and native search that programs depend on."""
    settings = [
        f"{name} {value}"
        for name, value in sorted(jax.config.values.items())
        if not any(word in name for word in WITHOUT_EFFECT)
    ]
    native = identity() if is_native() else None
    return "\n".join([*_versions(), *settings, os.environ.get("XLA_FLAGS", ""), f"native search {native}"])


@functools.cache
def _versions() -> list[str]:
    import importlib.metadata

    versions = [f"{package} {importlib.metadata.version(package)}" for package in KNOWN_PACKAGES]
    root = pathlib.Path(__file__).parent
    stats = [(path.relative_to(root).as_posix(), path.stat()) for path in sorted(root.rglob("*.py"))]
    code = [f"{path} {stat.st_size} {stat.st_mtime_ns}" for path, stat in stats]
    device = jax.devices()[0]
    machine = [device.client.platform_version, device.device_kind, str(jax.device_count()), sys.version]
    return [*versions, *code, *machine]


def _read(path: pathlib.Path) -> Program | None:
    """The program of a file; None if there is none, or none that can be read."""
    from jax.experimental import serialize_executable

    try:
        content, arguments, arrays, *of_program = pickle.loads(zlib.decompress(path.read_bytes()))
        forms = jax.tree.structure((([0] * arguments,), {})), jax.tree.structure([0] * arrays)
        first = [jax.devices()[0]]
        program = Program(
            serialize_executable.deserialize_and_load(content, *forms, execution_devices=first), *of_program
        )
    except Exception:  # no file, or whatever a file of another make may cause: the program is compiled
        return None
    if program.has_lapack:
        _load_lapack()
    return program


@functools.cache
def _load_lapack() -> None:
    """Make LAPACK known to programs, which JAX does only when it lowers one that calls it."""
    jax.jit(jnp.linalg.cholesky).lower(np.eye(1))


@contextlib.contextmanager
def _alone(path: pathlib.Path) -> Iterator[None]:
    """While in use, other processes of this machine wait before they compile the same program. The lock of a process
    that ends, however it ends, is free; without locks, on other systems, each compiles."""
    if fcntl is None:
        yield
        return
    lock = path.with_suffix(".lock")
    try:
        file = lock.open("w")
        fcntl.flock(file, fcntl.LOCK_EX)
    except OSError:  # a folder that may not be written, or a file system without locks
        yield
        return
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)  # a process that waits for it looks for the program first
        file.close()


def _write(path: pathlib.Path, program: Program) -> None:
    """Write the program, whole or not at all; one that cannot be written is not kept."""
    from jax.experimental import serialize_executable

    with contextlib.suppress(Exception):  # it holds a callback to Python, or the disk is full
        content, arguments, arrays = serialize_executable.serialize(program.run)
        written = pickle.dumps((content, arguments.num_leaves, arrays.num_leaves, program.results, program.has_lapack))
        with tempfile.TemporaryDirectory(dir=path.parent, prefix="partial-") as folder:
            file = pathlib.Path(folder) / "program"
            file.write_bytes(zlib.compress(written, 1))
            os.replace(file, path)
