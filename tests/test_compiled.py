"""Programs that call back into Python are kept in JAX's cache, and are given the functions of now."""

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


def test_a_program_that_calls_back_is_kept_and_calls_the_functions_of_now(kept):
    for _ in range(2):
        assert called_back() == (3000.0, [(10.0, 3.0), (100.0, 30.0)])
    (program,) = kept.glob("*-calling-back-cache")
    program.write_bytes(b"something else")
    with pytest.warns(UserWarning, match="Error reading persistent compilation cache"):
        called_back()
