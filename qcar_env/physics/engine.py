"""What compiled code is made with: the only file that knows numba.

The kernels stand in `qcar_env.physics.engine_continuous` (a law inside the Runge-Kutta stages) and
`qcar_env.physics.engine_sampled` (forces held over control intervals: the environments). They
compile the functions of this package, and the laws and tasks that are passed to them, as they
stand; no equation is written a second time.

Cars lie in blocks of `LANES`. A block is one flat row of memory, a slab: quantity `row` of car
`lane` stands at ``row * LANES + lane``. With constant distances between quantities, cars innermost
and no branch on a car, the compiler turns the loop over cars into vector instructions. What
happens to few cars at a time (a kink of the road) is done for those cars one by one.

No fast-math: a car gets the same bits as in plain Python, whatever its neighbours.
Closed loops alone can be asked for with fused multiply-adds (`fused_kernel`).
"""

# pyright: basic, reportArgumentType=false
# numba has no types for what it compiles.

from __future__ import annotations

import ctypes
import functools
import hashlib
import math
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import (
    NativeValue,
    box,
    intrinsic,
    models,
    register_jitable,
    register_model,
    unbox,
)
from numpy.typing import NDArray

from qcar_env.physics import closed_loop, dynamics, exact_map, forcing, motion, rk4, roads, state

Array = NDArray[np.float64]

LANES = 64  # cars in a block: a slab of 50 quantities fits the first-level cache of 32 KB
THREADED_WORK = 1_000_000  # [car steps] 10 ms on one core: below, a thread costs what it saves
NEVER = 2**62  # [steps] a step that does not come


# Compiled code --------------------------------------------------------------------------------


def compiled(function: Any) -> Any:
    """Let compiled code call `function`, which stays plain Python; return it.

    It becomes part of each of its callers, without which loops over cars are not vectorised.
    """
    if function not in _COMPILED:
        _COMPILED.add(function)
        register_jitable(forceinline=True)(function)
    return function


def compiled_apart(function: Any) -> Any:
    """Do the same for a function that is called for few cars at a time, to compile it once."""
    if function not in _COMPILED:
        _COMPILED.add(function)
        register_jitable(function)
    return function


_COMPILED: set[Any] = set()

for _each in (
    state.add,
    state.add_filter,
    state.advance,
    state.advance_filter,
    dynamics.accelerations,
    dynamics.rate,
    roads.turn,
    roads.kink_time,
    forcing.amplitudes_of,
    forcing.passage_of,
    forcing.forcing,
    forcing.forcing_in_the_middle,
    forcing.turn_world,
    rk4.rk4_step,
    rk4.step_fractions,
    motion.angle,
    motion.half_step_angles,
    motion.piece_phasor,
    motion.forced_step,
    motion.substep,
    motion.four_substeps,
    exact_map.weighted,
    exact_map.exact_interval,
    closed_loop.saturate,
    closed_loop.controlled_rate,
    closed_loop.unlimited_rate,
    closed_loop.saturated_rate,
    closed_loop.held_rate,
    closed_loop.no_filter,
    closed_loop.add_controlled,
    closed_loop.advance_controlled,
):
    compiled(_each)

for _each in (motion.part, motion.interval):
    compiled_apart(_each)


def source_stamp(*functions: Callable[..., Any]) -> str:
    """Return a hash of every source file that enters compiled code with `functions`.

    numba's cache on disk looks at the file that holds a kernel and at nothing else: it would go
    on using the machine code of a law that has been edited since. Kernels close over this stamp,
    so that it becomes part of the cache's key.

    The files are those of the modules of `functions` and of whatever modules of the same
    packages they refer to, and so on.
    """
    todo = [function.__module__ for function in functions] + [__name__]
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


def kernel(function: Any) -> Any:
    """Compile `function` for calls from Python: cached on disk, free of the interpreter's lock."""
    return numba.njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")(function)


def fused_kernel(function: Any) -> Any:
    """Do the same and let the processor multiply and add in one operation, rounding once.

    It is faster, and equals plain Python no longer to the last bit, but to rounding.
    """
    return numba.njit(
        cache=True, nogil=True, boundscheck=False, error_model="numpy", fastmath={"contract"}
    )(function)


def single_kernel(function: Any) -> Any:
    """Do the same for calls so short that letting go of the lock would slow them."""
    return numba.njit(cache=True, boundscheck=False, error_model="numpy")(function)


