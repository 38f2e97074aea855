"""Compiled programs that call back into Python, kept in JAX's compilation cache like all others.

JAX leaves them out, and on the C engine every program of the environment is one of them: each process would compile for
half a minute what the last one has compiled. They can be kept, for a program has only the numbers of its callbacks, and
the functions are given to it when it is loaded. Where the cache lies, and whether there is one, is JAX's own setting:
`JAX_COMPILATION_CACHE_DIR`, which the `assistax` command sets, and `JAX_ENABLE_COMPILATION_CACHE=false`.
"""

import inspect
import time

from jax._src import compiler

# What is called here is not public. In a version of JAX that has changed it, programs are compiled as they always were.
_KNOWN = {
    "compile_or_get_cached": ("backend", "computation", "devices", "compile_options", "host_callbacks"),
    "_get_cache_key": ("options", "backend", "computation", "devices"),
    "_cache_read": ("module_name", "cache_key", "compile_options", "backend", "executable_devices"),
    "_cache_write": ("cache_key", "compile_time_secs", "module_name", "backend", "executable", "host_callbacks"),
}


class _WithCallbacks:
    """A backend that gives these functions to what it loads."""

    def __init__(self, backend, callbacks):
        self._backend, self._callbacks = backend, list(callbacks)

    def __getattr__(self, name):
        return getattr(self._backend, name)

    def deserialize_executable(self, *args):
        return self._backend.deserialize_executable(*args, self._callbacks)


def keep_programs_that_call_back() -> None:
    """From now on, in this process; once more changes nothing, for then the function is ours, of another signature."""
    if not all(map(_is_known, _KNOWN)):
        return
    plainly = compiler.compile_or_get_cached

    def compile_or_load(backend, computation, devices, options, callbacks, executable_devices, *more):
        key = compiler._get_cache_key(options, backend, computation, devices) if callbacks else None
        if key is None:
            return plainly(backend, computation, devices, options, callbacks, executable_devices, *more)
        key, name = f"{key}-calling-back", "with callbacks"  # another key, for who does not know what they need
        found, _ = compiler._cache_read(name, key, options, _WithCallbacks(backend, callbacks), executable_devices)
        if found is None:
            began = time.monotonic()
            found = plainly(backend, computation, devices, options, callbacks, executable_devices, *more)
            compiler._cache_write(key, time.monotonic() - began, name, backend, found, ())
        return found

    compiler.compile_or_get_cached = compile_or_load  # ty: ignore[invalid-assignment]


def _is_known(name: str) -> bool:
    function = getattr(compiler, name, None)
    return function is not None and tuple(inspect.signature(function).parameters)[: len(_KNOWN[name])] == _KNOWN[name]
