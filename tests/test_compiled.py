"""Programs that call back into Python are kept in JAX's cache, and are given the functions of now."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax._src import compilation_cache

from assistax.physics.compiled import keep_programs_that_call_back


def called_back():
    """(what a program gives for 3 that calls back twice, what it called)."""
    calls = []

    def callback(x, factor):
        def on_the_host(x):
            calls.append((factor, float(x)))
            return np.float32(factor * x)

        return jax.pure_callback(on_the_host, jax.ShapeDtypeStruct((), jnp.float32), x)

    return float(jax.jit(lambda x: callback(callback(x, 10.0), 100.0))(jnp.float32(3.0))), calls


@pytest.fixture
def kept(tmp_path):
    """Where JAX keeps programs for now."""
    keep_programs_that_call_back()
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    compilation_cache.reset_cache()
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)
    compilation_cache.reset_cache()


COMPILED_IN_TURN = """
import sys, time, jax, jax.numpy as jnp
from jax._src import compiler
from assistax.physics import compiled
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
backend_compile = compiler.backend_compile_and_load
def slowly(*args, **more):
    print("compiles", flush=True)
    time.sleep(1.0)
    return backend_compile(*args, **more)
compiler.backend_compile_and_load = slowly
compiled.keep_programs_that_call_back()
def f(x):
    return jax.pure_callback(lambda x: x, x, x) if sys.argv[1] == "callback" else jnp.sin(x)
jax.jit(f).lower(jax.ShapeDtypeStruct((), jnp.float32)).compile()
"""


@pytest.mark.parametrize("kind", ["callback", "plain"])
def test_processes_side_by_side_compile_a_program_once(tmp_path, kind):
    surroundings = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILED_IN_TURN, kind]
    both = [subprocess.Popen(command, env=surroundings, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert "".join(said).count("compiles") == 1


def test_a_program_that_calls_back_is_kept_and_calls_the_functions_of_now(kept):
    for _ in range(2):
        assert called_back() == (3000.0, [(10.0, 3.0), (100.0, 30.0)])
    (program,) = kept.glob("*-calling-back-cache")
    program.write_bytes(b"something else")
    with pytest.warns(UserWarning, match="Error reading persistent compilation cache"):
        called_back()