def direct(kernel: Any, *examples: Any) -> Any:
    """Return the machine code of a kernel for arguments like `examples`.

    Called through it, a kernel starts in half the time: nothing looks at its arguments. The caller
    must make sure that they have the examples' types, and that arrays are contiguous. For `OBJECT`
    any object serves.
    """
    kinds = (each if isinstance(each, types.Type) else numba.typeof(each) for each in examples)
    return kernel.compile(tuple(kinds))


def _load(typingctx: Any, slab: Any, stride: Any, row: Any, lane: Any, kind: Any) -> Any:
    """Return quantities `row`, `row` + 1, ... of car `lane` as a `kind`, a NamedTuple class."""
    size = len(kind.instance_class._fields)
    made = types.NamedUniTuple(slab.dtype, size, kind.instance_class)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places = _places(context, builder, signature, args, size)
        values = [_apart(builder, builder.load(place), 0) for place in places]
        return context.make_tuple(builder, signature.return_type, values)

    return made(slab, stride, row, lane, kind), codegen


def _store(typingctx: Any, slab: Any, stride: Any, row: Any, lane: Any, values: Any) -> Any:
    """Write a tuple into quantities `row`, `row` + 1, ... of car `lane`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places = _places(context, builder, signature, args, len(values))
        for i, (place, kind) in enumerate(zip(places, values.types, strict=True)):
            value = builder.extract_value(args[4], i)
            _apart(builder, builder.store(context.cast(builder, value, kind, slab.dtype), place), 0)
        return context.get_dummy_value()

    return types.void(slab, stride, row, lane, values), codegen


def _put(typingctx: Any, address: Any, like: Any, index: Any, value: Any, channel: Any) -> Any:
    """Write `value` as number `index` of those of the kind `like` at an address.

    What is written through one of the `CHANNELS` must not lie in a slab, nor be reached through
    another: the compiler relies on it.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = context.get_value_type(types.CPointer(like))
        number = context.cast(builder, args[3], signature.args[3], like)
        if like == types.boolean:
            number = builder.zext(number, ir.IntType(8))
        place = builder.gep(builder.inttoptr(args[0], pointer), [args[2]])
        _apart(builder, builder.store(number, place), channel.literal_value)
        return context.get_dummy_value()

    return types.void(types.int64, like, types.int64, value, channel), codegen


CHANNELS = 9  # ways to memory that do not meet; 0 leads to slabs, the others are those of `put`


def _apart(builder: Any, instruction: Any, channel: int) -> Any:
    """Mark a load or store as one that meets no other channel; return it.

    Without it, the compiler would have to compare the addresses of all rows before each loop over
    cars, and gives up where there are many.
    """
    module = builder.module
    domain = module.add_metadata(["qcar_env"])
    scopes = [module.add_metadata([f"channel {i}", domain]) for i in range(CHANNELS)]
    instruction.set_metadata("alias.scope", module.add_metadata([scopes[channel]]))
    others = [scope for i, scope in enumerate(scopes) if i != channel]
    instruction.set_metadata("noalias", module.add_metadata(others))
    return instruction


def _put_rows(typingctx: Any, slab: Any, stride: Any, lane: Any, address: Any, index: Any) -> Any:
    """Write quantities 0 to 7 of cars `lane` to `lane` + 7, car by car, at an address.

    Parameters as for `load`, in single precision; the first number goes to place `index`.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        vector = ir.VectorType(ir.FloatType(), 8)
        column = builder.gep(array.data, [args[2]])
        rows = []
        for i in range(8):
            place = builder.gep(column, [builder.mul(args[1], args[1].type(i))])
            rows.append(builder.load(builder.bitcast(place, vector.as_pointer()), align=4))

        def mixed(a: Any, b: Any, places: list[int]) -> Any:
            mask = ir.Constant(ir.VectorType(ir.IntType(32), 8), places)
            return builder.shuffle_vector(a, b, mask)

        # distance of the rows that are mixed, and what of both goes into the first and the second
        for distance, low, high in (
            (1, [0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]),
            (2, [0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]),
            (4, [0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15]),
        ):
            for i in range(8):
                if i & distance == 0:
                    a, b = rows[i], rows[i + distance]
                    rows[i], rows[i + distance] = mixed(a, b, low), mixed(a, b, high)
        start = builder.inttoptr(args[3], ir.FloatType().as_pointer())
        for i in range(8):
            place = builder.gep(start, [builder.add(args[4], args[4].type(8 * i))])
            builder.store(rows[i], builder.bitcast(place, vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(slab, types.int64, types.int64, types.int64, types.int64), codegen


def _places(context: Any, builder: Any, signature: Any, args: Any, size: int) -> list[Any]:
    """Return pointers to `size` quantities of a car: address (row + i) * stride + lane, unchecked.

    Written out so that the compiler sees constant distances and no test of an index's sign.
    """
    array = context.make_array(signature.args[0])(context, builder, args[0])
    stride, row, lane = (
        context.cast(builder, args[i], signature.args[i], types.intp) for i in (1, 2, 3)
    )
    column = builder.gep(array.data, [lane])
    found: list[Any] = []
    for i in range(size):
        index = builder.add(row, context.get_constant(types.intp, i))
        found.append(builder.gep(column, [builder.mul(index, stride)]))
    return found


def _load_wide(typingctx: Any, slab: Any, stride: Any, row: Any, lane: Any, kind: Any) -> Any:
    """Return the same in double precision, whatever the slab's."""
    size = len(kind.instance_class._fields)
    made = types.NamedUniTuple(types.float64, size, kind.instance_class)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places = _places(context, builder, signature, args, size)
        values = [
            context.cast(builder, builder.load(place), slab.dtype, types.float64)
            for place in places
        ]
        return context.make_tuple(builder, signature.return_type, values)

    return made(slab, stride, row, lane, kind), codegen


