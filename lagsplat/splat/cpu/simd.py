# mypy: ignore-errors
"""Eight or sixteen float32 side by side, as one value inside Numba functions.

Whether LLVM vectorises a loop depends on alias checks, trip counts and cost tables, and a rasteriser must
not become six times slower when one of them changes. So the width is explicit: sixteen with AVX-512, which
makes of two rows of eight pixels one operation, and eight elsewhere. ``Lanes`` support arithmetic,
``<``, ``<=`` and ``>`` with each other and with scalars (rounded to float32), a comparison gives a ``Mask``
that supports ``&``, and the functions below do the rest. Processors with narrower registers split the
operations themselves.

Only Numba functions can call these, not the interpreter.

`compiled` compiles the kernels and decides when a compiled kernel on disk is still valid.
"""

import operator
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.extending import intrinsic, models, overload, register_model

# Pixels side by side in one row that are drawn at once. Wider registers take those of a second row as well.
RUN = 8
WIDTH = 2 * RUN if "+avx512vl" in cpu_target.target_context.codegen().magic_tuple()[2] else RUN
_FLOATS = ir.VectorType(ir.FloatType(), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)
# Allow fused multiply-add, but nothing that assumes finite numbers.
_FLAGS = ("contract", "nsz", "arcp")


class LanesType(types.Type):
    """Numba type of ``WIDTH`` float32."""


class MaskType(types.Type):
    """Numba type of ``WIDTH`` truth values."""


lanes_t = LanesType("Lanes")
mask_t = MaskType("Mask")


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _FLOATS)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _BITS)


@intrinsic
def splat(typing, value):
    """Lanes that all hold the scalar ``value``."""

    def build(context, builder, signature, arguments):
        scalar = context.cast(builder, arguments[0], signature.args[0], types.float32)
        undefined, first = ir.Constant(_FLOATS, ir.Undefined), ir.Constant(ir.IntType(32), 0)
        vector = builder.insert_element(undefined, scalar, first)
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
        return builder.shuffle_vector(vector, undefined, zeros)

    return lanes_t(value), build


def _address(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [index]), _FLOATS.as_pointer())


@intrinsic
def load(typing, array, index):
    """The ``WIDTH`` values of a contiguous float32 array from ``index`` on; bounds are not checked."""

    def build(context, builder, signature, arguments):
        pointer = _address(context, builder, signature.args[0], *arguments)
        return builder.load(pointer, align=4)

    return lanes_t(array, types.intp), build


@intrinsic
def store(typing, array, index, value):
    """Write ``WIDTH`` values to a contiguous float32 array from ``index`` on; bounds are not checked."""

    def build(context, builder, signature, arguments):
        pointer = _address(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes_t), build


@intrinsic
def store_integers(typing, array, index, value):
    """Write the integer parts of ``WIDTH`` values to a contiguous int32 array from ``index`` on."""

    def build(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, value=arguments[0]).data
        integers = builder.fptosi(arguments[2], ir.VectorType(ir.IntType(32), WIDTH))
        pointer = builder.bitcast(builder.gep(data, [arguments[1]]), integers.type.as_pointer())
        builder.store(integers, pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes_t), build


_RUN = ir.VectorType(ir.FloatType(), RUN)


def _shuffle(builder, left, right, lanes):
    return builder.shuffle_vector(left, right, ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes))


@intrinsic
def ramp(typing):
    """The number of each lane in its run: 0, 1, ..., ``RUN`` - 1, 0, 1, ..."""

    def build(context, builder, signature, arguments):
        return ir.Constant(_FLOATS, [float(lane % RUN) for lane in range(WIDTH)])

    return lanes_t(), build


@intrinsic
def splat_runs(typing, first, second):
    """Lanes that hold ``first`` in the first run and ``second`` in another, if there is one."""

    def build(context, builder, signature, arguments):
        undefined, zero = ir.Constant(_FLOATS, ir.Undefined), ir.Constant(ir.IntType(32), 0)
        values = [builder.insert_element(undefined, value, zero) for value in arguments]
        first, second = (_shuffle(builder, value, undefined, [0] * WIDTH) for value in values)
        return builder.select(ir.Constant(_BITS, [lane < RUN for lane in range(WIDTH)]), first, second)

    return lanes_t(types.float32, types.float32), build


