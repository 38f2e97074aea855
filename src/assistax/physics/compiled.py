"""Compiled programs that call back into Python, kept in JAX's compilation cache like all others.

JAX leaves them out, and on the C engine every program of the environment is one of them: each process would compile for
half a minute what the last one has compiled. They can be kept, for a program has only the numbers of its callbacks, and
the functions are given to it when it is loaded. Of processes that start side by side one compiles a program, and the
others wait for it.

Where the cache lies, and whether there is one, is JAX's own setting: `JAX_COMPILATION_CACHE_DIR`, which the `assistax`
command sets, and `JAX_ENABLE_COMPILATION_CACHE=false`.
"""

import inspect
import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import jax
from jax._src import compiler

try:
    import fcntl
except ImportError:  # not on this system: then nobody waits
    fcntl = None

PATIENCE = 300.0  # s, after which a program is compiled here, too, whoever else is at it

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
        def compiled():
            return plainly(backend, computation, devices, options, callbacks, executable_devices, *more)

        key = compiler._get_cache_key(options, backend, computation, devices)
        if key is None:
            return compiled()
        if not callbacks:
            with _alone(key):
                return compiled()  # or loaded
        key, name = f"{key}-calling-back", "with callbacks"  # another key, for who does not know what they need
        with _alone(key):
            found, _ = compiler._cache_read(name, key, options, _WithCallbacks(backend, callbacks), executable_devices)
            if found is None:
                began = time.monotonic()
                found = compiled()
                compiler._cache_write(key, time.monotonic() - began, name, backend, found, ())
            return found

    compiler.compile_or_get_cached = compile_or_load  # ty: ignore[invalid-assignment]


@contextmanager
def _alone(key: str) -> Generator[None, None, None]:
    """While no other process of this machine is at the program of a cache key, or after PATIENCE all the same."""
    chosen = jax.config.values["jax_compilation_cache_dir"]
    folder = Path(chosen or "")
    if fcntl is None or not chosen or not folder.is_dir():
        yield
        return
    # Few files serve all programs, and stay: to remove one that somebody waits for would let two in.
    handle = os.open(folder / f"lock-{sum(key.encode()) % 64}", os.O_RDWR | os.O_CREAT, 0o666)
    try:
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.05)
            except OSError:  # a file system without locks
                break
        yield
    finally:
        os.close(handle)


def _is_known(name: str) -> bool:
    function = getattr(compiler, name, None)
    return function is not None and tuple(inspect.signature(function).parameters)[: len(_KNOWN[name])] == _KNOWN[name]