def _prefetch(typingctx: Any, slab: Any, place: Any) -> Any:
    """Ask for the cache line with entry `place` of a slab, which will be needed soon."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        line = builder.gep(array.data, [args[1]])
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        call = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        read, second_level, data = 0, 2, 1
        options = [number(each) for each in (read, second_level, data)]
        builder.call(call, [builder.bitcast(line, byte), *options])
        return context.get_dummy_value()

    return types.void(slab, types.intp), codegen


def _align_stack(typingctx: Any) -> Any:
    """Let the kernel's own memory begin on a boundary of 64 bytes.

    Vectors that do not fit the registers are kept there. Unless told, the compiler leaves them
    where the caller's memory ends, in two cache lines each: a kernel then takes a quarter longer.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            place = builder.alloca(ir.ArrayType(ir.IntType(8), 64))
        place.align = 64
        taken = ir.FunctionType(ir.VoidType(), [place.type])
        builder.asm(taken, "", "r", [place], True)  # no instruction, but a use of the place
        return context.get_dummy_value()

    return types.void(), codegen


def _let_go(typingctx: Any) -> Any:
    """Let go of the interpreter's lock; return what `take_back` needs."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.get_python_api(builder).save_thread()

    return types.voidptr(), codegen


def _take_back(typingctx: Any, thread: Any) -> Any:
    """Wait for the interpreter's lock, and hold it."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        context.get_python_api(builder).restore_thread(args[0])
        return context.get_dummy_value()

    return types.void(thread), codegen


align_stack: Any = intrinsic(_align_stack)
let_go: Any = intrinsic(_let_go)
take_back: Any = intrinsic(_take_back)
prefetch: Any = intrinsic(_prefetch)
load: Any = intrinsic(prefer_literal=True)(_load)
load_wide: Any = intrinsic(prefer_literal=True)(_load_wide)
store: Any = intrinsic(prefer_literal=True)(_store)
put: Any = intrinsic(prefer_literal=True)(_put)
put_rows: Any = intrinsic(_put_rows)


@compiled
def load_passage(slab: Any, stride: Any, row: Any, lane: Any) -> Any:
    """Return quantities `row` to `row` + 7 of car `lane` as a Passage."""
    return forcing.Passage(
        load_world(slab, stride, row, lane),
        load(slab, stride, row + 4, lane, forcing.MiddleAmplitudes),
    )


@compiled
def load_world(slab: Any, stride: Any, row: Any, lane: Any) -> Any:
    """Return quantities `row` to `row` + 3 of car `lane` as a World."""
    return forcing.World(
        load(slab, stride, row, lane, roads.Phasor), load(slab, stride, row + 2, lane, roads.Phasor)
    )


@compiled
def store_world(slab: Any, stride: Any, row: Any, lane: Any, world: Any) -> None:
    """Write a World into quantities `row` to `row` + 3 of car `lane`."""
    store(slab, stride, row, lane, world.road)
    store(slab, stride, row + 2, lane, world.force)


@compiled
def store_passage(slab: Any, stride: Any, row: Any, lane: Any, passage: Any) -> None:
    """Write a Passage into quantities `row` to `row` + 7 of car `lane`."""
    store_world(slab, stride, row, lane, passage.by)
    store(slab, stride, row + 4, lane, passage.middle)