@intrinsic
def load_runs(typing, array, first, second):
    """``RUN`` values of a contiguous float32 array from ``first`` on; if they fit, also from ``second``."""

    def build(context, builder, signature, arguments):
        array, *places = arguments
        data = context.make_array(signature.args[0])(context, builder, value=array).data
        pointers = [builder.bitcast(builder.gep(data, [at]), _RUN.as_pointer()) for at in places]
        if WIDTH == RUN:
            return builder.load(pointers[0], align=4)
        runs = [builder.load(pointer, align=4) for pointer in pointers]
        return _shuffle(builder, *runs, list(range(WIDTH)))

    return lanes_t(array, types.intp, types.intp), build


@intrinsic
def store_runs(typing, array, first, second, value):
    """Write what `load_runs` reads."""

    def build(context, builder, signature, arguments):
        array, *places, value = arguments
        data = context.make_array(signature.args[0])(context, builder, value=array).data
        for start in range(0, WIDTH, RUN):
            pointer = builder.bitcast(builder.gep(data, [places[start // RUN]]), _RUN.as_pointer())
            run = _shuffle(builder, value, value, list(range(start, start + RUN)))
            builder.store(run, pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, lanes_t), build


@intrinsic
def select(typing, mask, yes, no):
    """``yes`` where ``mask`` is true, else ``no``; the value not chosen may be anything, NaN included."""

    def build(context, builder, signature, arguments):
        return builder.select(*arguments)

    return lanes_t(mask_t, lanes_t, lanes_t), build


def _binary(result, build, operands=lanes_t):
    """The operation on two values of one type that ``build(builder, left, right)`` generates."""

    @intrinsic
    def operation(typing, left, right):
        def generate(context, builder, signature, arguments):
            return build(builder, *arguments)

        return result(operands, operands), generate

    return operation


minimum = _binary(lanes_t, lambda builder, x, y: builder.select(builder.fcmp_ordered("<", x, y), x, y))
"""The smaller of two Lanes, lane by lane."""
maximum = _binary(lanes_t, lambda builder, x, y: builder.select(builder.fcmp_ordered(">", x, y), x, y))
"""The larger of two Lanes, lane by lane; ``right`` where ``left`` is NaN."""


def _function(name):
    @intrinsic
    def operation(typing, value):
        def build(context, builder, signature, arguments):
            kind = ir.FunctionType(_FLOATS, [_FLOATS])
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{WIDTH}f32")
            return builder.call(function, arguments)

        return lanes_t(lanes_t), build

    return operation


square_root = _function("sqrt")
floor = _function("floor")


@intrinsic
def to_bits(typing, mask):
    """The mask as an integer: bit i is set if lane i is true."""

    def build(context, builder, signature, arguments):
        word = builder.bitcast(arguments[0], ir.IntType(WIDTH))
        return builder.zext(word, ir.IntType(64))

    return types.int64(mask_t), build


def _zeros(name, docstring):
    @intrinsic
    def operation(typing, word):
        def build(context, builder, signature, arguments):
            return getattr(builder, name)(arguments[0], ir.Constant(ir.IntType(1), 0))

        return types.int64(types.int64), build

    operation.__doc__ = docstring
    return operation


trailing_zeros = _zeros("cttz", "Number of zeros below the lowest bit that is set; of 0, 64.")
leading_zeros = _zeros("ctlz", "Number of zeros above the highest bit that is set, of 64.")


@intrinsic
def largest_lane(typing, value):
    """The largest of the lanes, a float32; NaN is passed over."""

    def build(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.FloatType(), [_FLOATS])
        name = f"llvm.vector.reduce.fmax.v{WIDTH}f32"
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)

    return types.float32(lanes_t), build


@intrinsic
def sum_lanes(typing, value):
    """Sum over the lanes, a float32."""

    def build(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.FloatType(), [ir.FloatType(), _FLOATS])
        name = f"llvm.vector.reduce.fadd.v{WIDTH}f32"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [ir.Constant(ir.FloatType(), 0.0), arguments[0]], fastmath=("reassoc",))

    return types.float32(lanes_t), build


def _fold(builder, left, right, size):
    """Add the halves of each chunk of ``size`` lanes; those of ``left`` and of ``right`` lie side by side."""
    half, starts = size // 2, range(0, WIDTH, size)
    near = [lane + side for start in starts for side in (0, WIDTH) for lane in range(start, start + half)]
    halves = [_shuffle(builder, left, right, [lane + shift for lane in near]) for shift in (0, half)]
    return builder.fadd(*halves)


SUMS_AT_ONCE = 8


@intrinsic
def store_sums(typing, array, index, a, b, c, d, e, f, g, h):
    """Write the sums over the lanes of each of eight Lanes to a contiguous float32 array from ``index`` on.

    Folded together they cost a third of the operations of one after the other.
    """

    def build(context, builder, signature, arguments):
        # Every fold interleaves its operands: in this order the sums end up in order.
        folded, size = [arguments[2 + which] for which in (0, 4, 2, 6, 1, 5, 3, 7)], WIDTH
        while len(folded) > 1:
            pairs = zip(folded[::2], folded[1::2], strict=True)
            folded, size = [_fold(builder, *pair, size) for pair in pairs], size // 2
        sums = _shuffle(builder, folded[0], folded[0], list(range(0, WIDTH, size)))
        for shift in range(1, size):
            sums = builder.fadd(
                sums, _shuffle(builder, folded[0], folded[0], list(range(shift, WIDTH, size)))
            )
        data = context.make_array(signature.args[0])(context, builder, value=arguments[0]).data
        pointer = builder.bitcast(builder.gep(data, [arguments[1]]), sums.type.as_pointer())
        builder.store(sums, pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, *[lanes_t] * 8), build


def _arithmetic(name):
    return _binary(lanes_t, lambda builder, x, y: getattr(builder, name)(x, y, flags=_FLAGS))


def _comparison(symbol):
    return _binary(mask_t, lambda builder, x, y: builder.fcmp_ordered(symbol, x, y))


_both = _binary(mask_t, lambda builder, x, y: builder.and_(x, y), mask_t)


def _overload(function, operation):
    """Make ``function`` on two Lanes, or on Lanes and a float, run ``operation``."""

    def choose(left, right):
        if left is lanes_t and right is lanes_t:
            return lambda left, right: operation(left, right)
        if left is lanes_t and isinstance(right, types.Float):
            return lambda left, right: operation(left, splat(right))
        if isinstance(left, types.Float) and right is lanes_t:
            return lambda left, right: operation(splat(left), right)
        return None

    overload(function)(choose)


_overload(operator.add, _arithmetic("fadd"))
_overload(operator.sub, _arithmetic("fsub"))
_overload(operator.mul, _arithmetic("fmul"))
_overload(operator.truediv, _arithmetic("fdiv"))
_overload(operator.lt, _comparison("<"))
_overload(operator.le, _comparison("<="))
_overload(operator.gt, _comparison(">"))


@overload(operator.and_)
def _mask_and(left, right):
    if left is mask_t and right is mask_t:
        return lambda left, right: _both(left, right)
    return None


OPTIONS = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    # No flag that assumes finite numbers: NaN and infinity occur, and comparisons handle them.
    "fastmath": {"contract", "nsz", "arcp"},
}


def compiled(*, parallel: bool = False, inside: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile with Numba on the first call and cache the result on disk.

    Numba's disk cache checks only the function's own file, so a kernel would keep using an old version of a
    helper from another file. Here any change to a file of this folder, or to the image model that the kernels
    implement, invalidates the cache.

    What is ``inside`` a loop over Gaussians is always inlined: a call passes every field of every array.
    """
    folder = Path(__file__).parent
    sources = sorted([*folder.glob("*.py"), folder.parent / "image_model.py"])
    stamp = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(parallel=parallel, forceinline=inside, **OPTIONS)(function)  # type: ignore[call-overload]
        dispatcher._cache._cache_file._source_stamp = stamp
        return dispatcher

    return decorate
