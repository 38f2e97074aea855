"""The environment in the terms of other packages: a file for each, which needs nothing that it does not name.

import assistax.adapters.gymnasium  # gym.make("assistax/scratch-v3"), with pip install 'assistax[gymnasium]'
"""

from assistax.errors import UsageError


def missing(error: ImportError, package: str) -> UsageError:
    """What to raise where a package cannot be imported; the extra that installs it has its name."""
    return UsageError(f"{package} cannot be imported ({error}); install it with: pip install 'assistax[{package}]'")
