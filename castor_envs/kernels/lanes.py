"""Types for numba: lanes, real numbers side by side in vector registers, and masks, conditions on them.

An operation on lanes is the same IEEE operation on each, so that each is to the last bit what it would be alone. numpy
keeps lanes as a last axis; a compiled function sees each row of it as one number. Only the compiler of kernels imports
this.
"""

# pyright: reportCallIssue=false

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.core.cgutils import get_or_insert_function
from numba.core.datamodel.models import PrimitiveModel, RecordModel
from numba.core.datamodel.registry import register_default
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, overload

from castor_envs.kernels.select import any_of, where


class Lanes(types.Type):
    """So many real numbers."""

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(f"lanes({count})")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """Any single number is the same number in all lanes."""
        return Conversion.safe if isinstance(other, types.Number) else None


class Mask(types.Type):
    """Whether a condition holds, for so many lanes."""

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(f"mask({count})")


class LaneRecord(types.Record):
    """A record whose reals are lanes, and whose integers are those of all lanes."""

    def __init__(self, dtype: np.dtype) -> None:
        self._dtype = dtype
        fields: Any = [
            (name, {"type": lanes_of(field[0]) or from_dtype(field[0]), "offset": field[1]})
            for name, field in (dtype.fields or {}).items()
        ]
        super().__init__(fields, dtype.itemsize, aligned=False)

    @property
    def dtype(self) -> np.dtype:
        """How numpy keeps it."""
        return self._dtype


def lanes_of(dtype: np.dtype) -> Lanes | None:
    """Return the lanes that numpy keeps as this, None for what is single."""
    return None if dtype.subdtype is None else Lanes(*dtype.subdtype[1])


@register_default(Lanes)
class _LanesModel(PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.DoubleType(), kind.count))


@register_default(Mask)
class _MaskModel(PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.IntType(1), kind.count))


register_default(LaneRecord)(RecordModel)


casts: Any = lower_cast(types.Number, Lanes)


@casts
def _same_in_all(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    vector, word = context.get_value_type(wanted), ir.IntType(32)
    number = context.cast(builder, value, given, types.float64)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.Constant(word, 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(word, wanted.count), [0] * wanted.count))


def _declare(function: Any, given: type, result: type, operands: int, emit: Callable[..., Any]) -> None:
    """Let a function of lanes (or masks, as `given` says), or of them and numbers, be what `emit` writes."""

    infers: Any = infer_global(function)

    @infers
    class _Typing(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:
            lanes: Any = next((kind for kind in args if isinstance(kind, given)), None)
            fits = lanes and all(kind == lanes or isinstance(kind, types.Number) for kind in args)
            return signature(result(lanes.count), *[lanes] * operands) if fits and len(args) == operands else None

    lowers: Any = lower_builtin(function, *[given] * operands)

    @lowers
    def _lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *args)


def _intrinsic(name: str) -> Callable[..., Any]:
    def emit(builder: Any, *args: Any) -> Any:
        vector = args[0].type
        kind = ir.FunctionType(vector, [vector] * len(args))
        return builder.call(get_or_insert_function(builder.module, kind, f"llvm.{name}.v{vector.count}f64"), args)

    return emit


def _comparison(sign: str) -> Callable[..., Any]:
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


for _name, _emit in {"add": ir.IRBuilder.fadd, "sub": ir.IRBuilder.fsub, "mul": ir.IRBuilder.fmul}.items():
    _declare(getattr(operator, _name), Lanes, Lanes, 2, _emit)
    _declare(getattr(operator, f"i{_name}"), Lanes, Lanes, 2, _emit)
_declare(operator.truediv, Lanes, Lanes, 2, ir.IRBuilder.fdiv)
_declare(operator.neg, Lanes, Lanes, 1, ir.IRBuilder.fneg)
_declare(abs, Lanes, Lanes, 1, _intrinsic("fabs"))
_declare(math.sqrt, Lanes, Lanes, 1, _intrinsic("sqrt"))
_declare(math.copysign, Lanes, Lanes, 2, _intrinsic("copysign"))
for _name, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "=="}.items():
    _declare(getattr(operator, _name), Lanes, Mask, 2, _comparison(_sign))
_declare(operator.and_, Mask, Mask, 2, ir.IRBuilder.and_)
_declare(operator.or_, Mask, Mask, 2, ir.IRBuilder.or_)


@intrinsic
def _chosen(typingctx: Any, condition: Any, this: Any, otherwise: Any) -> Any:
    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(*args)

    lanes = Lanes(condition.count)
    return signature(lanes, condition, lanes, lanes), emit


@intrinsic
def _in_any(typingctx: Any, condition: Any) -> Any:
    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = ir.IntType(condition.count)
        return builder.icmp_unsigned("!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0))

    return signature(types.boolean, condition), emit


@overload(where)
def _where(condition, this, otherwise):
    if isinstance(condition, Mask):
        return lambda condition, this, otherwise: _chosen(condition, this, otherwise)
    return lambda condition, this, otherwise: this if condition else otherwise


@overload(any_of)
def _any_of(condition):
    return (lambda condition: _in_any(condition)) if isinstance(condition, Mask) else lambda condition: condition
