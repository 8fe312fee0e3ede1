"""The loop over the substeps of a sample period, to be compiled: wheel forces, and Chipmunk's own step.

Imported to be compiled only (`castor_envs.kernels`). Chipmunk's functions are called by their addresses, which are
given as integers, so that the machine code holds in every process.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable

from castor_envs.physics import tyre
from castor_envs.physics.tyre import wheel_forces

for _name, _law in list(vars(tyre).items()):
    if getattr(_law, "__module__", None) == tyre.__name__:
        register_jitable(_law)


def _call(builder: Any, address: Any, arguments: list[Any]) -> None:
    function = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments])
    builder.call(builder.inttoptr(address, function.as_pointer()), arguments)


@intrinsic
def for_each_body(typingctx: Any, each: Any, space: Any, callback: Any, data: Any) -> Any:
    """Call ``cpSpaceEachBody(space, callback, data)``, all given as integers."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        _call(builder, args[0], [builder.inttoptr(value, pointer) for value in args[1:]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def step_space(typingctx: Any, step: Any, space: Any, dt: Any) -> Any:
    """Call ``cpSpaceStep(space, dt)``, function and space given as integers."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        _call(builder, args[0], [builder.inttoptr(args[1], pointer), args[2]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.float64), codegen


def advance(
    addresses: Any,
    bodies: Any,
    got: Any,
    loads: Any,
    given: Any,
    wheels: Any,
    patches: Any,
    cables: Any,
    climbing: int,
    dt: float,
    substeps: int,
) -> None:
    """Step space and wheels `substeps` times without returning to Python.

    addresses: of the space, cpSpaceStep, cpSpaceEachBody, and of pymunk's batch getter and setter with their data.
    bodies and loads are the batch buffers; got and given hold their fill counts.
    """
    space, step, each = addresses[0], addresses[1], addresses[2]
    getter, getter_data, setter, setter_data = addresses[3], addresses[4], addresses[5], addresses[6]
    for _ in range(substeps):
        got[0] = 0
        for_each_body(each, space, getter, getter_data)  # pyright: ignore[reportCallIssue]
        wheel_forces(bodies, wheels, patches, cables, climbing, dt, loads)
        given[0] = 0
        for_each_body(each, space, setter, setter_data)  # pyright: ignore[reportCallIssue]
        step_space(step, space, dt)  # pyright: ignore[reportCallIssue]
