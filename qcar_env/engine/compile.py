"""What compiled code is made with: the only file that knows numba.

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

# pyright: basic, reportArgumentType=false, reportAttributeAccessIssue=false
# numba has no types for what it compiles.

from __future__ import annotations

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
from numba.core.bytecode import FunctionIdentity
from numba.core.errors import NumbaError
from numba.extending import intrinsic, overload, register_jitable

from qcar_env.parts import part
from qcar_env.physics import tree

LANES = 64  # cars in a block: its rows fit the first-level cache of 32 KB
INLINE = {"forceinline": True}  # without it loops over cars are not vectorised

# numba names a compiled function after its source and a number, counted from 1 in each process; the
# linker takes two of one name for the same. Functions of two cars, compiled by two processes and
# loaded by a third from the cache on disk, would all be the first car's. Counting from elsewhere in
# each process keeps them apart (tests/engine/test_compile.py).
FunctionIdentity._unique_ids = itertools.count(secrets.randbits(62))


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
    """
    if function is None:
        return lambda each: kernel(each, fused=fused, nogil=nogil, allocates=allocates)
    return numba.njit(
        cache=True,
        nogil=nogil,
        boundscheck=False,
        error_model="numpy",
        fastmath={"contract"} if fused else False,
        **({} if allocates else {"_nrt": False}),
    )(function)


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


# Named tuples in compiled code -----------------------------------------------------------------


def _entrywise(kind: Any, leaf: Callable[[str], str]) -> tuple[str, dict[str, Any]]:
    """Return an expression that makes a tuple like `kind` of ``leaf("[i][j]")``, and its names."""
    names: dict[str, Any] = {}

    def build(part: Any, index: str) -> str:
        if not isinstance(part, types.BaseTuple):
            return leaf(index)
        inside = "".join(build(each, f"{index}[{i}]") + ", " for i, each in enumerate(part.types))
        if not isinstance(part, types.BaseNamedTuple):
            return f"({inside})"
        names[name := f"K{len(names)}"] = part.instance_class
        return f"{name}({inside})"

    return build(kind, ""), names


def _implementation(arguments: str, body: str, names: dict[str, Any]) -> Any:
    exec(f"def made({arguments}):\n    return {body}", names)
    return names["made"]


@overload(tree.advance, jit_options=INLINE, strict=False)
def _advance(x: Any, step: Any, rate: Any) -> Any:
    body, names = _entrywise(x, lambda i: f"x{i} + step * rate{i}")
    return _implementation("x, step, rate", body, names)


@overload(tree.add, jit_options=INLINE, strict=False)
def _add(a: Any, b: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"a{i} + b{i}")
    return _implementation("a, b", body, names)


@overload(tree.combine, jit_options=INLINE, strict=False)
def _combine(a: Any, s: Any, b: Any, c: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"a{i} * s + b{i} * c")
    return _implementation("a, s, b, c", body, names)


@overload(tree.times, jit_options=INLINE, strict=False)
def _times(a: Any, b: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"a{i} * b{i}")
    return _implementation("a, b", body, names)


@overload(tree.bounded, jit_options=INLINE, strict=False)
def _bounded(a: Any, limit: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"min(max(a{i}, -limit), limit)")
    return _implementation("a, limit", body, names)


# What parts choose with: a product with a truth value is slow in vectors. These are one instruction
# each and give the same, up to the sign of a zero; the first argument may be no number, and is kept.


@overload(part.least, jit_options=INLINE, strict=False)
def _least(a: Any, b: Any) -> Any:
    return lambda a, b: b if b < a else a


@overload(part.most, jit_options=INLINE, strict=False)
def _most(a: Any, b: Any) -> Any:
    return lambda a, b: b if b > a else a


@overload(part.positive_part, jit_options=INLINE, strict=False)
def _positive_part(value: Any) -> Any:
    zero = (np.float32 if value == types.float32 else np.float64)(0.0)
    return lambda value: zero if zero > value else value


@overload(part.clamp, jit_options=INLINE, strict=False)
def _clamp(value: Any, low: Any, high: Any) -> Any:
    return lambda value, low, high: part.least(part.most(value, low), high)


def negative_sum(costs: Any) -> Any:
    """Return ``-costs[0] - costs[1] - ...``, in this order."""
    total = -costs[0]
    for each in costs[1:]:
        total = total - each
    return total


@overload(negative_sum, jit_options=INLINE, strict=False)
def _negative_sum(costs: Any) -> Any:
    body = "".join(f" - costs[{i}]" for i in range(len(costs))).strip()
    return _implementation("costs", body.replace("- ", "-", 1) or "0.0", {})


def negative(costs: Any) -> Any:
    """Return ``(-costs[0], -costs[1], ...)``."""
    return tuple(-each for each in costs)


@overload(negative, jit_options=INLINE, strict=False)
def _negative(costs: Any) -> Any:
    body, names = _entrywise(costs, lambda i: f"-costs{i}")
    return _implementation("costs", body, names)


def outcome(code: Any, reward: Any, out: Any, late: Any, costs: Any, penalty: Any) -> Any:
    """Return ``(code, reward, out, late, -costs[0], -costs[1], ..., penalty)``."""
    return code, reward, out, late, *(-each for each in costs), penalty


