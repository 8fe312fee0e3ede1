"""A compiled function of arrays and numbers, called with all its arguments in one block of memory.

A kernel is written in a module of its own, which is imported only to be compiled (`compiler`): a process that finds its
machine code in a cache (`cache`) needs no numba, whose import and first call would cost 0.4 s of CPU time.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from castor_envs.kernels.arguments import Argument, in_lanes
from castor_envs.kernels.cache import cached_code


@dataclass(frozen=True)
class Kernel:
    """The function `name` of a module, compiled on its first use in this process or found in a cache.

    The function returns nothing and allocates nothing: it writes into arrays that it is given. numba
    compiles it and what it calls, `error_model="numpy"`. The interpreter's lock is free while it runs.
    """

    module: str
    name: str
    arguments: tuple[Argument, ...]

    def bind(self, *values: Any) -> Callable[[], None]:
        """Return the function with its arguments, to be called often; arrays are read and written where they are.

        Raises TypeError for an array of another type, number of dimensions or order in memory than declared. A call
        raises RuntimeError where the function raises anything.
        """
        block = np.array([slot for pair in zip(self.arguments, values, strict=True) for slot in _slots(*pair)])
        run, address = self._entry, block.ctypes.data

        def call() -> None:
            if run(address):
                raise RuntimeError(f"kernel {self.name} failed on {len(values)} arguments in {block.nbytes} bytes")

        return call

    def __reduce__(self) -> tuple[Any, ...]:
        return Kernel, (self.module, self.name, self.arguments)  # not the loaded code

    def in_lanes(self, lanes: int) -> "Kernel":
        """Return the same function of lanes, so many: it does for each what it does for one number."""
        arguments = [given._replace(dtype=in_lanes(given.dtype, lanes)) for given in self.arguments]
        return Kernel(self.module, self.name, tuple(arguments))

    @cached_property
    def _entry(self) -> Callable[[int], int]:
        code = cached_code(self.module, repr((self.name, self.arguments)), self._compiled)
        return _loaded(code, self.name)

    def _compiled(self) -> bytes:
        from castor_envs.kernels.compiler import machine_code  # imports numba

        return machine_code(self.module, self.name, self.arguments)


def _slots(argument: Argument, value: Any) -> list[int]:
    """Return what stands in the block for an argument: the bits of a number, or an array's address and shape."""
    if not argument.dimensions:
        return [int(np.array(value, dtype=argument.dtype).view(np.int64))]
    kind, lanes = argument.dtype.subdtype or (argument.dtype, ())
    fits = isinstance(value, np.ndarray) and value.dtype == kind and value.ndim == argument.dimensions + len(lanes)
    if not fits or value.shape[argument.dimensions :] != lanes or not value.flags.c_contiguous:
        raise TypeError(f"expected an array of {argument.dtype}, {argument.dimensions} dimensions, in C's order")
    return [value.ctypes.data, *value.shape[: argument.dimensions]]


_engines: list[llvm.ExecutionEngine] = []
"""Own the code that was loaded."""


def _loaded(code: bytes, name: str) -> Callable[[int], int]:
    """Return the function of an object file."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True, codemodel="jitdefault")
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _engines.append(engine)
    return ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)(engine.get_function_address(name))
