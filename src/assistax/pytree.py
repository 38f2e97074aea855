"""Frozen dataclasses that JAX sees as pytrees."""

import dataclasses
from typing import TypeVar, dataclass_transform

import jax

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def pytree(cls: type[T]) -> type[T]:
    """Class decorator: a frozen dataclass whose fields are all children of the pytree."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True)(cls))
