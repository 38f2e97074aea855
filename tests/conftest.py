"""Shared by all tests. Imports no JAX: the process that only hands tests to its workers needs none."""

import gc
import os
import sys
from pathlib import Path

import pytest
import xdist

# Compiling takes a third of the time, and running longer than in the programs that users have, and -m slow.
QUICK_TO_COMPILE = (
    "--xla_backend_optimization_level=0",
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_cpu_parallel_codegen_split_count=1",
)


def pytest_configure(config):
    """Most of the suite's time is compiling what then runs for milliseconds.

    What was compiled is kept for the next time, by versions and flags. All of this is read when JAX is imported, by
    workers and commands that are run as processes, too.
    """
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "assistax-tests"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(caches))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    if sys.dont_write_bytecode:  # then each of a dozen processes would compile the packages' sources: here they may
        sys.dont_write_bytecode = False
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = str(caches / "bytecode")
    if config.option.markexpr == "not slow":
        given = os.environ.get("XLA_FLAGS", "").split()  # by whoever started this worker, for example
        os.environ["XLA_FLAGS"] = " ".join(given + [flag for flag in QUICK_TO_COMPILE if flag not in given])


def pytest_sessionstart(session):
    if xdist.is_xdist_controller(session):
        return
    gc.set_threshold(100_000, 20, 50)  # tracing makes much that is no garbage


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Tests that share a fixture of their file run on one worker, for it is costly; others wherever there is time."""
    for item in items:
        defs = item._fixtureinfo.name2fixturedefs.values()
        if any(found[-1].scope == "module" for found in defs) and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


@pytest.fixture(scope="session")
def scratch():
    """The scratch environment on the C engine, with episodes of 20 steps."""
    import assistax

    return assistax.make("scratch-v0", engine="mujoco", episode_length=20)


@pytest.fixture(scope="module")
def registries():
    """What is registered here is gone afterwards."""
    from assistax.learning.algorithms import ALGORITHMS
    from assistax.scenes import ROBOTS
    from assistax.tasks import TASKS

    with pytest.MonkeyPatch.context() as patch:
        for registry in (TASKS, ALGORITHMS, ROBOTS):
            patch.setattr(registry, "_things", dict(registry._things))
        yield


def random_actions(env, key, batch=()):
    import jax

    return {a: jax.random.uniform(key, (*batch, n), minval=-1, maxval=1) for a, n in env.action_sizes.items()}
