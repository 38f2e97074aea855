"""The Hugging Face Hub's own client: what it fetches, and what goes wrong with it as one line."""

import os
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from assistax.errors import UsageError


def snapshot(name: str, files: Iterable[str], revision: str | None = None, place: Path | None = None) -> Path:
    """Fetch the files of a dataset that fit the patterns; raises UsageError if that fails.

    Args:
      name: OWNER/NAME of the dataset.
      files: patterns of their paths.
      revision: a commit, tag or branch; None: the newest.
      place: the folder that they go to; None: the client's own cache, where they are kept.

    Returns:
      the folder that they are in.
    """
    options: dict[str, Any] = {"repo_type": "dataset", "revision": revision, "local_dir": place}
    with plainly(name, revision):
        return Path(client().HfApi().snapshot_download(name, allow_patterns=list(files), **options))


def client() -> Any:
    """The Hub's package; raises UsageError if it is not there."""
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    try:
        import huggingface_hub.errors
    except ImportError:
        raise UsageError('Sharing needs the Hugging Face Hub\'s client: pip install "assistax[hub]".') from None
    return huggingface_hub


@contextmanager
def plainly(name: str, revision: str | None = None) -> Generator[None]:
    """What goes wrong with the Hub inside is a UsageError of one line."""
    hub = client()
    errors = hub.errors
    try:
        yield
    except errors.HFValidationError:
        raise UsageError(f"A population on the Hub is called OWNER/NAME, not {name!r}.") from None
    except errors.RevisionNotFoundError:
        raise UsageError(f"{name} on the Hub has no revision {revision!r}.") from None
    except errors.RepositoryNotFoundError:
        raise UsageError(f"There is no {name} on the Hub, or you may not see it (log in: hf auth login).") from None
    except (errors.HfHubHTTPError, errors.OfflineModeIsEnabled, errors.LocalEntryNotFoundError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise UsageError(f"The Hub at {hub.constants.ENDPOINT} did not do it: {reason}") from None
    except Exception as error:  # of the library with which the client speaks HTTP, which changes
        if type(error).__module__.partition(".")[0] in ("httpx", "httpx2", "httpcore", "httpcore2", "requests"):
            raise UsageError(f"The Hub at {hub.constants.ENDPOINT} cannot be reached ({error}).") from None
        raise
