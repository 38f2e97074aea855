"""Compiled programs that serve others, too: people, frozen partners and all other numbers are their arguments.

`jax.jit` writes arrays that a function closes over into the program. One more person, of whom nothing differs but the
numbers, would then be compiled for as long as the first one was, and so would every other set of frozen partners.
"""

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun


def jit(fn: Callable[..., Any], donate: int | None = None) -> Callable[..., Any]:
    """`jax.jit(fn)`, for positional arguments, with the arrays that `fn` closes over as arguments of the program.

    The program is the same for functions that differ only in the numbers of these arrays, which
    is why JAX's compilation cache has it when the second of them is run, in this process or in another.

    Args:
      fn: a function of pytrees of arrays.
      donate: the argument whose memory the result may use.
    """
    made: dict[Any, tuple[Callable[..., Any], list[jax.Array], Any]] = {}

    def call(*args):
        leaves, structure = jax.tree.flatten(args)
        kind = structure, tuple((x.shape, x.dtype, x.weak_type) for x in map(jax.typeof, leaves))
        if kind not in made:
            made[kind] = _program(fn, donate, args)
        program, numbers, out = made[kind]
        kept = list(args)
        given = kept.pop(donate) if donate is not None else None
        return jax.tree.unflatten(out, program(given, kept, numbers))

    return call


def _program(fn, donate: int | None, args):
    """(what runs, of the donated argument, the others and the numbers; these numbers; the result's structure)."""
    closed, shapes = jax.make_jaxpr(fn, return_shape=True)(*args)

    def program(given, kept, numbers):
        args = list(kept)
        if donate is not None:
            args.insert(donate, given)
        return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, numbers))(*jax.tree.leaves(args))

    program.__name__ = getattr(fn, "__name__", "program")  # what profiles call it
    return jax.jit(program, donate_argnums=0), jax.device_put(closed.consts), jax.tree.structure(shapes)