def _array_at(typingctx: Any, address: Any, like: Any) -> Any:
    """Return a pointer to numbers of the kind `like` at an address in memory."""
    pointer = types.CPointer(like.dtype if hasattr(like, "dtype") else like)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

    return pointer(types.int64, like), codegen


pointer_at: Any = intrinsic(_array_at)
carray: Any = numba.carray  # pyright: ignore[reportPrivateImportUsage]


# Python's arrays ------------------------------------------------------------------------------

# A step of one car takes a fifth of a microsecond. To unpack its action and to copy its observation
# would take twice as long. So compiled code looks into the action's array by itself, and has numpy
# make the arrays that it returns. Both need the interpreter's lock.


class PythonObject(types.Type):
    """An object of Python's, as it is."""

    def __init__(self) -> None:
        super().__init__("PythonObject")


OBJECT = PythonObject()
register_model(PythonObject)(models.OpaqueModel)


@box(PythonObject)
def _box_object(kind: Any, value: Any, context: Any) -> Any:
    return value


@unbox(PythonObject)
def _unbox_object(kind: Any, value: Any, context: Any) -> Any:
    return NativeValue(value)


def array_makers() -> tuple[int, int]:
    """Return the addresses of numpy's ``PyArray_New`` and of its array type, for `fresh`."""
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
    interface: Any = getattr(np, "_core", None) or np.core  # numpy 2 or 1
    first = pointer(interface._multiarray_umath._ARRAY_API, None)
    entry = first + _PYARRAY_NEW * ctypes.sizeof(ctypes.c_void_p)
    return ctypes.c_void_p.from_address(entry).value or 0, id(np.ndarray)


_PYARRAY_NEW = 93  # its place in numpy's C interface
_FLOAT32 = np.dtype(np.float32)
_BYTE, _WORD, _INTEGER = ir.IntType(8).as_pointer(), ir.IntType(64), ir.IntType(32)
# An array begins with these, as numpy's C interface says: the head of any object of Python's, which
# ends with its type; data, number of dimensions, shape, strides, base, kind of numbers.
_DATA = object.__basicsize__  # [B]
_TYPE, _DIMENSIONS, _SHAPE, _STRIDES, _KIND = (_DATA + 8 * i for i in (-1, 1, 2, 3, 5))
# And so does a kind of numbers: head, type, three letters, of which the last is the byte order,
# flags, number of the kind.
_ORDER, _NUMBER = _DATA + 10, _DATA + 12


def _entry(builder: Any, start: Any, distance: int, kind: Any) -> Any:
    """Read what lies at `distance` bytes from the pointer `start`."""
    place = builder.gep(start, [_WORD(distance)])
    return builder.load(builder.bitcast(place, kind.as_pointer()))


def _fresh(typingctx: Any, makers: Any, like: Any, shape: Any) -> Any:
    """Return a new array of numbers of the kind `like`; `shape` is a tuple."""
    number = np.dtype(str(like)).num

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        sizes = _WORD.as_pointer()
        # type, dimensions, shape, kind of numbers, strides, data, bytes a number, flags, prototype
        kinds = [_BYTE, _INTEGER, sizes, _INTEGER, sizes, _BYTE, _INTEGER, _INTEGER, _BYTE]
        make = ir.FunctionType(_BYTE, kinds).as_pointer()
        address, array_type = (builder.extract_value(args[0], i) for i in (0, 1))
        counts = _counts(context, builder, args[2], shape)
        places = builder.alloca(_WORD, len(counts))
        for i, count in enumerate(counts):
            builder.store(count, builder.gep(places, [_WORD(i)]))
        none, nothing, zero = _BYTE(None), sizes(None), _INTEGER(0)
        kind, dimensions = _INTEGER(number), _INTEGER(len(counts))
        options = [dimensions, places, kind, nothing, none, zero, zero, none]
        return builder.call(
            builder.inttoptr(address, make), [builder.inttoptr(array_type, _BYTE), *options]
        )

    return OBJECT(makers, like, shape), codegen


def _nothing(typingctx: Any) -> Any:
    """Return None, where an array may stand otherwise."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.get_python_api(builder).make_none()

    return OBJECT(), codegen


def _address_of(typingctx: Any, array: Any) -> Any:
    """Return the address of an array's numbers."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _entry(builder, args[0], _DATA, _WORD)

    return types.int64(array), codegen


