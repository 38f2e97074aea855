"""Compiled programs that serve others, too: people, frozen partners and all other numbers are their arguments.

`jax.jit` writes arrays that a function closes over into the program. One more person, of whom nothing differs but the
numbers, would then be compiled for as long as the first one was, and so would every other set of frozen partners.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun


def jit(fn: Callable[..., Any], donate: int | None = None) -> "Programs":
    """`jax.jit(fn)`, for positional arguments, with the arrays that `fn` closes over as arguments of the program.

    The program is the same for functions that differ only in the numbers of these arrays, which
    is why JAX's compilation cache has it when the second of them is run, in this process or in another.

    Args:
      fn: a function of pytrees of arrays.
      donate: the argument whose memory the result may use.
    """
    return Programs(fn, donate)


class Programs:
    """A function, compiled once for each kind of arguments: their structure, shapes and types."""

    def __init__(self, fn: Callable[..., Any], donate: int | None):
        self._fn, self._donate = fn, donate
        self._made: dict[Any, tuple[Any, list[jax.Array], Any]] = {}

    def __call__(self, *args):
        kind = _kind(args)
        if kind not in self._made:
            program, numbers, shapes = _program(self._fn, self._donate, args)
            self._made[kind] = program, numbers, jax.tree.structure(shapes)
        program, numbers, out = self._made[kind]
        if isinstance(program, Future):
            program = program.result()
            self._made[kind] = program, numbers, out
        return jax.tree.unflatten(out, program(*self._parts(args), numbers))

    def ahead(self, *args):
        """Begin to compile, beside this thread, for arguments like these; `jax.ShapeDtypeStruct`s are enough.

        Returns:
          What the function will return, as shapes.
        """
        program, numbers, shapes = _program(self._fn, self._donate, args)
        parts = self._parts(args)
        compiled = _compilers().submit(lambda: program.lower(*parts, numbers).compile())
        self._made[_kind(args)] = compiled, numbers, jax.tree.structure(shapes)
        return shapes

    def _parts(self, args) -> tuple[Any, list[Any]]:
        """The donated argument, and the others."""
        kept = list(args)
        given = kept.pop(self._donate) if self._donate is not None else None
        return given, kept


@cache
def _compilers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="compiling")


def _kind(args):
    leaves, structure = jax.tree.flatten(args)
    return structure, tuple((x.shape, x.dtype, x.weak_type) for x in map(jax.typeof, leaves))


def _program(fn, donate: int | None, args):
    """(what runs, of the donated argument, the others and the numbers; these numbers; the result's shapes)."""
    closed, shapes = jax.make_jaxpr(fn, return_shape=True)(*args)

    def program(given, kept, numbers):
        args = list(kept)
        if donate is not None:
            args.insert(donate, given)
        return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, numbers))(*jax.tree.leaves(args))

    program.__name__ = getattr(fn, "__name__", "program")  # what profiles call it
    return jax.jit(program, donate_argnums=0), jax.device_put(closed.consts), shapes
