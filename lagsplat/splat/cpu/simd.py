# mypy: ignore-errors
"""Eight float32 side by side, as one value inside Numba functions.

Whether LLVM vectorises a loop depends on alias checks, trip counts and cost tables, and a rasteriser must
not become six times slower when one of them changes. So the width is explicit. ``Lanes`` support arithmetic,
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
from numba.extending import intrinsic, models, overload, register_model

WIDTH = 8
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


@intrinsic
def iota(typing):
    """Lanes 0, 1, 2, ..."""

    def build(context, builder, signature, arguments):
        return ir.Constant(_FLOATS, [float(lane) for lane in range(WIDTH)])

    return lanes_t(), build


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


@intrinsic
def sum_lanes(typing, value):
    """Sum over the lanes, a float32."""

    def build(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.FloatType(), [ir.FloatType(), _FLOATS])
        name = f"llvm.vector.reduce.fadd.v{WIDTH}f32"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [ir.Constant(ir.FloatType(), 0.0), arguments[0]], fastmath=("reassoc",))

    return types.float32(lanes_t), build


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


def compiled(*, parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile with Numba on the first call and cache the result on disk.

    Numba's disk cache checks only the function's own file, so a kernel would keep using an old version of a
    helper from another file. Here any change to a file of this folder, or to the image model that the kernels
    implement, invalidates the cache.
    """
    folder = Path(__file__).parent
    sources = sorted([*folder.glob("*.py"), folder.parent / "image_model.py"])
    stamp = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(parallel=parallel, **OPTIONS)(function)  # type: ignore[call-overload]
        dispatcher._cache._cache_file._source_stamp = stamp
        return dispatcher

    return decorate
