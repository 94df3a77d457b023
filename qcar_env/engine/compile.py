"""What compiled code is made with.

The functions of parts, roads, cars, laws and rewards are compiled as they stand; no equation is
written a second time. A kernel closes over them, so what a car is made of is resolved when it is
compiled, and costs nothing when it runs.

Cars lie in blocks of `LANES`. A block is one flat row of memory, a slab: number `row` of car `lane`
stands at ``row * LANES + lane``. With constant distances between rows, cars innermost and no branch
on a car, the compiler turns the loop over cars into vector instructions. Which row is which comes
from the named tuples themselves (`qcar_env.engine.layout`).

No fast-math: a car gets the same bits alone and among others, and as in plain Python. Closed loops
can be asked for with fused multiply-adds (`kernel(fused=True)`).
"""

# pyright: basic, reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# numba has no types for what it compiles.

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import secrets
import sys
from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import config
from numba.core.bytecode import FunctionIdentity
from numba.core.errors import NumbaError
from numba.extending import intrinsic, overload, register_jitable

LANES = 64  # cars in a block: its rows fit the first-level cache of 32 KB
INLINE = {"forceinline": True}  # without it loops over cars are not vectorised

# numba names a compiled function after its source and a number, counted from 1 in each process; the
# linker takes two of one name for the same. Functions of two cars, compiled by two processes and
# loaded by a third from the cache on disk, would all be the first car's. Counting from elsewhere in
# each process keeps them apart (tests/engine/test_compile.py).
FunctionIdentity._unique_ids = itertools.count(secrets.randbits(62))


_REGISTERED: set[Any] = set()  # functions that compiled code can call


def has_form(function: Any) -> Any:
    """Let compiled code take another form of `function`: what is decorated makes it from types."""
    _REGISTERED.add(function)
    return overload(function, jit_options=INLINE, strict=False)


def compiled(function: Any) -> Any:
    """Let compiled code call `function`, which stays plain Python, and becomes part of its callers.

    So do the plain functions that it calls by name.
    """
    return _registered(function, INLINE)


def compiled_apart(function: Any = None, *, allocates: bool = True) -> Any:
    """Do the same for a function that is called for few cars at a time, to compile it once.

    One that does not make arrays, but for views of others, need not count who uses them.
    """
    if function is None:
        return lambda each: compiled_apart(each, allocates=allocates)
    return _registered(function, {} if allocates else {"_nrt": False})


def _registered(function: Any, options: dict[str, Any]) -> Any:
    if function in _REGISTERED:
        return function
    _REGISTERED.add(function)
    (register_jitable(**options) if options else register_jitable)(function)
    code, names = function.__code__, function.__globals__
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    called = [names.get(name) for name in code.co_names]
    for _, cell in cells:
        try:
            called.append(cell.cell_contents)
        except ValueError:  # not assigned yet
            continue
    for each in called:
        if isinstance(each, FunctionType):
            _registered(each, INLINE)
    return function


def kernel(
    function: Any = None, *, fused: bool = False, nogil: bool = True, allocates: bool = True
) -> Any:
    """Compile `function` for calls from Python, cached on disk.

    Parameters
    ----------
    fused : bool
        Whether the processor may multiply and add in one operation, rounding once: faster, and
        equal to plain Python to rounding only.
    nogil : bool
        Whether it lets go of the interpreter's lock, which takes longer than a step of one car.
    allocates : bool
        Whether it makes arrays, other than views of those that it is given. One that does not need
        not count who uses them, and a call takes less than half the time.

    Raises
    ------
    RuntimeError
        If numba is told to compile nothing.

    Notes
    -----
    Where nothing can be written, it is compiled anew in each process; so is what lies damaged on
    disk, or was left there by another version.
    """
    if function is None:
        return lambda each: kernel(each, fused=fused, nogil=nogil, allocates=allocates)
    if config.DISABLE_JIT:
        raise RuntimeError("the engine is compiled code, but NUMBA_DISABLE_JIT is set; unset it")
    made: Any = numba.njit(
        nogil=nogil,
        boundscheck=False,
        error_model="numpy",
        fastmath={"contract"} if fused else False,
        **({} if allocates else {"_nrt": False}),
    )(function)
    with contextlib.suppress(RuntimeError):  # there is no folder that it may write to
        made.enable_caching()
        made._cache = _Forgiving(made._cache)
    return made


