"""Environments shared by several accelerators of one machine: each plays its part of them and learns from a part.

What is played is written for one environment, so that every device can do it alone (`by_environment`). What is learned
from a batch is a mean over it, of which every device makes its part (`part_of_batch`), and networks are the same on
all. Outside of `sharing`, and so on one device, nothing here does anything.
"""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import wraps
from typing import Any

import jax
from jax.sharding import AxisType, PartitionSpec, get_abstract_mesh

from assistax.errors import UsageError

_AXIS = "environments"


def check_devices(devices: int, num_envs: int) -> None:
    """Raise UsageError unless there are as many, and they can share `num_envs` environments equally."""
    there = jax.local_device_count()
    if devices > there:
        raise UsageError(f"devices = {devices}, and there are {there} on this machine; take {there} or fewer.")
    if num_envs % devices:
        nearest = max(round(num_envs / devices), 1) * devices
        raise UsageError(f"num_envs = {num_envs} do not divide into devices = {devices}; take --num-envs {nearest}.")


@contextmanager
def sharing(devices: int) -> Generator[None]:
    """Within it, the first so many of this machine's devices share the environments."""
    if devices == 1:
        yield
        return
    mesh = jax.make_mesh((devices,), (_AXIS,), (AxisType.Auto,), devices=jax.local_devices()[:devices])
    with jax.set_mesh(mesh):
        yield


def by_environment(fn: Callable[..., Any], whole: int = 0) -> Callable[..., Any]:
    """`jax.vmap(fn)`, of which every device does the part of its own environments and waits for no other.

    A batch that does not divide into the devices is done by each of them.

    Args:
      fn: of one environment.
      whole: how many of its first arguments are the same for all environments.
    """

    def batched(*args):
        return jax.vmap(fn, [None] * whole + [0] * (len(args) - whole))(*args)

    @wraps(fn)
    def shared(*args):
        mesh = get_abstract_mesh()
        if mesh.empty or jax.tree.leaves(args[whole:])[0].shape[0] % mesh.size:
            return batched(*args)
        specs = tuple(PartitionSpec(*[_AXIS] * (i >= whole)) for i in range(len(args)))
        return jax.shard_map(batched, in_specs=specs, out_specs=PartitionSpec(_AXIS), check_vma=False)(*args)

    return shared


def part_of_batch(tree: Any, axis: int = 0) -> Any:
    """The same arrays, of which every device has a part along `axis`, where they have one that divides."""
    mesh = get_abstract_mesh()
    if mesh.empty:
        return tree

    def part(x):
        divides = x.ndim > axis and x.shape[axis] % mesh.size == 0
        return jax.lax.with_sharding_constraint(x, PartitionSpec(*[None] * axis, _AXIS)) if divides else x

    return jax.tree.map(part, tree)
