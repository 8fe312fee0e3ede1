"""Compiles kernels by numba. Nothing imports this but a kernel that no cache holds."""

import importlib
from collections.abc import Iterator
from types import FunctionType
from typing import Any

from llvmlite import ir
from numba import from_dtype, njit, types
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import register_jitable
from numba.np.arrayobj import make_array, populate_array

from castor_envs.kernels import select
from castor_envs.kernels.arguments import Argument
from castor_envs.kernels.lanes import LaneRecord, lanes_of

WORD = ir.IntType(64)


@global_compiler_lock
def machine_code(module: str, name: str, arguments: tuple[Argument, ...]) -> bytes:
    """Return the object file of a function and what it calls, with an entry of the same name.

    The entry takes the address of a block: for each argument a number's bits, or an array's address and shape. It
    returns 0, as a function does that raises nothing.

    Raises RuntimeError for a function that needs numba at run time, and numba's errors for one that it cannot compile.
    """
    signature = types.void(*(_type(argument) for argument in arguments))
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
    function = getattr(importlib.import_module(module), name)
    for called in _called(function):
        register_jitable(called)
    compiled = njit(signature, error_model="numpy", nogil=True, **options)(function)
    result = compiled.overloads[signature.args]
    library = result.library.codegen.create_library(f"entry of {name}")
    library.enable_object_caching()
    library.add_linking_library(result.library)
    library.add_ir_module(_entry(result, name, arguments))
    library.finalize()
    needed = [f.name for f in library._final_module.functions if f.is_declaration and not f.name.startswith("llvm.")]
    foreign = [symbol for symbol in needed if symbol.startswith(("numba", "NRT", "Py", "_Py"))]
    if foreign:
        raise RuntimeError(f"{module}.{name} needs {', '.join(foreign)}, which machine code by itself does not have")
    return library.serialize_using_object_code()[2][0]


def _called(function: FunctionType) -> set[FunctionType]:
    """Return the plain functions that a function calls by their global names, directly or not."""
    found: set[FunctionType] = set()
    waiting = [function]
    while waiting:
        caller = waiting.pop()
        named = (caller.__globals__.get(name) for name in caller.__code__.co_names)
        plain = {value for value in named if isinstance(value, FunctionType)}
        new = {value for value in plain if value.__module__ != select.__name__} - found
        found |= new
        waiting += new
    return found


def _type(argument: Argument) -> types.Type:
    dtype = argument.dtype
    if lanes := lanes_of(dtype):
        return types.Array(lanes, argument.dimensions, "C", aligned=False)
    if any(dtype[name].subdtype for name in dtype.names or ()):
        return types.Array(LaneRecord(dtype), argument.dimensions, "C", aligned=False)
    scalar = from_dtype(dtype)
    return types.Array(scalar, argument.dimensions, "C") if argument.dimensions else scalar


def _entry(result: CompileResult, name: str, arguments: tuple[Argument, ...]) -> ir.Module:
    """Return the code that takes arguments from a block and calls the function."""
    context, descriptor = result.target_context, result.fndesc
    module = context.create_module(f"entry of {name}")
    function_type = context.call_conv.get_function_type(descriptor.restype, descriptor.argtypes)
    callee = ir.Function(module, function_type, descriptor.llvm_func_name)
    entry = ir.Function(module, ir.FunctionType(ir.IntType(32), [WORD.as_pointer()]), name)
    builder = ir.IRBuilder(entry.append_basic_block("entry"))

    def words() -> Iterator[ir.Value]:
        place = 0
        while True:
            yield builder.gep(entry.args[0], [ir.Constant(WORD, place)])
            place += 1

    block, values = words(), []
    for argument, kind in zip(arguments, descriptor.argtypes, strict=True):
        if not argument.dimensions:
            pointer = builder.bitcast(next(block), context.get_value_type(kind).as_pointer())
            values.append(builder.load(pointer))
            continue
        made = make_array(kind)(context, builder)
        data = builder.inttoptr(builder.load(next(block)), made.data.type)
        shape = [builder.load(next(block)) for _ in range(argument.dimensions)]
        stride, strides = ir.Constant(WORD, argument.dtype.itemsize), []
        for extent in reversed(shape):
            strides.insert(0, stride)
            stride = builder.mul(stride, extent)
        populate_array(made, data, shape, strides, ir.Constant(WORD, argument.dtype.itemsize), None)
        values.append(made._getvalue())
    status, _ = context.call_conv.call_function(builder, callee, descriptor.restype, descriptor.argtypes, values)
    builder.ret(status.code)
    return module