def _is_array(typingctx: Any, makers: Any, given: Any, shape: Any) -> Any:
    """Return whether an object is an array of float32 in this shape, row by row."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        counts = _counts(context, builder, args[2], shape)
        result = builder.alloca(ir.IntType(1))
        builder.store(ir.IntType(1)(0), result)

        def equal(start: Any, distance: int, value: Any) -> Any:
            return builder.icmp_signed("==", _entry(builder, start, distance, value.type), value)

        with builder.if_then(equal(args[1], _TYPE, builder.extract_value(args[0], 1))):
            with builder.if_then(equal(args[1], _DIMENSIONS, _INTEGER(len(counts)))):
                sizes, strides, kind = (
                    _entry(builder, args[1], each, _BYTE) for each in (_SHAPE, _STRIDES, _KIND)
                )
                tests = [
                    equal(kind, _NUMBER, _INTEGER(_FLOAT32.num)),
                    equal(kind, _ORDER, ir.IntType(8)(ord(_FLOAT32.byteorder))),
                ]
                stride = _WORD(_FLOAT32.itemsize)
                for i in reversed(range(len(counts))):
                    tests.append(equal(sizes, 8 * i, counts[i]))
                    tests.append(equal(strides, 8 * i, stride))
                    stride = builder.mul(stride, counts[i])
                builder.store(functools.reduce(builder.and_, tests), result)
        return builder.load(result)

    return types.boolean(makers, given, shape), codegen


def _counts(context: Any, builder: Any, values: Any, kinds: Any) -> list[Any]:
    """Return the entries of a shape as 64-bit integers."""
    return [
        context.cast(builder, builder.extract_value(values, i), kind, types.intp)
        for i, kind in enumerate(kinds)
    ]


fresh: Any = intrinsic(_fresh)
nothing: Any = intrinsic(_nothing)
address_of: Any = intrinsic(_address_of)
is_array: Any = intrinsic(_is_array)


def aligned(shape: tuple[int, ...], dtype: Any = np.float64) -> NDArray[Any]:
    """Return zeros that begin on a boundary of 64 bytes: a vector then lies in one cache line."""
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    raw = np.zeros(size + 64, np.uint8)
    skip = -raw.ctypes.data % 64
    return raw[skip : skip + size].view(kind).reshape(shape)


def slabs(rows: Array) -> Array:
    """Lay quantities of cars out for kernels.

    Parameters
    ----------
    rows : ndarray (rows, n)
        One quantity a row.

    Returns
    -------
    ndarray (blocks, rows * LANES)
        The last block is filled up with zeros.
    """
    count, n = rows.shape
    blocks = -(-n // LANES)
    whole = np.zeros((count, blocks * LANES))
    whole[:, :n] = rows
    made = aligned((blocks, count * LANES))
    made.reshape(blocks, count, LANES)[...] = whole.reshape(count, blocks, LANES).transpose(1, 0, 2)
    return made


def from_slabs(blocks: Array, n: int) -> Array:
    """Return the quantities of `n` cars, one a row: the inverse of `slabs`, shape (rows, n)."""
    parts = blocks.reshape(blocks.shape[0], -1, LANES).transpose(1, 0, 2)
    return parts.reshape(parts.shape[0], -1)[:, :n]


def over_blocks(run: Callable[[int, int], None], *, blocks: int, work: int) -> None:
    """Call ``run(begin, end)`` so that it covers all blocks, on threads where they pay.

    Parameters
    ----------
    run : callable
        Runs compiled code that lets go of the interpreter's lock.
    blocks : int
        Number of blocks.
    work : int
        Car steps to be done; threads start at `THREADED_WORK`.
    """
    threads = min(cores(), blocks) if work >= THREADED_WORK else 1
    if threads == 1:
        run(0, blocks)
        return
    edges = [blocks * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, edges[:-1], edges[1:]))


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


PEAK_WIDTH = 512  # numbers that `multiply_add` works on, in the first-level cache
PEAK_LENGTH = 16  # multiply-adds of each number in one pass, unrolled


def multiply_add(repeats: int) -> float:
    """Multiply and add, and do nothing else: the yardstick of the other kernels.

    Parameters
    ----------
    repeats : int
        Passes of ``PEAK_WIDTH * PEAK_LENGTH`` fused multiply-adds in double precision.

    Returns
    -------
    float
        A number that nobody needs, so that the work is not left out.
    """
    return _multiply_add(aligned((PEAK_WIDTH,)), repeats)


@numba.njit(cache=True, nogil=True, boundscheck=False, fastmath={"contract"})
def _multiply_add(x: Any, repeats: Any) -> Any:
    a, b = 0.999999, 1e-6
    for _ in range(repeats):
        for j in range(PEAK_WIDTH):
            y = x[j]
            for _ in range(PEAK_LENGTH):
                y = y * a + b
            x[j] = y
    return x[0]
