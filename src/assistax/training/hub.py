"""Populations on the Hugging Face Hub: a dataset there is the folder here, with a card that its manifest makes.

Only the Hub's own client talks to it; where it is and who one is, the client's settings say (HF_ENDPOINT, HF_TOKEN).
"""

import shutil
import tempfile
from collections import Counter
from fnmatch import fnmatch
from pathlib import Path

from assistax.errors import UsageError
from assistax.files import writing
from assistax.training.hub_client import client, plainly, snapshot
from assistax.training.population import MANIFEST, SHARED, Population, find

CARD = "README.md"


def push(folder: Path, name: str, private: bool = False) -> str:
    """Put a population onto the Hub, in place of what was there; raises UsageError if that fails, or it is damaged.

    Args:
      folder: of the population.
      name: OWNER/NAME of the dataset, which is made if it is not there.
      private: whether a new dataset is for its owner alone.

    Returns:
      the commit there, which `pull` takes as a revision.
    """
    population, hub = Population.load(folder := find(folder)), client()
    with plainly(name), tempfile.TemporaryDirectory() as place:
        (Path(place) / CARD).write_text(card(population, name))
        hub.HfApi().create_repo(name, repo_type="dataset", private=private, exist_ok=True)
        ours = {path.relative_to(folder).as_posix(): path for kind in SHARED for path in sorted(folder.glob(kind))}
        theirs = hub.HfApi().list_repo_files(name, repo_type="dataset")
        old = [one for one in theirs if one not in ours and any(fnmatch(one, kind) for kind in SHARED)]
        made = [hub.CommitOperationAdd(CARD, Path(place) / CARD)]
        made += [hub.CommitOperationAdd(one, path) for one, path in ours.items()]
        made += [hub.CommitOperationDelete(one) for one in old]
        message = f"{len(population)} members of {population.task}"
        return hub.HfApi().create_commit(name, made, commit_message=message, repo_type="dataset").oid


def pull(name: str, folder: Path, revision: str | None = None) -> Population:
    """Fetch a population into a new folder, which is there only if all of it arrived as it was saved.

    Args:
      name: OWNER/NAME of the dataset.
      folder: of the population, not there yet.
      revision: a commit, tag or branch; None: the newest.

    Raises:
      UsageError: the folder exists, nothing of that name is on the Hub, or what is there is no population.
    """
    if folder.exists():
        raise UsageError(f"{folder} is there already; name another --out.")
    client()  # asked before anything is written
    with writing(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        place = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        with writing(folder):
            snapshot(name, SHARED, revision, place)
        shutil.rmtree(place / ".cache", ignore_errors=True)  # the client's notes
        if not (place / MANIFEST).is_file():
            raise UsageError(f"{name} on the Hub is not a population: it has no {MANIFEST}.")
        found = Population.load(place)
        with writing(folder):
            place.chmod(0o755)
            place.rename(folder)
        return found
    finally:
        shutil.rmtree(place, ignore_errors=True)


def card(population: Population, name: str) -> str:
    """The dataset's page: who the members are and what they reach."""
    trained = [row for row in population.rows if "mean_return" in row and "fraction" not in row]
    kinds = Counter(row["person"]["disability"] for row in population.rows)
    lines = [
        "---",
        f"pretty_name: People for {population.task}",
        "tags: [assistax, multi-agent-reinforcement-learning, ad-hoc-teamwork, robotics]",
        "configs:",
        "- config_name: members",
        f"  data_files: {MANIFEST}",
        "---",
        "",
        f"# {len(population)} people for `{population.task}`",
        "",
        "Partners for robots that are to work with people they have never met: trained policies of people, each with a "
        "body, preferences and the robot they were trained with.",
        "",
        "```sh",
        f"assistax population pull {name} --out populations/{name.rpartition('/')[2]}",
        "```",
        "",
        "| disability | members |",
        "|---|---|",
        *(f"| {kind} | {number} |" for kind, number in kinds.items()),
        "",
    ]
    if trained:
        safe = sum(row.get("safe_success_rate", 0.0) for row in trained) / len(trained)
        lines += [f"With their own robots they succeed safely in {safe:.0%} of the episodes, on average.", ""]
    return "\n".join(lines)
