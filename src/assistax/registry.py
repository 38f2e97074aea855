"""What other packages may add to: things by name, with those of installed packages found by their entry points.

An installed package adds a task, an algorithm or a robot by an entry point in its pyproject.toml:

    [project.entry-points."assistax.tasks"]
    pouring = "my_package.pouring:SPEC"
"""

from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from typing import TypeVar

from assistax.errors import UsageError, choose

T = TypeVar("T")


class Registry(Mapping[str, T]):
    """Things by name, in the order in which they were registered.

    Args:
      what: what they are, in error messages ("algorithm").
      name: the name of a thing.
      group: the entry points that name more of them ("assistax.algorithms"); read at the first look-up.
    """

    def __init__(self, what: str, name: Callable[[T], str], group: str):
        self._what, self._name, self._group = what, name, group
        self._things: dict[str, T] = {}
        self._found = False

    def register(self, thing: T) -> T:
        """Add a thing; raises UsageError if its name is another's."""
        name = self._name(thing)
        if self._things.setdefault(name, thing) is not thing:
            raise UsageError(f"The {self._what} {name!r} is registered already; choose another name.")
        return thing

    def __getitem__(self, name: str) -> T:
        """Raises UsageError, with the names there are, for one that is not registered."""
        self._find()
        return self._things[choose(self._what, name, self._things)]

    def __contains__(self, name: object) -> bool:
        self._find()
        return name in self._things

    def __iter__(self) -> Iterator[str]:
        self._find()
        return iter(self._things)

    def __len__(self) -> int:
        self._find()
        return len(self._things)

    def _find(self) -> None:
        if self._found:
            return
        self._found = True  # what is loaded may itself look things up
        try:
            for point in metadata.entry_points(group=self._group):
                self._load(point)
        except BaseException:
            self._found = False
            raise

    def _load(self, point: metadata.EntryPoint) -> None:
        try:
            self.register(point.load())
        except Exception as error:  # another package's code can fail in any way; say whose
            raise UsageError(
                f"The {self._what} {point.name!r} of an installed package cannot be loaded from {point.value}: "
                f"{type(error).__name__}: {error}"
            ) from error
