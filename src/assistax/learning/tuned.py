"""Settings as inputs of a compiled program instead of constants in it: one program then trains with any of them."""

import dataclasses
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import jax


def tunable(config: Any) -> set[str]:
    """The settings of a trainer that may be inputs: its floats. The others are shapes, counts and switches."""
    return {field.name for field in dataclasses.fields(config) if field.type is float}


def overlaid(config: Any, tuned: Mapping[str, jax.Array]) -> Any:
    """The fields of `config`, with those that are `tuned` in their place.

    Their ranges cannot be checked, as their values are not known at compilation.
    """
    return SimpleNamespace(**vars(config) | tuned)