@overload(outcome, jit_options=INLINE, strict=False)
def _outcome(code: Any, reward: Any, out: Any, late: Any, costs: Any, penalty: Any) -> Any:
    terms = "".join(f"-costs[{i}], " for i in range(len(costs)))
    body = f"(code, reward, out, late, {terms}penalty)"
    return _implementation("code, reward, out, late, costs, penalty", body, {})


def load(z: Any, row: int, stride: int, lane: int, like: Any) -> Any:
    """Return the numbers of car `lane` from `row` of slab `z` on, as a tuple of the kind of `like`.

    Parameters
    ----------
    z : ndarray (rows * stride,)
        The slab.
    row, stride, lane : int
        First row, cars in the slab, and the car.
    like : tuple
        A named tuple of numbers or of named tuples; its own numbers do not matter.
    """
    rows = np.asarray(z).reshape(-1, stride)[row:, lane]
    return tree.unflat(like, rows[: len(tree.flat(like))].tolist())


@overload(load, jit_options=INLINE, strict=False)
def _load(z: Any, row: Any, stride: Any, lane: Any, like: Any) -> Any:
    rows = iter(range(10**6))
    body, names = _entrywise(like, lambda _: f"z[(row + {next(rows)}) * stride + lane]")
    return _implementation("z, row, stride, lane, like", body, names)


def load_wide(z: Any, row: int, stride: int, lane: int, like: Any) -> Any:
    """Return the same in double precision, whatever the slab's."""
    return load(z, row, stride, lane, like)


@overload(load_wide, jit_options=INLINE, strict=False)
def _load_wide(z: Any, row: Any, stride: Any, lane: Any, like: Any) -> Any:
    rows = iter(range(10**6))
    entry = lambda _: f"float64(z[(row + {next(rows)}) * stride + lane])"  # noqa: E731
    body, names = _entrywise(like, entry)
    return _implementation("z, row, stride, lane, like", body, {**names, "float64": np.float64})


def save(z: Any, row: int, stride: int, lane: int, values: Any) -> None:
    """Write `values`, a tuple of numbers or of tuples, into the rows from `row` on (see `load`)."""
    flat = tree.flat(values)
    np.asarray(z).reshape(-1, stride)[row : row + len(flat), lane] = flat


@overload(save, jit_options=INLINE, strict=False)
def _save(z: Any, row: Any, stride: Any, lane: Any, values: Any) -> Any:
    places: list[str] = []
    _entrywise(values, lambda i: places.append(i) or "")
    lines = [f"    z[(row + {k}) * stride + lane] = values{i}" for k, i in enumerate(places)]
    names: dict[str, Any] = {}
    exec("def made(z, row, stride, lane, values):\n" + "\n".join(lines or ["    pass"]), names)
    return names["made"]


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


align_stack: Any = intrinsic(_align_stack)


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


widen: Any = intrinsic(_widen)


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


disjoint: Any = intrinsic(_disjoint)


def holds(z: Any, row: int, stride: int, lane: int, values: Any) -> bool:
    """Return whether `save` of the same would change nothing."""
    flat = tree.flat(values)
    rows = np.asarray(z).reshape(-1, stride)[row : row + len(flat), lane]
    return bool(np.all(rows == np.array(flat).astype(rows.dtype)))


@overload(holds, jit_options=INLINE, strict=False)
def _holds(z: Any, row: Any, stride: Any, lane: Any, values: Any) -> Any:
    places: list[str] = []
    _entrywise(values, lambda i: places.append(i) or "")
    each = (f"(z[(row + {k}) * stride + lane] == real(values{i}))" for k, i in enumerate(places))
    names = {"real": np.float32 if z.dtype == types.float32 else np.float64}
    return _implementation("z, row, stride, lane, values", " & ".join(each) or "True", names)


def weighted(z: Any, row: int, stride: int, lane: int, values: Any, like: Any) -> Any:
    """Return a matrix times a vector, as a tuple of the kind of `like`.

    Parameters
    ----------
    z, row, stride, lane
        Where the matrix lies, row by row (see `load`).
    values : tuple
        The vector: a tuple of numbers or of tuples.
    like : tuple
        Has as many numbers as the matrix has rows.
    """
    vector = np.array(tree.flat(values))
    size = len(tree.flat(like)) * len(vector)
    matrix = np.asarray(z).reshape(-1, stride)[row : row + size, lane].reshape(-1, len(vector))
    return tree.unflat(like, (matrix @ vector).tolist())


@overload(weighted, jit_options=INLINE, strict=False)
def _weighted(z: Any, row: Any, stride: Any, lane: Any, values: Any, like: Any) -> Any:
    places: list[str] = []
    _entrywise(values, lambda i: places.append(i) or "")
    rows = iter(range(10**6))

    def entry(_: str) -> str:
        first = next(rows) * len(places)
        terms = (
            f"z[(row + {first + k}) * stride + lane] * values{i}" for k, i in enumerate(places)
        )
        return " + ".join(terms)

    body, names = _entrywise(like, entry)
    return _implementation("z, row, stride, lane, values, like", body, names)


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


# What compiled code has in another form, above.
_REGISTERED: set[Any] = {
    *(part.least, part.most, part.positive_part, part.clamp),
    *(tree.advance, tree.add, tree.combine, tree.times, tree.bounded),
    *(load, load_wide, save, holds, weighted, negative, negative_sum, outcome),
}
