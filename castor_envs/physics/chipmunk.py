"""Chipmunk's functions as numba can call them: by address, so that compiled code can be cached.

pymunk's batch callbacks move positions and forces of all bodies between Chipmunk and two arrays; only
pointers and doubles cross the border.
"""

from typing import Any

import numpy as np
import pymunk
import pymunk.batch
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib
from pymunk.batch import BodyFields

MOTION = BodyFields.POSITION | BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
LOADS = BodyFields.FORCE | BodyFields.TORQUE


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


class BodyLink:
    """Reads and loads all bodies of a space through two arrays that live as long as this object.

    motion (b, 6): x, y, angle, v_x, v_y, angular velocity, in the order in which bodies were added. loads (b, 3):
    force x, y and torque for the next step. `addresses`, `got` and `given` are what the compiled loop needs.
    """

    def __init__(self, space: pymunk.Space, bodies: list[pymunk.Body]) -> None:
        self._space = space
        self._reader, self._writer = pymunk.batch.Buffer(), pymunk.batch.Buffer()
        # Chipmunk owns and sizes the array it fills: a user's array of the exact size makes it reallocate
        # foreign memory.
        pymunk.batch.get_space_bodies(space, MOTION, self._reader)
        self.motion = self._view(self._reader, len(bodies), 6)
        self.loads: NDArray[np.float64] = np.zeros((len(bodies), 3))
        self._writer.set_float_buf(self.loads)
        self._check_order(bodies)

        self._reading, self._writing = ffi.new("pmBatchedData *"), ffi.new("pmBatchedData *")
        for data, buffer, fields in (
            (self._reading, self._reader, MOTION),
            (self._writing, self._writer, LOADS),
        ):
            data.fields, data.floatArray, data.intArray = fields.value, buffer._float_arr, buffer._int_arr
        self.got, self.given = self._count(self._reader), self._count(self._writer)
        functions = (
            "cpSpaceStep",
            "cpSpaceEachBody",
            "pmSpaceBodyGetIteratorFuncBatched",
            "pmSpaceBodySetIteratorFuncBatched",
        )
        step, each, getter, setter = (self._address(ffi.addressof(lib, name)) for name in functions)
        self.addresses = (
            self._address(space._space),
            step,
            each,
            getter,
            self._address(self._reading),
            setter,
            self._address(self._writing),
        )

    def read(self) -> NDArray[np.float64]:
        """Refresh and return `motion`."""
        self._reader.clear()
        pymunk.batch.get_space_bodies(self._space, MOTION, self._reader)
        return self.motion

    def write(self) -> None:
        """Give `loads` to the bodies for the next step."""
        pymunk.batch.set_space_bodies(self._space, LOADS, self._writer)

    def _check_order(self, bodies: list[pymunk.Body]) -> None:
        ids = pymunk.batch.Buffer()
        pymunk.batch.get_space_bodies(self._space, BodyFields.BODY_ID, ids)
        if list(memoryview(ids.int_buf()).cast("P")) != [body.id for body in bodies]:
            raise RuntimeError("this pymunk lists bodies in another order than they were added")

    @staticmethod
    def _view(buffer: pymunk.batch.Buffer, rows: int, columns: int) -> NDArray[np.float64]:
        return np.frombuffer(buffer.float_buf(), dtype=float).reshape(rows, columns)

    @staticmethod
    def _count(buffer: pymunk.batch.Buffer) -> NDArray[np.int32]:
        header = ffi.buffer(buffer._float_arr, ffi.sizeof(buffer._float_arr[0]))
        return np.frombuffer(header, dtype=np.int32)

    @staticmethod
    def _address(pointer: Any) -> int:
        return int(ffi.cast("intptr_t", pointer))