class _Forgiving:
    """numba's cache on disk, but what cannot be read or written is as if it were not there."""

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what is stored, or None."""
        try:
            return self._cache.load_overload(signature, context)
        except Exception:  # whatever reading a damaged file raises
            with contextlib.suppress(OSError):
                self._cache.flush()
            return None

    def save_overload(self, signature: Any, made: Any) -> None:
        """Store what has been compiled, where the disk takes it."""
        with contextlib.suppress(OSError):
            self._cache.save_overload(signature, made)


def source_stamp(*functions: Callable[..., Any]) -> str:
    """Return a hash of every source file that enters compiled code with `functions`.

    numba's cache on disk looks at the file that holds a kernel and at nothing else: it would go on
    using the machine code of a law that has been edited since. Kernels close over this stamp, so
    that it becomes part of the cache's key. The files are those of the modules of `functions` and
    of whatever modules of the same packages they refer to, and so on; likewise those of the
    functions that they close over, such as a car's over its parts'.
    """
    todo = [module for function in functions for module in _modules(function)] + [__name__]
    found: set[str] = set()
    while todo:
        name = todo.pop()
        if name in found or name not in sys.modules:
            continue
        found.add(name)
        package = name.partition(".")[0]
        for value in vars(sys.modules[name]).values():
            other = value.__name__ if isinstance(value, ModuleType) else None
            other = other or getattr(value, "__module__", None)
            if isinstance(other, str) and other.partition(".")[0] == package:
                todo.append(other)
    stamp = hashlib.sha256()
    for name in sorted(found):
        path = getattr(sys.modules[name], "__file__", None)
        if path is not None and os.path.exists(path):
            with open(path, "rb") as file:
                stamp.update(file.read())
    return stamp.hexdigest()


def _modules(function: Any) -> list[str]:
    """Return the modules of a function and of the functions that it closes over."""
    found = [function.__module__]
    for cell in getattr(function, "__closure__", None) or ():
        if isinstance(cell.cell_contents, FunctionType):
            found += _modules(cell.cell_contents)
    return found


def together(functions: tuple[Any, ...], *, each_its_own: bool = False) -> Any:
    """Return one function that gives the results of all `functions` as a tuple.

    Parameters
    ----------
    functions : tuple of callable
        Called with the same arguments ``(m, p)``.
    each_its_own : bool
        Called with one entry each of three tuples ``(now, before, p)`` instead.
    """
    names = {f"f{i}": compiled(each) for i, each in enumerate(functions)}
    if each_its_own:
        calls = "".join(f"f{i}(now[{i}], before[{i}], p[{i}]), " for i in range(len(functions)))
        return _made(f"def together(now, before, p):\n    return ({calls})", names)
    calls = "".join(f"{name}(m, p), " for name in names)
    return _made(f"def together(m, p):\n    return ({calls})", names)


def each_by_its_own(functions: tuple[Any, ...]) -> Any:
    """Return ``f(values, *others)``: each function of its own entry of `values`, as a tuple."""
    names = {f"f{i}": compiled(each) for i, each in enumerate(functions)}
    others = "z, row, stride, j, noise, elapsed, dt, p, begin"
    calls = "".join(f"f{i}(values[{i}], {others}), " for i in range(len(functions)))
    return _made(f"def each(values, {others}):\n    return ({calls})", names)


def _made(source: str, names: dict[str, Any]) -> Any:
    """Return the one function that `source` defines, in which `names` mean what they are given."""
    found: dict[str, Any] = {**names, "__name__": __name__}
    exec(source, found)
    return compiled(found[source.split("(")[0].removeprefix("def ")])


# Hints to the compiler ---------------------------------------------------------------------------


def _hint(function: Any) -> Any:
    """Make an intrinsic that has the same name in each process.

    numba's is drawn at random and part of the cache's key: nothing stored would be found again.
    """
    made: Any = intrinsic(function)
    made._set_uuid(f"{__name__}.{function.__name__}")
    return made


def _align_stack(typingctx: Any) -> Any:
    """Let a kernel's own memory begin on a boundary of 64 bytes.

    Vectors that do not fit the registers are kept there. Unless told, the compiler leaves them
    where the caller's memory ends, in two cache lines each: a kernel then takes half as long again.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            place = builder.alloca(ir.ArrayType(ir.IntType(8), 64))
        place.align = 64
        taken = ir.FunctionType(ir.VoidType(), [place.type])
        builder.asm(taken, "", "r", [place], True)  # no instruction, but a use of the place
        return context.get_dummy_value()

    return types.void(), codegen


align_stack = _hint(_align_stack)


def _widen(typingctx: Any) -> Any:
    """Let the loops of a function use the widest vectors that the processor has.

    LLVM holds processors with vectors of 512 bits to 256, as the first of them slowed down.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        set.add(
            builder.function.attributes, '"prefer-vector-width"="512"'
        )  # llvmlite knows no such
        return context.get_dummy_value()

    return types.void(), codegen


widen = _hint(_widen)


def _disjoint(typingctx: Any) -> Any:
    """Promise that no array which a function writes to overlaps another one that it is given.

    Without it a loop that looks up a table and writes elsewhere takes one car at a time.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        for each in builder.function.args[1:]:  # the first is where the result goes
            if isinstance(each.type, ir.PointerType):
                each.add_attribute("noalias")
        return context.get_dummy_value()

    return types.void(), codegen


disjoint = _hint(_disjoint)


def aligned(shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """Return zeros that begin on a boundary of 64 bytes: a vector then lies in one cache line."""
    kind = np.dtype(dtype)
    size = int(np.prod(shape)) * kind.itemsize
    raw = np.zeros(size + 64, np.uint8)
    skip = -raw.ctypes.data % 64
    return raw[skip : skip + size].view(kind).reshape(shape)


def entry(function: Any, *examples: Any) -> Any:
    """Compile a kernel for arguments like `examples`; return what takes them without looking."""
    return function.compile(tuple(numba.typeof(each) for each in examples))


def compiles(function: Any, *examples: Any) -> str:
    """Return why `function` does not compile for arguments like `examples`; empty if it does."""
    try:
        numba.njit(function).compile(tuple(numba.typeof(each) for each in examples))
    except NumbaError as error:
        return str(error)
    return ""
