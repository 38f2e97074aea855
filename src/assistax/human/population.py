"""Lists of people: the paper's population of 630, and one's own.

Paper: section "AHT pipeline" and appendix "Preference Reward System".
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import jax
import numpy as np

from assistax.errors import UsageError, choose
from assistax.files import read_json
from assistax.human import disability, preference
from assistax.human.disability import DISABILITIES
from assistax.human.profile import HumanProfile, Person, unstack

PAPER = "paper630"
SEED = 630
DRAWS = 90  # preferences per standard disability


@cache
def profiles() -> HumanProfile:
    """The paper's population [630], in NumPy: the seven disabilities one after the other, 90 people each.

    Every one has a preference drawn for them alone. The same on every machine: JAX's Threefry gives the
    same bits everywhere, and without jit the few operations on them are rounded one by one.
    """
    number = len(DISABILITIES) * DRAWS
    with jax.ensure_compile_time_eval():
        keys = jax.random.split(jax.random.key(SEED, impl="threefry2x32"), number)
        preferred = jax.tree.map(np.asarray, jax.vmap(preference.sample)(keys))
    settings = [disability.parse(name) for name in DISABILITIES]
    hard = jax.tree.map(lambda *x: np.repeat(np.stack(x), DRAWS), *settings)
    return HumanProfile(hard, preferred, np.arange(number, dtype=np.int32))  # ty: ignore[invalid-argument-type]


def names() -> list[str]:
    """Of the rows of `profiles`: "tremor-00" to "tremor+weakness+limited_range-89"."""
    return [f"{name}-{i:02d}" for name in DISABILITIES for i in range(DRAWS)]


def people(given) -> tuple[Person, ...]:
    """Named, filed or listed people as words.

    Args:
      given: "paper630"; a JSON file (path) with a list like [{"disability": "tremor", "preference": "default"}];
        such a list itself; Persons; or a HumanProfile stacked [n].

    Raises:
      UsageError: not there, malformed, or somebody is impossible; says who.
    """
    if isinstance(given, HumanProfile):
        if np.ndim(given.disability.tremor) != 1 or not np.size(given.disability.tremor):
            raise UsageError("env.human.people takes profiles stacked along one axis, one or more.")
        return unstack(given)
    if given == PAPER:
        return unstack(profiles())
    source = "env.human.people"
    if isinstance(given, (str, Path)):
        source, given = str(given), _read(Path(given))
    if not isinstance(given, (list, tuple)) or not given:
        raise UsageError(f'{source} must hold a list like [{{"disability": "tremor", "preference": "default"}}].')
    listed = tuple(_person(f"{source}, person {i}", row) for i, row in enumerate(given))
    if len({person.preference == "none" for person in listed}) > 1:
        raise UsageError(f'{source}: either all people have a preference (at least "default"), or none has one.')
    return listed


def _read(path: Path):
    if path.suffix != ".json":
        choose("people", str(path), [PAPER, "a file named *.json"])
    return read_json(path, object)  # checked by `people`, as lists are that come from elsewhere


def _person(where: str, row) -> Person:
    if isinstance(row, Person):
        return row
    if not isinstance(row, Mapping) or not all(isinstance(value, str) for value in row.values()):
        raise UsageError(f'{where} must be like {{"disability": "tremor", "preference": "default"}}, not {row!r}.')
    try:
        for name in row:
            choose("field", name, ["disability", "preference"])
        return Person(**row)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None
