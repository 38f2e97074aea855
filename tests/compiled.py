"""Compiled programs that call back into Python, kept from one session of tests to the next.

JAX's persistent cache leaves these out, and on the C engine every program of the environment is one of them. They can
be kept: a program has only the numbers of its callbacks, and the functions are given to it when it is loaded. As a
script this is the `assistax` command with such a cache.
"""

import runpy
import time

from jax._src import compiler


class _WithCallbacks:
    """A backend that gives these functions to what it loads."""

    def __init__(self, backend, callbacks):
        self._backend, self._callbacks = backend, list(callbacks)

    def __getattr__(self, name):
        return getattr(self._backend, name)

    def deserialize_executable(self, *args):
        return self._backend.deserialize_executable(*args, self._callbacks)


def keep_programs_that_call_back() -> None:
    plainly = compiler.compile_or_get_cached

    def compile_or_load(backend, computation, devices, options, callbacks, executable_devices, *more):
        key = compiler._get_cache_key(options, backend, computation, devices) if callbacks else None
        if key is None:
            return plainly(backend, computation, devices, options, callbacks, executable_devices, *more)
        key, name = f"{key}-calling-back", "of a test"  # another key, for who does not know what they need
        found, _ = compiler._cache_read(name, key, options, _WithCallbacks(backend, callbacks), executable_devices)
        if found is None:
            began = time.monotonic()
            found = plainly(backend, computation, devices, options, callbacks, executable_devices, *more)
            compiler._cache_write(key, time.monotonic() - began, name, backend, found, ())
        return found

    compiler.compile_or_get_cached = compile_or_load


if __name__ == "__main__":
    keep_programs_that_call_back()
    runpy.run_module("assistax", run_name="__main__", alter_sys=True)
