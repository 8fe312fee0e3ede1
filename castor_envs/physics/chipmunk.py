"""The bodies of a space as two arrays, and the addresses by which compiled code reaches them.

pymunk's batch callbacks move positions and forces of all bodies between Chipmunk and the arrays; only pointers and
doubles cross the border.
"""

from typing import Any

import numpy as np
import pymunk
import pymunk.batch
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib
from pymunk.batch import BodyFields

MOTION = BodyFields.POSITION | BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
LOADS = BodyFields.FORCE | BodyFields.TORQUE


class BodyLink:
    """Reads and loads all bodies of a space through two arrays that live as long as this object.

    motion (b, 6): x, y, angle, v_x, v_y, angular velocity, in the order in which bodies were added. loads (b, 3):
    force x, y and torque for the next step. `addresses`, `got` and `given` are what the compiled loop needs
    (`castor_envs.physics.compiled_loop`).
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
        places = (space._space, self._reading, self._writing)
        space_at, reading, writing = (self._address(place) for place in places)
        self.addresses = np.array([space_at, step, each, getter, reading, setter, writing])

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
